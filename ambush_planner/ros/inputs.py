"""What has arrived: the risk map in force, the latest start and goal, and the trip they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile

from ..core.errors import InvalidRiskMap
from ..core.obstacles import ObstacleField
from ..core.risk_map import OccupancyOptions, RiskMap
from .conversions import position_from_ros, risk_map_from_ros
from .errors import NoGoal, NoMap, NoStart


@dataclass(frozen=True, eq=False)
class Received:
    """A message as it came in; ``topic`` is the full name."""

    topic: str
    message: Any
    qos: QoSProfile


@dataclass(frozen=True, eq=False)
class MapInForce:
    """A map that was accepted, and the risk map that was read from it."""

    received: Received
    risk_map: RiskMap

    @property
    def frame(self) -> str:
        """The frame that all poses have to be given in."""
        return self.received.message.header.frame_id


@dataclass(frozen=True, eq=False)
class Trip:
    """From where to where, on which map; positions [m] in the map's frame.

    ``start`` and ``goal`` are what was received as such; where a goal was moved, ``goal_pose``
    differs from it.
    """

    map: MapInForce
    start: Received
    goal: Received
    start_pose: PoseStamped
    goal_pose: PoseStamped
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]


def make_trip(
    map_in_force: MapInForce,
    start: tuple[Received, PoseStamped],
    goal: tuple[Received, PoseStamped],
) -> Trip:
    """Check both poses against the map's frame.

    Raises
    ------
    FrameMismatch, InvalidPose
        A pose is not given in the map's frame, or its numbers are no pose.
    """
    frame = map_in_force.frame
    return Trip(
        map=map_in_force,
        start=start[0],
        goal=goal[0],
        start_pose=start[1],
        goal_pose=goal[1],
        start_xy=position_from_ros(start[1], 'start', frame),
        goal_xy=position_from_ros(goal[1], 'goal', frame),
    )


class Inputs:
    """The latest map that is valid, and the latest poses as they came.

    A map is checked when it arrives, and a bad one leaves the last good one in force. A pose is
    checked when somebody departs, since only then its map is known; a bad one replaces the last
    one, so that nobody departs for a goal that has been given up.
    """

    def __init__(self, occupancy: OccupancyOptions) -> None:
        self._occupancy = occupancy
        self._map: MapInForce | None = None
        self._refused: InvalidRiskMap | None = None
        self._start: tuple[Received, PoseStamped] | None = None
        self._goal: tuple[Received, PoseStamped] | None = None

    def accept_map(self, received: Received) -> None:
        """Put a map in force; one that equals the present one changes nothing.

        Raises
        ------
        InvalidRiskMap
            The map is malformed; the one before stays in force.
        """
        present = self._map
        if present is None or not _same_map(present.received.message, received.message):
            try:
                risk_map = risk_map_from_ros(received.message, self._occupancy)
            except InvalidRiskMap as error:
                self._refused = error
                raise
            self._map = MapInForce(received, risk_map)
        self._refused = None

    def set_occupancy(self, occupancy: OccupancyOptions) -> None:
        """Read the map in force anew if its cells now mean something else."""
        if occupancy != self._occupancy:
            self._occupancy = occupancy
            if self._map is not None:
                received = self._map.received
                self._map = MapInForce(received, risk_map_from_ros(received.message, occupancy))

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
        NoMap, NoStart, NoGoal, FrameMismatch, InvalidPose
            Something has not arrived, or is not usable.
        """
        present = self._map_in_force()
        if self._start is None:
            raise NoStart('no start yet: publish one on start_pose or initialpose')
        if self._goal is None:
            raise NoGoal('no goal yet: publish one on goal_pose')
        return make_trip(present, self._start, self._goal)

    def trip_between(
        self, start: tuple[Received, PoseStamped], goal: tuple[Received, PoseStamped]
    ) -> Trip:
        """Return the trip between two given poses; raises as ``trip`` does."""
        return make_trip(self._map_in_force(), start, goal)

    def _map_in_force(self) -> MapInForce:
        if self._map is None:
            why = f'; the last one was refused: {self._refused}' if self._refused else ''
            raise NoMap(f'no risk map yet: publish one on alpha_map{why}')
        return self._map


def nearest_free_cell(
    risk_map: RiskMap, xy: tuple[float, float], tolerance: float, clearance: float
) -> tuple[float, float]:
    """Return ``xy`` if nobody is blocked there, else the nearest free cell's centre [m].

    A cell is free if its centre keeps the clearance from obstacles. Where none is within
    ``tolerance`` [m] of ``xy``, or ``xy`` is not on the map, it comes back as it is.
    """
    uv = risk_map.to_map_axes(xy)
    field = ObstacleField(risk_map)
    if not risk_map.contains(uv) or field.clear_points(uv[None], clearance)[0]:
        return xy
    centres = _cell_centres(risk_map, uv, tolerance)
    distance = np.hypot(*(centres - uv).T)
    near = np.argsort(distance, kind='stable')[: int((distance <= tolerance).sum())]
    free = near[field.clear_points(centres[near], clearance)]
    if len(free) == 0:
        return xy
    x, y = risk_map.to_world(centres[free[0]]).tolist()
    return x, y


def _cell_centres(risk_map: RiskMap, uv: np.ndarray, reach: float) -> np.ndarray:
    """Centres (K, 2) in map axes of the free cells of the square within ``reach`` of ``uv``."""
    size = risk_map.size
    low_row, low_column = risk_map.cells(np.clip(uv - reach, 0.0, size))
    high_row, high_column = risk_map.cells(np.clip(uv + reach, 0.0, size))
    part = risk_map.obstacles[low_row:high_row + 1, low_column:high_column + 1]
    rows, columns = np.nonzero(~part)
    cells = np.stack((columns + low_column, rows + low_row), axis=1)
    return (cells + 0.5) * risk_map.resolution


def _same_map(one: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Tell whether two maps differ in their time stamps at most."""
    a, b = one.info, other.info
    return (
        (a.width, a.height, a.resolution) == (b.width, b.height, b.resolution)
        and one.header.frame_id == other.header.frame_id
        and a.origin == b.origin
        and bytes(one.data) == bytes(other.data)
    )
