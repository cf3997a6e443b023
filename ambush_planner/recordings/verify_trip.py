"""The recorded poses and what the metadata makes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geometry_msgs.msg import Pose, PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage

from ..maps.ros_messages import position_from_ros
from ..ros.departure_record import software_versions
from .metadata import VIA
from .recorded_case import Case


@dataclass(frozen=True)
class PosedTrip:
    """The trip that follows from the recorded poses, as far as it does.

    ``start`` and ``goal`` are the poses, or None where they are not in the map's frame;
    ``goal_xy`` [m] is the goal that was planned for, ``stops_xy`` the stops, in the order of the
    message where that is in the map's frame, else as they were visited; ``faults`` where the
    metadata says something else; ``notes`` what could not be checked.
    """

    start: Pose | None
    goal: Pose | None
    goal_xy: tuple[float, float]
    stops_xy: tuple[tuple[float, float], ...]
    faults: tuple[str, ...]
    notes: tuple[str, ...]


def posed_trip(case: Case) -> PosedTrip:
    """Read start and goal from the recorded messages.

    Raises
    ------
    InvalidPose
        The numbers of a pose do not make a pose.
    UnreadableRecording
        A message is not a pose.
    """
    metadata, trip = case.metadata, case.metadata.trip
    poses, faults, notes, goal_xy = {}, [], [], trip.goal_xy
    for role, which, end in zip(('start', 'goal'), ('first', 'last'), metadata.ends, strict=True):
        message = _pose(case, role)
        frame = message.header.frame_id
        if frame != metadata.frame:
            notes.append(
                f'not checked: the {role} pose is in the frame {frame[:60]!r}, the map in '
                f'{metadata.frame[:60]!r}'
            )
            continue
        poses[role] = message.pose
        if (asked := position_from_ros(message, role)) == end:
            continue
        if role == 'goal':
            # Whether the goal was moved as it had to be is seen when it is planned again.
            goal_xy = asked
        if role == 'start' or trip.tolerance == 0.0 or end != trip.goal_xy:
            faults.append(f'ends: the {which} one is not the position of the {role} pose')
    stops = _stops(case, faults, notes)
    return PosedTrip(
        poses.get('start'), poses.get('goal'), goal_xy, stops, tuple(faults), tuple(notes)
    )


def _stops(
    case: Case, faults: list[str], notes: list[str]
) -> tuple[tuple[float, float], ...]:
    visited, frame = case.metadata.trip.stops, case.metadata.frame
    if not visited:
        return ()
    via = case.message(VIA, PoseArray)
    if via.header.frame_id != frame:
        notes.append(
            f'not checked: the stops are in the frame {via.header.frame_id[:60]!r}, the map in '
            f'{frame[:60]!r}'
        )
        return visited
    given = tuple(
        position_from_ros(PoseStamped(pose=pose), f'stop {number}')
        for number, pose in enumerate(via.poses, start=1)
    )
    in_order = sorted if case.parameters.trip_order == 'best' else tuple
    if in_order(given) != in_order(visited):
        faults.append('trip: its stops are not those of the recorded poses')
    return given


def ends_faults(case: Case, spacing: float) -> list[str]:
    """Check that the path's ends are as near to the trip's as the node takes them."""
    trip, most = case.metadata.trip, min(case.parameters.start_tolerance, 0.5 * spacing)
    pairs = zip(case.metadata.ends, (trip.start_xy, trip.goal_xy), strict=True)
    if max(math.dist(end, planned) for end, planned in pairs) <= most:
        return []
    return ['ends: they are further from the trip than route.start_tolerance allows']


def metadata_faults(case: Case) -> list[str]:
    """Check what the metadata says about the messages and about itself.

    Raises
    ------
    UnreadableRecording
        The map or the path is of another type.
    """
    metadata, trip = case.metadata, case.metadata.trip
    frames = {
        role: case.message(role, kind).header.frame_id
        for role, kind in (('map', OccupancyGrid), ('path', PathMessage))
    }
    faults = [
        f'frame: the {role} is in the frame {frame[:60]!r}'
        for role, frame in frames.items() if frame != metadata.frame
    ]
    if unknown := sorted(set(metadata.versions) - set(software_versions())):
        faults.append(f'versions: an entry {unknown[0][:60]!r} is not known')
    if metadata.number < 1:
        faults.append('departure: departures are numbered from 1')
    if trip.tolerance < 0.0 or (trip.tolerance and metadata.service == 'new_route'):
        faults.append('trip: its tolerance is negative, or not 0 at new_route')
    if trip.stops and metadata.service != 'new_route':
        faults.append('trip: only new_route has stops')
    return faults


def _pose(case: Case, role: str) -> PoseStamped:
    """Return the pose in a role as the node takes it."""
    message = case.message(role, PoseStamped, PoseWithCovarianceStamped)
    if isinstance(message, PoseStamped):
        return message
    if role != 'start':
        raise case.unreadable(f'{role}: the message is not a pose')
    return PoseStamped(header=message.header, pose=message.pose.pose)
