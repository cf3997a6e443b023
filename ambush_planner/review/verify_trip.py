"""The recorded poses and what the metadata makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from geometry_msgs.msg import Pose, PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage

from ..recording.metadata import VIA
from ..ros.conversions import position_from_ros
from .case import Case


@dataclass(frozen=True)
class PosedTrip:
    """The trip that follows from the recorded poses, as far as it does.

    ``start`` and ``goal`` are the poses, or None where they are not in the map's frame;
    ``start_xy`` and ``goal_xy`` where the trip that was planned begins, and the goal that it was
    planned for [m]; ``stops_xy`` the stops, in the order of the message where that is in the map's
    frame, else as they were visited; ``faults`` where the metadata says something else; ``notes``
    what could not be checked.
    """

    start: Pose | None
    goal: Pose | None
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    faults: tuple[str, ...]
    notes: tuple[str, ...]
    stops_xy: tuple[tuple[float, float], ...] = ()


def posed_trip(case: Case) -> PosedTrip:
    """Read start and goal from the recorded messages.

    Raises
    ------
    InvalidPose
        The numbers of a pose are no pose.
    UnreadableRecording
        A message is not a pose.
    """
    start, goal = _pose(case, 'start'), _pose(case, 'goal')
    frame, told = case.metadata.frame, case.metadata.trip
    notes = [
        f'not checked: the {name} pose is in the frame {pose.header.frame_id[:60]!r}, the '
        f'map in {frame[:60]!r}'
        for name, pose in (('start', start), ('goal', goal))
        if pose.header.frame_id != frame
    ]
    faults = []
    (begin, end), goal_xy = case.metadata.ends, told.goal_xy
    if start.header.frame_id == frame and position_from_ros(start, 'start') != begin:
        faults.append('ends: the first one is not the position of the start pose')
    if goal.header.frame_id == frame and (asked := position_from_ros(goal, 'goal')) != end:
        # Whether the goal was moved as it had to be is seen when it is planned again.
        goal_xy = asked
        if told.tolerance == 0.0 or end != told.goal_xy:
            faults.append('ends: the last one is not the position of the goal pose')
    stops = _stops(case, faults, notes)
    return PosedTrip(
        start.pose if start.header.frame_id == frame else None,
        goal.pose if goal.header.frame_id == frame else None,
        told.start_xy, goal_xy, tuple(faults), tuple(notes), stops,
    )


def _stops(
    case: Case, faults: list[str], notes: list[str]
) -> tuple[tuple[float, float], ...]:
    visited = case.metadata.trip.stops
    if not visited:
        return ()
    via = case.message(VIA, PoseArray)
    if via.header.frame_id != case.metadata.frame:
        notes.append(
            f'not checked: the stops are in the frame {via.header.frame_id[:60]!r}, the map in '
            f'{case.metadata.frame[:60]!r}'
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


def frame_faults(case: Case, software: Iterable[str]) -> list[str]:
    """Check what the metadata says about the messages and about itself.

    ``software`` are the names of what versions are stated of.

    Raises
    ------
    UnreadableRecording
        The map or the path is none.
    """
    metadata = case.metadata
    faults = [
        f'versions: an entry {name[:60]!r} is not known'
        for name in sorted(set(metadata.versions) - set(software))
    ]
    for role, kind in (('map', OccupancyGrid), ('path', PathMessage)):
        frame = case.message(role, kind).header.frame_id
        if frame != metadata.frame:
            faults.append(f'frame: the {role} is in the frame {frame[:60]!r}')
    if metadata.number < 1:
        faults.append('departure: departures are numbered from 1')
    if metadata.trip.tolerance < 0.0:
        faults.append('trip: its tolerance is negative')
    return faults


def _pose(case: Case, role: str) -> PoseStamped:
    """Return the pose in a role as the node takes it."""
    message = case.message(role, PoseStamped, PoseWithCovarianceStamped)
    if isinstance(message, PoseStamped):
        return message
    if role != 'start':
        raise case.unreadable(f'{role}: the message is not a pose')
    return PoseStamped(header=message.header, pose=message.pose.pose)
