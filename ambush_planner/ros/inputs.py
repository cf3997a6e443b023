# SPDX-License-Identifier: Apache-2.0
"""What has arrived: the current map, the latest poses, and the trip that they make."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NoReturn

from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header

from ..errors import InvalidPose, InvalidRiskMap
from ..maps.ros_messages import pose_from_ros, position_from_ros
from ..parameters.values import RobotOptions
from ..recordings import type_name
from ..recordings.plain_messages import grid_values
from ..recordings.plan_file import SavedPlan
from .conversions import occupancy_to_ros, pose_to_ros
from .current_map import CurrentMap, ReceivedMessage, joined_map, map_from, updated_map
from .error_codes import FrameMismatch, NoGoal, NoMap, NoStart
from .parameter_changes import NodeSettings
from .topics import LATCHED, LATEST
from .transforms import FrameTransforms

# Maximum number of stops on a trip: each adds a leg, with a copy of the network.
MAX_STOPS = 50


@dataclass(frozen=True, eq=False)
class TripRequest:
    """A start, a goal and stops, each in any frame.

    Without a start, the route begins at the robot's pose at departure. A blocked goal may be moved
    by ``goal_tolerance`` [m].
    """

    start: ReceivedMessage | None
    goal: ReceivedMessage
    goal_tolerance: float = 0.0
    via: ReceivedMessage | None = None

    def leads_to(self, other: TripRequest) -> bool:
        """Whether two requests have the same goal and stops."""
        one, two = self.goal.message, other.goal.message
        stops = [each.via.message.poses if each.via else [] for each in (self, other)]
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
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    stops_xy: tuple[tuple[float, float], ...] = ()
    robot: str = ''

    @property
    def moves(self) -> bool:
        """Whether the start is the place of a robot."""
        return self.robot != ''


class Inputs:
    """The latest valid map, and the latest poses as they arrived.

    A map is checked on arrival, and a malformed one leaves the previous map current. A pose is
    checked at departure, when its map is known; a bad pose replaces the previous one, so that no
    convoy departs for an abandoned goal. If a trip starts at the robot, its pose is
    recorded as if it had arrived on ``start_pose``. ``full_name`` is that of a topic.

    Attributes
    ----------
    start, goal, via
        Where later departures begin and lead, and their stops in order; None: not given.
    settings
        The node's parameters.
    with_costmap
        Whether a costmap is waited for, too.
    asked_directly
        Whether a request brought its own start and goal; missing topics are then not reported.
    """

    def __init__(self, transforms: FrameTransforms, full_name: Callable[[str], str],
                 settings: NodeSettings) -> None:
        self._transforms, self._full_name = transforms, full_name
        self.settings = settings
        self.with_costmap = bool(settings.current.values['map.costmap'])
        self._arrived: dict[str, CurrentMap | None] = {'alpha_map': None}
        if self.with_costmap:
            self._arrived['costmap'] = None
        self.start: ReceivedMessage | None = None
        self.goal: ReceivedMessage | None = None
        self.via: ReceivedMessage | None = None
        self.asked_directly = False
        self._map: CurrentMap | None = None
        self._refused: InvalidRiskMap | None = None

    def accept_map(self, topic: str, received: ReceivedMessage) -> None:
        """Take a map, or a map_msgs/OccupancyGridUpdate of one, for ``join_maps``.

        Raises InvalidRiskMap if it is malformed or does not fit the map, and NoMap if there is none
        to update. The current map then stays.
        """
        if not isinstance(received.message, OccupancyGrid):
            present = self._arrived[topic] or self._no_map()
            self._arrived[topic] = updated_map(present, received.message)
            return
        try:
            self._arrived[topic] = map_from(received)
        except InvalidRiskMap as error:
            self._refused = error
            raise

    def join_maps(self) -> CurrentMap | None:
        """Put the costmap's obstacles, if it is wanted, on the risk map; return the current map.

        A map equal to the current one changes nothing. Raises FrameMismatch if the costmap cannot
        be transformed into the risk map's frame.
        """
        new, costmap = self._arrived['alpha_map'], self._arrived.get('costmap')
        if new is None or None in self._arrived.values():
            return None
        if costmap is not None:
            values, header = self.settings.current, Header(frame_id=costmap.frame)
            origin = PoseStamped(header=header, pose=pose_to_ros(*costmap.origin))
            there = self._transforms.to_frame(origin, 'the costmap', new.frame,
                                              values.robot.max_age)
            costmap = replace(costmap, origin=pose_from_ros(there.pose))
            new = joined_map(new, costmap, values.occupancy.unknown_alpha is None)
        if self._map is None or not self._map.same_map(new):
            self._map = new
        self._refused = None
        return self._map

    def missing(self, robot: RobotOptions) -> tuple[str, ...]:
        """Return the full names of the topics of the inputs that have not arrived."""
        poses = {'start_pose': self.start or robot.frame, 'goal_pose': self.goal}
        inputs = {**self._arrived, **({} if self.asked_directly else poses)}
        return tuple(self._full_name(name) for name, given in inputs.items() if not given)

    def latest(self, robot: RobotOptions) -> TripRequest:
        """Return the trip from the latest start to the latest goal via the latest stops.

        Raises NoMap, NoStart or NoGoal if an input has not arrived.
        """
        self.current_map()
        if self.start is None and not robot.frame:
            raise NoStart(f'no start yet: publish one on {self._full_name("start_pose")} or '
                          f'{self._full_name("initialpose")}, or set robot_base_frame')
        if self.goal is None:
            raise NoGoal(f'no goal yet: publish one on {self._full_name("goal_pose")}')
        return TripRequest(self.start, self.goal, via=self.via)

    def current_map(self) -> CurrentMap:
        """Return the current map; raises NoMap if no map has arrived."""
        return self._map or self._no_map()

    def _no_map(self) -> NoReturn:
        if self._arrived['alpha_map'] is not None:
            raise NoMap('no costmap yet, or no transform to the frame of the risk map: publish one '
                        f'on {self._full_name("costmap")}, or start with map.costmap false')
        why = f'; the last one was refused: {self._refused}' if self._refused else ''
        raise NoMap(f'no risk map yet: publish one on {self._full_name("alpha_map")}{why}')

    def locate(self, request: TripRequest, robot: RobotOptions) -> Trip:
        """Locate a trip on the current map, by the transforms of this moment.

        Raises NoMap if no map has arrived, and FrameMismatch or InvalidPose if a pose cannot be
        transformed into the map's frame or is not a valid pose.
        """
        present = self.current_map()
        start, start_pose = self._located_start(request.start, robot, present.frame)
        goal_pose = self._transforms.to_frame(
            request.goal.message, 'goal', present.frame, robot.max_age
        )
        given = request.start.message.header.frame_id if request.start else ''
        frame = given or robot.frame
        return Trip(present, replace(request, start=start), start_pose, goal_pose,
                    position_from_ros(start_pose, 'start'), position_from_ros(goal_pose, 'goal'),
                    self._located_stops(request.via, present.frame, robot.max_age),
                    '' if frame == present.frame else frame)

    def robot_place(self, robot: RobotOptions) -> tuple[float, float] | None:
        """Return where the robot is on the current map [m]; None if that is not known."""
        pose, frame = robot_pose(robot), self.current_map().frame
        with suppress(FrameMismatch):
            return pose and position_from_ros(
                self._transforms.to_frame(pose, 'start', frame, robot.max_age), 'start')
        return None

    def _located_start(self, start: ReceivedMessage | None, robot: RobotOptions,
                       frame: str) -> tuple[ReceivedMessage, PoseStamped]:
        """Return the start to record, and its pose in the map's frame."""
        if start is not None and (start.message.header.frame_id or not robot.frame):
            return start, self._transforms.to_frame(start.message, 'start', frame, robot.max_age)
        pose = self._transforms.to_frame(robot_pose(robot), 'start', frame, robot.max_age)
        return ReceivedMessage(self._full_name('start_pose'), type_name(pose), pose, LATEST), pose

    def _located_stops(self, via: ReceivedMessage | None, frame: str,
                       max_age: float) -> tuple[tuple[float, float], ...]:
        """Return the positions of the stops [m] in the map's frame."""
        if via is None:
            return ()
        if len(via.message.poses) > MAX_STOPS:
            raise InvalidPose(
                f'via_poses: {len(via.message.poses)} stops, but at most {MAX_STOPS} are allowed'
            )
        stops = {f'stop {number}': PoseStamped(header=via.message.header, pose=pose)
                 for number, pose in enumerate(via.message.poses, start=1)}
        return tuple(position_from_ros(self._transforms.to_frame(given, name, frame, max_age), name)
                     for name, given in stops.items())


def robot_pose(robot: RobotOptions) -> PoseStamped | None:
    """Return the pose of the robot, in its own frame; None if that has no name."""
    if not robot.frame:
        return None
    return PoseStamped(header=Header(frame_id=robot.frame), pose=pose_to_ros(0.0, 0.0))


def inputs_of(saved: SavedPlan,
              resolve: Callable[[str], str]) -> tuple[ReceivedMessage, TripRequest]:
    """The messages from which a plan could have been made; ``resolve`` gives a topic's name."""
    plan, header = saved.plan, Header(frame_id=saved.frame)
    assert plan.risk_map is not None
    risk_map, network = plan.risk_map, plan.network
    values = grid_values(risk_map, saved.parameters.occupancy)

    def received(topic: str, message: Any) -> ReceivedMessage:
        return ReceivedMessage(resolve(topic), type_name(message), message, LATCHED)

    start, goal = (PoseStamped(header=header, pose=pose_to_ros(*network.points[node].tolist()))
                   for node in (network.source, network.target))
    stops = PoseArray(header=header, poses=[pose_to_ros(*xy) for xy in plan.stops_xy])
    grid = occupancy_to_ros(values, risk_map.resolution, risk_map.origin, header)
    via = received('via_poses', stops) if plan.stops_xy else None
    return received('alpha_map', grid), TripRequest(
        received('start_pose', start), received('goal_pose', goal), via=via)
