# SPDX-License-Identifier: Apache-2.0
"""A trip as it was requested, and as it is located on a map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from geometry_msgs.msg import PoseStamped

from ..arrays import FloatArray
from ..parameters.values import NodeParameters
from ..planning.clear_ground import ClearGround
from ..planning.moved_start import REGION
from ..planning.options import strays
from ..planning.trip_under_way import Destination, Position
from ..recordings.cdr import poses_along
from .conversions import SentPath, row_of
from .current_map import CurrentMap, ReceivedMessage


@dataclass(frozen=True, eq=False)
class TripRequest:
    """A start, a goal and stops, each in any frame, and the node's parameters at that time.

    Without a start, the route begins at the robot's pose at departure. A blocked goal may be moved
    by ``goal_tolerance`` [m].
    """

    parameters: NodeParameters
    start: ReceivedMessage | None
    goal: ReceivedMessage
    goal_tolerance: float = 0.0
    via: ReceivedMessage | None = None

    def leads_to(self, other: TripRequest) -> bool:
        """Whether two requests have the same goal and stops."""
        one, two = self.goal.message, other.goal.message
        stops = [(each.via.message.header.frame_id, each.via.message.poses) if each.via else None
                 for each in (self, other)]
        return (one.header.frame_id == two.header.frame_id and one.pose == two.pose
                and stops[0] == stops[1])


@dataclass(frozen=True, eq=False)
class Trip:
    """A request located on a map; poses and positions [m] are in the map's frame.

    The ``request`` has a start: that of the robot, if none was given. ``robot`` is the frame in
    which the start was given, if that is not the map's: the start moves.
    """

    map: CurrentMap
    request: TripRequest
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: Position
    goal_xy: Position
    stops_xy: tuple[Position, ...] = ()
    robot: str = ''

    @property
    def parameters(self) -> NodeParameters:
        """The parameters of the request."""
        return self.request.parameters

    @property
    def moves(self) -> bool:
        """Whether the start is the place of a robot."""
        return self.robot != ''

    @property
    def goal_and_tolerance(self) -> tuple[Position, float]:
        """The goal, and how far it may be moved if it is blocked [m]."""
        return self.goal_xy, self.request.goal_tolerance

    @property
    def destination(self) -> Destination:
        """Where the trip leads, to be compared with later requests."""
        return Destination((self.map.frame, self.robot), self.goal_xy, self.map.resolution,
                           self.stops_xy)

    @property
    def ground(self) -> ClearGround:
        """What can be driven on the map."""
        return ClearGround(self.map, self.parameters.occupancy, self.parameters.planning.network)

    @cached_property
    def conditions(self) -> tuple[object, ...]:
        """What a plan depends on besides map, start, goal, refinement and planning time."""
        planning = self.parameters.planning
        planning = replace(planning, network=replace(planning.network, refine=0), max_gap=0.0,
                           strategy=replace(planning.strategy, time_limit=math.inf))
        return self.stops_xy, self.parameters.occupancy, planning

    def distance(self, other: Trip) -> float:
        """Return the distance of the starts or of the goals of two trips [m], the larger one."""
        return max(math.dist(self.start_xy, other.start_xy),
                   math.dist(self.goal_xy, other.goal_xy))

    def is_joined_by(self, other: Trip, spacing: float) -> bool:
        """Whether the other one is a robot's, near enough to join a plan for this one.

        On roads, within the tube of its start: other ways could leave the road.
        """
        planning = self.parameters.planning
        most = strays(planning, spacing) if planning.network.roads else REGION * spacing
        return (other.moves and self.goal_and_tolerance == other.goal_and_tolerance
                and math.dist(self.start_xy, other.start_xy) <= most)

    def out_of_obstacle(self) -> Trip:
        """Return the trip of a robot in the inflation of a costmap, from where it can drive out."""
        if not self.moves or self.parameters.values['map.preset'] == 'alpha':
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
