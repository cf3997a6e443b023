# SPDX-License-Identifier: Apache-2.0
"""What has arrived: the current map, the latest poses, and the trip that they make."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from std_msgs.msg import Header

from ..arrays import FloatArray
from ..errors import InvalidPose, InvalidRiskMap
from ..maps.ros_messages import path_from_ros, pose_from_ros, position_from_ros
from ..planning.clear_ground import WAY_OUT, ClearGround
from ..planning.trip_under_way import Position
from ..recordings import type_name
from .conversions import pose_to_ros
from .current_map import CurrentMap, ReceivedMessage, map_from
from .error_codes import FrameMismatch, Refusal
from .parameter_changes import NodeSettings
from .topics import LATEST
from .transforms import FrameTransforms
from .trip import Trip, TripRequest

# Maximum number of stops on a trip: each adds a leg, with a copy of the network.
MAX_STOPS = 50


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
        self.start: ReceivedMessage | None = None
        self.goal: ReceivedMessage | None = None
        self.via: ReceivedMessage | None = None
        self.asked_directly = False
        self.map: CurrentMap | None = None
        self._refused: dict[str, InvalidRiskMap] = {}  # the last one of each topic
        self._joined: tuple[object, ...] = ()  # what the current map was joined from

    def accept_map(self, topic: str, received: ReceivedMessage) -> None:
        """Take a map, or a map_msgs/OccupancyGridUpdate of one, for ``join_maps``.

        Raises InvalidRiskMap if it is malformed or does not fit the map, and Refusal if there is
        none to update. The current map then stays.
        """
        if not isinstance(received.message, OccupancyGrid):
            present = self._arrived[topic] or self._no_map()
            self._arrived[topic] = present.updated(received.message)
            return
        try:
            self._arrived[topic] = map_from(received)
        except InvalidRiskMap as error:
            self._refused[topic] = error
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
            current, header = self._settings.current, Header(frame_id=costmap.frame)
            origin = PoseStamped(header=header, pose=pose_to_ros(*costmap.origin))
            there = pose_from_ros(self._transforms.to_frame(
                origin, 'the costmap', new.frame, current.values['transform.max_age']).pose)
            joined = new, costmap, there, current.occupancy.unknown_alpha is None
            if self.map is not None and joined == self._joined:
                return self.map
            self._joined = joined
            new = new.with_costmap(replace(costmap, origin=there), joined[-1])
        if self.map is None or not self.map.same_map(new):
            self.map = new
        return self.map

    def missing(self) -> tuple[str, ...]:
        """Return the full names of the topics of the inputs that have not arrived."""
        robot = self._settings.current.values['robot_base_frame']
        poses = {'start_pose': self.start or robot, 'goal_pose': self.goal}
        inputs = {**self._arrived, **({} if self.asked_directly else poses)}
        return tuple(self._full_name(name) for name, given in inputs.items() if not given)

    def latest(self) -> TripRequest:
        """Return the trip from the latest start to the latest goal via the latest stops.

        Raises Refusal if an input has not arrived, and InvalidOption while parameters contradict
        each other.
        """
        self.current_map()
        if self.start is None and not self._settings.current.values['robot_base_frame']:
            start, estimate = map(self._full_name, ('start_pose', 'initialpose'))
            raise Refusal('NO_START', f'no start yet: publish one on {start} or {estimate}, or set '
                          'robot_base_frame')
        if self.goal is None:
            raise Refusal('NO_GOAL', f'no goal yet: publish one on {self._full_name("goal_pose")}')
        return TripRequest(self._settings.agreeing(), self.start, self.goal, via=self.via)

    def given(self, start: PoseStamped, goal: PoseStamped, tolerance: float,
              stops: PoseArray) -> TripRequest:
        """Return the trip of a request with its own poses, as if they had arrived on the topics.

        Raises Refusal without a map, and InvalidOption while parameters contradict each other.
        """
        self.asked_directly = True
        self.current_map()
        received = [
            ReceivedMessage(self._full_name(topic), type_name(message), message, LATEST)
            for topic, message in (('start_pose', start), ('goal_pose', goal), ('via_poses', stops))
        ]
        via = received[2] if stops.poses else None
        return TripRequest(self._settings.agreeing(), received[0], received[1], tolerance, via)

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
        present, start, values = self.current_map(), request.start, request.parameters.values
        robot, max_age = values['robot_base_frame'], values['transform.max_age']

        def on_map(pose: PoseStamped, name: str) -> PoseStamped:
            return self._transforms.to_frame(pose, name, present.frame, max_age)

        frame = start.message.header.frame_id if start else ''
        if start is None or (robot and not frame):
            start_pose, frame = on_map(robot_pose(robot), 'start'), robot
            start = ReceivedMessage(self._full_name('start_pose'), type_name(start_pose),
                                    start_pose, LATEST)
        else:
            start_pose = on_map(start.message, 'start')
        goal_pose = on_map(request.goal.message, 'goal')
        via = request.via.message if request.via else PoseArray()
        if len(via.poses) > MAX_STOPS:
            raise InvalidPose(
                f'via_poses: {len(via.poses)} stops, but at most {MAX_STOPS} are allowed')
        stops = {f'stop {number}': PoseStamped(header=via.header, pose=pose)
                 for number, pose in enumerate(via.poses, start=1)}
        return Trip(present, replace(request, start=start), start_pose, goal_pose,
                    position_from_ros(start_pose, 'start'), position_from_ros(goal_pose, 'goal'),
                    tuple(position_from_ros(on_map(stop, name), name)
                          for name, stop in stops.items()),
                    '' if frame == present.frame else frame)

    def robot_place(self, robot: str, frame: str, max_age: float) -> Position | None:
        """Return where a robot's frame is in another one [m]; None if that is not known."""
        pose = robot_pose(robot)
        with suppress(FrameMismatch):
            return pose and position_from_ros(
                self._transforms.to_frame(pose, 'start', frame, max_age), 'start')
        return None

    def invalid_poses(self, path: Path) -> list[int] | None:
        """Return the indices of a path's poses, from the robot on, that cannot be reached.

        The newest map counts. None if the path has no poses: Nav2's trees ask so before their first
        path. Raises Refusal without a map, FrameMismatch if the path is not in the map's frame, and
        InvalidPose.
        """
        if not path.poses:
            return None
        newest, parameters = self.current_map(), self._settings.current
        if path.header.frame_id != newest.frame:
            raise FrameMismatch(f'the path is in the frame {path.header.frame_id[:80]!r}, the map '
                                f'in {newest.frame!r}')
        points = path_from_ros(path)[:, :2]
        if not np.isfinite(points).all():
            raise InvalidPose('path: positions must be finite')
        values = parameters.values
        place = self.robot_place(values['robot_base_frame'], newest.frame,
                                 values['transform.max_age'])
        first = _first_near(points, place) if place else 0
        rest = points[first:]
        ground = ClearGround(newest, parameters.occupancy, parameters.planning.network)
        if len(rest) == 1:
            return [] if ground.segments(rest, rest).all() else [first]
        return (np.flatnonzero(~ground.drivable_steps(rest)) + first + 1).tolist()


def _first_near(points: FloatArray, place: Position) -> int:
    """Return the pose of a path (L, 2) where it first passes a place [m].

    The nearest pose of a way out and back may be on the way back.
    """
    away, steps = np.hypot(*(points - place).T), np.hypot(*np.diff(points, axis=0).T)
    near = away <= max(WAY_OUT + steps.max(initial=0.0), away.min())
    first = int(near.argmax())
    return first + int(np.append(np.diff(away[first:]) < 0.0, False).argmin())


def robot_pose(frame: str) -> PoseStamped | None:
    """Return the pose of the robot in its own frame; None if that has no name."""
    return PoseStamped(header=Header(frame_id=frame), pose=pose_to_ros(0.0, 0.0)) if frame else None
