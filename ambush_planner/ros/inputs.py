"""What has arrived: the risk map in force, the latest start and goal, and the trip they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile

from ..core.errors import InvalidRiskMap
from .conversions import occupancy_from_ros, position_from_ros
from .errors import NoGoal, NoMap, NoStart
from .transforms import FrameTransforms


@dataclass(frozen=True, eq=False)
class Received:
    """A message as it came in; ``topic`` is the full name, ``data`` the message serialised."""

    topic: str
    message: Any
    data: bytes
    qos: QoSProfile


@dataclass(frozen=True, eq=False)
class MapInForce:
    """A map that was accepted: its cells (H, W), resolution [m] and origin (x, y, yaw)."""

    received: Received
    values: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]

    @property
    def frame(self) -> str:
        """The frame of positions on the map."""
        return self.received.message.header.frame_id


@dataclass(frozen=True, eq=False)
class Trip:
    """From where to where, on which map; poses and positions [m] in the map's frame.

    ``start`` and ``goal`` are what was received as such. The goal may be moved by
    ``goal_tolerance`` [m] where it is blocked.
    """

    map: MapInForce
    start: Received
    goal: Received
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float = 0.0


class Inputs:
    """The latest map that is valid, and the latest poses as they came.

    A map is checked when it arrives, and a bad one leaves the last good one in force. A pose is
    checked when somebody departs, since only then its map is known; a bad one replaces the last
    one, so that nobody departs for a goal that has been given up.
    """

    def __init__(self, transforms: FrameTransforms) -> None:
        self._transforms = transforms
        self._map: MapInForce | None = None
        self._refused: InvalidRiskMap | None = None
        self._start: tuple[Received, PoseStamped] | None = None
        self._goal: tuple[Received, PoseStamped] | None = None

    def accept_map(self, received: Received) -> MapInForce:
        """Put a map in force and return it; one that equals the present one changes nothing.

        Raises
        ------
        InvalidRiskMap
            The map is malformed; the one before stays in force.
        """
        present = self._map
        if present is None or not _same_map(present.received.message, received.message):
            try:
                values, resolution, origin = occupancy_from_ros(received.message)
            except InvalidRiskMap as error:
                self._refused = error
                raise
            present = self._map = MapInForce(received, values, resolution, origin)
        self._refused = None
        return present

    def set_start(self, received: Received, pose: PoseStamped) -> None:
        """Depart from here from now on."""
        self._start = (received, pose)

    def set_goal(self, received: Received, pose: PoseStamped) -> None:
        """Drive there from now on."""
        self._goal = (received, pose)

    @property
    def missing(self) -> tuple[str, ...]:
        """What has not arrived yet, by the names of the topics."""
        parts = {'alpha_map': self._map, 'start_pose': self._start, 'goal_pose': self._goal}
        return tuple(name for name, part in parts.items() if part is None)

    def trip(self) -> Trip:
        """Return the trip between the latest start and goal.

        Raises
        ------
        NoMap, NoStart, NoGoal
            Something has not arrived.
        FrameMismatch, InvalidPose
            A pose cannot be brought into the map's frame, or its numbers are no pose.
        """
        present = self._map_in_force()
        if self._start is None:
            raise NoStart('no start yet: publish one on start_pose or initialpose')
        if self._goal is None:
            raise NoGoal('no goal yet: publish one on goal_pose')
        return self._trip(present, *self._start, *self._goal)

    def trip_between(self, start: Received, goal: Received, goal_tolerance: float) -> Trip:
        """Return the trip between two given poses; raises as ``trip`` does."""
        present = self._map_in_force()
        return self._trip(present, start, start.message, goal, goal.message, goal_tolerance)

    def _map_in_force(self) -> MapInForce:
        if self._map is None:
            why = f'; the last one was refused: {self._refused}' if self._refused else ''
            raise NoMap(f'no risk map yet: publish one on alpha_map{why}')
        return self._map

    def _trip(
        self,
        map_in_force: MapInForce,
        start: Received,
        start_pose: PoseStamped,
        goal: Received,
        goal_pose: PoseStamped,
        goal_tolerance: float = 0.0,
    ) -> Trip:
        frame = map_in_force.frame
        start_pose = self._transforms.to_frame(start_pose, 'start', frame)
        goal_pose = self._transforms.to_frame(goal_pose, 'goal', frame)
        return Trip(
            map=map_in_force,
            start=start,
            goal=goal,
            start_pose=start_pose,
            goal_pose=goal_pose,
            start_xy=position_from_ros(start_pose, 'start'),
            goal_xy=position_from_ros(goal_pose, 'goal'),
            goal_tolerance=goal_tolerance,
        )


def _same_map(one: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Tell whether two maps differ in their time stamps at most."""
    a, b = one.info, other.info
    return (
        (a.width, a.height, a.resolution) == (b.width, b.height, b.resolution)
        and one.header.frame_id == other.header.frame_id
        and a.origin == b.origin
        and np.array_equal(np.frombuffer(one.data, np.int8), np.frombuffer(other.data, np.int8))
    )
