# SPDX-License-Identifier: Apache-2.0
"""A trip as it was requested, and as it is located on a map; how a plan for one suits another."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

from geometry_msgs.msg import PoseArray, PoseStamped

from ..arrays import FloatArray, Position
from ..parameters.values import NodeParameters
from ..planning.clear_ground import ClearGround
from ..planning.moved_start import REGION
from ..planning.options import strays
from ..planning.trip_under_way import Destination
from ..recordings.cdr import poses_along
from .conversions import SentPath, row_of
from .current_map import CurrentMap


@dataclass(frozen=True, eq=False)
class TripRequest:
    """A start, a goal and stops, each in any frame, and the node's parameters at that time.

    Without a start, the route begins at the robot's pose at departure. A blocked goal may be moved
    by ``goal_tolerance`` [m].
    """

    parameters: NodeParameters
    start: PoseStamped | None
    goal: PoseStamped
    goal_tolerance: float = 0.0
    via: PoseArray | None = None

    def leads_to(self, other: TripRequest) -> bool:
        """Return whether two requests have the same goal and stops."""
        one, two = self.goal, other.goal
        stops = [(each.via.header.frame_id, each.via.poses) if each.via else None
                 for each in (self, other)]
        return (one.header.frame_id == two.header.frame_id and one.pose == two.pose
                and stops[0] == stops[1])


@dataclass(frozen=True, eq=False)
class Trip:
    """A request located on a map; poses and positions [m] are in the map's frame.

    The ``request`` has a start: that of the robot, if none was given. ``robot`` is the frame in
    which the start was given, if that moves in the map's frame; '' for a fixed place. Trips are
    equal if they have the same plan.
    """

    map: CurrentMap
    request: TripRequest
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: Position
    goal_xy: Position
    stops_xy: tuple[Position, ...] = ()
    robot: str = ''

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Trip) and self._solved_for == other._solved_for

    def __hash__(self) -> int:
        return hash(self._solved_for)

    @cached_property
    def _solved_for(self) -> tuple[object, ...]:
        planning = self.parameters.planning
        limits = planning.strategy.time_limit, planning.max_gap, planning.network.refine
        return self.map, self.start_xy, self.goal_and_tolerance, self.conditions, limits

    @property
    def parameters(self) -> NodeParameters:
        """The parameters of the request."""
        return self.request.parameters

    @property
    def goal_and_tolerance(self) -> tuple[Position, float]:
        """The goal, and how far it may be moved if it is blocked [m]."""
        return self.goal_xy, self.request.goal_tolerance

    @property
    def destination(self) -> Destination:
        """Return the destination of the trip, to be compared with later requests."""
        return Destination((self.map.frame, self.robot), self.goal_xy, self.map.resolution,
                           self.stops_xy)

    @property
    def ground(self) -> ClearGround:
        """The ground that can be driven on the map."""
        return ClearGround(self.map, self.parameters.occupancy, self.parameters.planning.network)

    @cached_property
    def conditions(self) -> tuple[object, ...]:
        """All that a plan depends on besides map, start, goal, refinement and planning time."""
        planning = self.parameters.planning
        planning = replace(planning, network=replace(planning.network, refine=0), max_gap=0.0,
                           strategy=replace(planning.strategy, time_limit=math.inf))
        return self.stops_xy, self.request.goal_tolerance, self.parameters.occupancy, planning

    @property
    def stamp(self) -> float:
        """Return the time of the transform that gave the robot's place [s]; 0: a fixed place."""
        return seconds(self.start_pose.header.stamp) if self.robot else 0.0

    def distance(self, other: Trip) -> float:
        """Return the distance of the starts or of the goals of two trips [m], the larger one."""
        return max(math.dist(self.start_xy, other.start_xy),
                   math.dist(self.goal_xy, other.goal_xy))

    def leave_obstacle(self) -> Trip:
        """Return the trip of a robot in the inflation of a costmap, from where it can drive out."""
        if not self.robot or self.parameters.values['map.preset'] == 'alpha':
            return self
        return replace(self, start_xy=self.ground.way_out(self.start_xy))

    def path(self, rows: FloatArray, stamp_ns: int) -> SentPath:
        """Return the path along ``rows`` (L, 3) = (x, y, yaw) at a time [ns].

        It begins with exactly the start's pose, and ends at the last position with the goal's
        height and orientation: a blocked goal has been moved there.
        """
        poses, last = poses_along(rows), rows[-1, :2]
        poses[0] = row_of(self.start_pose.pose)
        poses[-1] = *last, *row_of(self.goal_pose.pose)[2:]
        return SentPath(self.map.frame, stamp_ns, poses)


def seconds(stamp: Any) -> float:
    """Return the time of a builtin_interfaces/Time [s]."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


class Match(IntEnum):
    """Fit of a plan for another trip: as it is, by moved ends, by being joined, or none."""

    EXACT, NEAR, JOINED, NONE = range(4)


def match(planned: Trip, trip: Trip, spacing: float, tolerance: float) -> Match:
    """Return how well a plan suits a trip, as far as the trip that it was ``planned`` for shows.

    Its nodes are ``spacing`` apart, and start and goal may be ``tolerance`` away from its own [m].
    A robot may join routes to its goal from the region around their start; on roads, from within
    the tube, since other ways could leave the road.
    """
    if not trip.map.same_ground(planned.map) or trip.conditions != planned.conditions:
        return Match.NONE
    away, same_goal = planned.distance(trip), planned.goal_xy == trip.goal_xy
    if away == 0.0:
        return Match.EXACT
    if away <= tolerance:
        return Match.NEAR
    planning = planned.parameters.planning
    region = strays(planning, spacing) if planning.network.roads else REGION * spacing
    return Match.JOINED if trip.robot and same_goal and away <= region else Match.NONE
