"""The recorded poses and what the metadata makes of them."""

from __future__ import annotations

from dataclasses import dataclass

from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage

from ..recording.departure import RecordedDeparture
from ..recording.errors import UnreadableRecording
from ..ros.conversions import position_from_ros
from ..ros.departure_record import METADATA_KEYS, software_versions
from ..ros.parameters import PARAMETERS
from .departures import DepartureRecord


@dataclass(frozen=True)
class PosedTrip:
    """The trip that follows from the recorded poses, as far as it does.

    Attributes:
        start, goal: The poses, or None where they are not in the map's frame.
        start_xy, goal_xy: Their positions [m]; where there is no pose, the metadata's.
        faults: Where the metadata says something else.
        notes: What could not be checked.
    """

    start: Pose | None
    goal: Pose | None
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    faults: tuple[str, ...]
    notes: tuple[str, ...]


def posed_trip(recorded: RecordedDeparture, record: DepartureRecord) -> PosedTrip:
    """Read start and goal from the recorded messages.

    Raises:
        InvalidPose: The numbers of a pose are no pose.
        UnreadableRecording: A message is not a pose.
    """
    start, goal = _pose(recorded, 'start'), _pose(recorded, 'goal')
    notes = [
        f'not checked: the {name} pose is in the frame {pose.header.frame_id[:60]!r}, the '
        f'map in {record.frame[:60]!r}'
        for name, pose in (('start', start), ('goal', goal))
        if pose.header.frame_id != record.frame
    ]
    faults = []
    start_xy, goal_xy = record.trip.start_xy, record.trip.goal_xy
    if start.header.frame_id == record.frame:
        start_xy = position_from_ros(start, 'start')
        if start_xy != record.trip.start_xy:
            faults.append('trip: its start is not the position of the start pose')
    if goal.header.frame_id == record.frame:
        goal_xy = position_from_ros(goal, 'goal')
        # Whether the goal was moved as it had to be is seen when it is planned again.
        if record.trip.tolerance == 0.0 and goal_xy != record.trip.goal_xy:
            faults.append('trip: its goal is not the position of the goal pose')
    return PosedTrip(
        start.pose if start.header.frame_id == record.frame else None,
        goal.pose if goal.header.frame_id == record.frame else None,
        start_xy, goal_xy, tuple(faults), tuple(notes),
    )


def metadata_faults(recorded: RecordedDeparture, record: DepartureRecord) -> list[str]:
    """Check what the metadata says about the messages and about itself.

    Raises:
        UnreadableRecording: The map or the path is none.
    """
    faults = [
        f'{what}: an entry {name[:60]!r} is not known'
        for what, found, known in (
            ('metadata', recorded.metadata, METADATA_KEYS),
            ('versions', record.versions, software_versions()),
        )
        for name in sorted(set(found) - set(known))
    ]
    for role, kind in (('map', OccupancyGrid), ('path', PathMessage)):
        message = recorded.message(role)
        if not isinstance(message, kind):
            raise UnreadableRecording(recorded.path, f'{role}: it is not a {kind.__name__}')
        if message.header.frame_id != record.frame:
            faults.append(f'frame: the {role} is in the frame {message.header.frame_id[:60]!r}')
    if record.number < 1:
        faults.append('departure: departures are numbered from 1')
    if record.trip.tolerance < 0.0:
        faults.append('trip: its tolerance is negative')
    values = record.parameters.values
    wrong = [name for name in PARAMETERS if name not in values] or [
        name for name in values if name not in PARAMETERS
    ]
    if wrong:
        faults.append(f'parameters: they are not those of this planner, see {wrong[0][:60]!r}')
    if type(values.get('seed')) is not int or values['seed'] < -1:
        raise UnreadableRecording(recorded.path, 'parameters: seed is not a whole number >= -1')
    return faults


def _pose(recorded: RecordedDeparture, role: str) -> PoseStamped:
    """Return the pose in a role as the node takes it."""
    message = recorded.message(role)
    if role == 'start' and isinstance(message, PoseWithCovarianceStamped):
        return PoseStamped(header=message.header, pose=message.pose.pose)
    if not isinstance(message, PoseStamped):
        raise UnreadableRecording(recorded.path, f'{role}: the message is not a pose')
    return message
