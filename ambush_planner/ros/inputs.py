# SPDX-License-Identifier: Apache-2.0
"""The inputs that have arrived: the current map, the latest poses, and the trip that they make."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple, NoReturn

from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header

from ..arrays import Position
from ..errors import AmbushPlannerError, InvalidPose, InvalidRiskMap
from ..maps.ros_messages import pose_from_ros, position_from_ros
from .conversions import message_from, pose_to_ros
from .current_map import CurrentMap, map_from
from .errors import FrameMismatch, Refusal
from .parameter_changes import NodeSettings
from .transforms import FrameTransforms
from .trip import Trip, TripRequest

# Maximum number of stops on a trip: each adds a leg, with a copy of the network.
MAX_STOPS = 50


class Arrived(NamedTuple):
    """A serialised map or update of a map, and when it was sent [ns]."""

    kind: type
    data: bytes
    sent_ns: int


class Inputs:
    """The latest valid map, and the latest poses as they arrived.

    A map is checked on arrival, and a malformed one leaves the previous map current. A pose is
    checked at departure, when its map is known; a bad pose replaces the previous one, so that no
    convoy departs for an abandoned goal. ``full_name`` is that of a topic.

    Attributes
    ----------
    start, goal, via
        Where later departures begin and lead, and their stops in order; None: not given.
    map_names
        The topics of the maps that are waited for: alpha_map, and costmap if that is wanted.
    map
        The current map, with the obstacles of the costmap if that is wanted.
    asked_directly
        Whether a request brought its own start and goal; missing topics are then not reported.
    """

    def __init__(self, transforms: FrameTransforms, full_name: Callable[[str], str],
                 settings: NodeSettings) -> None:
        self._transforms, self._full_name, self._settings = transforms, full_name, settings
        wanted = settings.current.values['map.costmap']
        self.map_names = ('alpha_map', 'costmap') if wanted else ('alpha_map',)
        self._arrived: dict[str, CurrentMap | None] = dict.fromkeys(self.map_names)
        self.start: PoseStamped | None = None
        self.goal: PoseStamped | None = None
        self.via: PoseArray | None = None
        self.asked_directly = False
        self.map: CurrentMap | None = None
        self._refused: dict[str, AmbushPlannerError] = {}  # the last error of each topic
        self._joined: tuple[object, ...] = ()  # what the current map was joined from

    def accept_map(self, topic: str, arrived: list[Arrived]) -> None:
        """Take the newest map that arrived on a topic, and the updates sent since, all at once.

        rclpy hands over maps before updates, whichever was sent first. What cannot be used is left
        out. Then raises the last of its errors: Refusal if bytes are not a message, or there is no
        map to update, InvalidRiskMap if one is malformed or does not fit.
        """
        newest, name = self._arrived[topic], self._full_name(topic)
        in_order = sorted(arrived, key=lambda each: each.sent_ns)
        maps = [k for k, each in enumerate(in_order) if each.kind is OccupancyGrid]
        updates, errors = [], []
        for each in in_order[maps[-1] if maps else 0:]:
            try:
                message = message_from(each.data, each.kind, name)
                if each.kind is OccupancyGrid:
                    newest = map_from(message, name, each.sent_ns)
                elif newest is None:
                    self._no_map()
                elif each.sent_ns >= newest.sent_ns:
                    newest.check_update(message)
                    updates.append(message)
            except (InvalidRiskMap, Refusal) as error:
                errors.append(error)
        if newest is not None:
            self.take(topic, newest.updated(updates) if updates else newest)
        if errors:
            self._refused[topic] = errors[-1]
            raise errors[-1]

    def take(self, topic: str, new: CurrentMap) -> None:
        """Take the map of a topic for ``join_maps``."""
        self._arrived[topic] = new

    def join_maps(self) -> CurrentMap | None:
        """Put the costmap's obstacles, if it is wanted, on the risk map; return the current map.

        A map equal to the current one changes nothing. Raises FrameMismatch if the costmap cannot
        be transformed into the risk map's frame.
        """
        new, costmap = self._arrived['alpha_map'], self._arrived.get('costmap')
        if new is None or None in self._arrived.values():
            return None
        joined: tuple[object, ...] = (new,)
        if costmap is not None:
            current, header = self._settings.current, Header(frame_id=costmap.frame)
            origin = PoseStamped(header=header, pose=pose_to_ros(*costmap.origin))
            there = pose_from_ros(self._transforms.to_frame(
                origin, 'the costmap', new.frame, current.values['transform.max_age']).pose)
            unknown = current.occupancy.unknown_alpha is None
            joined = new, costmap, there, unknown
        if joined != self._joined:
            self._joined = joined
            if costmap is not None:
                new = new.with_costmap(replace(costmap, origin=there), unknown)
            if self.map is None or not self.map.same_map(new):
                self.map = new
        return self.map

    def missing(self) -> tuple[str, ...]:
        """Return the full names of the topics of the inputs that have not arrived.

        A risk map that no costmap joins has arrived once it is in use.
        """
        robot = self._settings.current.values['robot_base_frame']
        poses = {'start_pose': self.start or robot, 'goal_pose': self.goal}
        inputs: dict[str, Any] = {**self._arrived, **({} if self.asked_directly else poses)}
        unused = self.map is None and 'costmap' not in self._arrived
        return tuple(self._full_name(name) for name, given in inputs.items()
                     if not given or (unused and name == 'alpha_map'))

    def latest_request(self) -> TripRequest:
        """Return the trip from the latest start to the latest goal via the latest stops.

        Raises Refusal if an input has not arrived.
        """
        self.current_map()
        if self.start is None and not self._settings.current.values['robot_base_frame']:
            start, estimate = map(self._full_name, ('start_pose', 'initialpose'))
            raise Refusal('NO_START', f'no start yet: publish one on {start} or {estimate}, or set '
                          'robot_base_frame')
        if self.goal is None:
            raise Refusal('NO_GOAL', f'no goal yet: publish one on {self._full_name("goal_pose")}')
        return TripRequest(self._settings.current, self.start, self.goal, via=self.via)

    def request_between(self, start: PoseStamped, goal: PoseStamped, tolerance: float,
                        stops: PoseArray) -> TripRequest:
        """Return the trip of a request with its own poses, as if they had arrived on the topics.

        Raises Refusal without a map.
        """
        self.asked_directly = True
        self.current_map()
        via = stops if stops.poses else None
        return TripRequest(self._settings.current, start, goal, tolerance, via)

    def current_map(self) -> CurrentMap:
        """Return the current map; raises Refusal if none has arrived."""
        return self.map or self._no_map()

    def _no_map(self) -> NoReturn:
        if self._arrived['alpha_map'] is not None:
            raise Refusal('NO_MAP', 'no costmap yet, or no transform to the frame of the risk map: '
                          f'publish one on {self._full_name("costmap")}, or start with '
                          'map.costmap false')
        refused = self._refused.get('alpha_map')
        why = f'; the last one was refused: {refused}' if refused else ''
        raise Refusal('NO_MAP', 'no risk map yet: publish one on '
                      f'{self._full_name("alpha_map")}{why}')

    def locate(self, request: TripRequest) -> Trip:
        """Locate a trip on the current map, by the transforms of this moment.

        Raises Refusal if no map has arrived, and FrameMismatch or InvalidPose if a pose cannot be
        transformed into the map's frame or is not a valid pose.
        """
        present, max_age = self.current_map(), request.parameters.values['transform.max_age']
        start_pose, robot = self.start_of(request)

        def on_map(pose: PoseStamped, name: str) -> PoseStamped:
            return self._transforms.to_frame(pose, name, present.frame, max_age)

        goal_pose, via = on_map(request.goal, 'goal'), request.via or PoseArray()
        if len(via.poses) > MAX_STOPS:
            raise InvalidPose(
                f'via_poses: {len(via.poses)} stops, but at most {MAX_STOPS} are allowed')
        stops = {f'stop {number}': PoseStamped(header=via.header, pose=pose)
                 for number, pose in enumerate(via.poses, start=1)}
        own = request.start is None or not request.start.header.frame_id
        return Trip(present, replace(request, start=start_pose) if own else request, start_pose,
                    goal_pose, position_from_ros(start_pose, 'start'),
                    position_from_ros(goal_pose, 'goal'),
                    tuple(position_from_ros(on_map(stop, name), name)
                          for name, stop in stops.items()), robot)

    def start_of(self, request: TripRequest) -> tuple[PoseStamped, str]:
        """Return where a trip starts on the current map now, and the frame of its robot.

        A robot is ``robot_base_frame``, or a frame that moves in the map's; '': the start is a
        fixed place. Raises as ``locate`` does.
        """
        frame, start, values = self.current_map().frame, request.start, request.parameters.values
        own = robot_pose(values['robot_base_frame'])
        start = own if own and not (start and start.header.frame_id) else start or PoseStamped()
        on_map = self._transforms.to_frame(start, 'start', frame, values['transform.max_age'])
        robot = start.header.frame_id
        moves = robot == values['robot_base_frame'] or self._transforms.moves(robot, frame)
        return on_map, robot if moves else ''

    def robot_place(self, robot: str, frame: str, max_age: float) -> Position | None:
        """Return where a robot's frame is in another one [m]; None if that is not known."""
        pose = robot_pose(robot)
        with suppress(FrameMismatch):
            return pose and position_from_ros(
                self._transforms.to_frame(pose, 'start', frame, max_age), 'start')
        return None


def robot_pose(frame: str) -> PoseStamped | None:
    """Return the pose of the robot in its own frame; None if that has no name."""
    return PoseStamped(header=Header(frame_id=frame), pose=pose_to_ros(0.0, 0.0)) if frame else None
