# SPDX-License-Identifier: Apache-2.0
"""The map, poses and path of a departure as ROS messages, made without ROS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import yaml

from ..arrays import FloatArray
from ..maps.occupancy import OBSTACLE, UNKNOWN, OccupancyOptions
from ..maps.risk_map import RiskMap
from . import cdr
from .messages import DURATIONS, INFINITE_NS, RecordedMessage
from .schemas import MAP, PATH, POSE

_FOREVER = dict(zip(('sec', 'nsec'), divmod(INFINITE_NS, 1_000_000_000), strict=True))
# The quality of service that the node publishes paths with.
LATCHED = yaml.safe_dump([{
    'history': 'keep_last', 'depth': 1, 'reliability': 'reliable', 'durability': 'transient_local',
    **dict.fromkeys(DURATIONS, _FOREVER), 'liveliness': 'automatic',
    'avoid_ros_namespace_conventions': False}], sort_keys=False)


def map_message(risk_map: RiskMap, options: OccupancyOptions, frame: str,
                stamp_ns: int) -> RecordedMessage:
    """The map as an occupancy grid, its losses rounded to those of the values 0 to 100."""
    (origin,) = cdr.poses_along(np.array([risk_map.origin]))
    data = cdr.occupancy_grid(frame, stamp_ns, grid_values(risk_map, options), risk_map.resolution,
                              origin)
    return RecordedMessage('/alpha_map', MAP, data, LATCHED, stamp_ns)


def pose_message(topic: str, xy: Sequence[float], frame: str, stamp_ns: int) -> RecordedMessage:
    """A start or a goal."""
    (pose,) = cdr.poses_along(np.array([(*xy, 0.0)]))
    return RecordedMessage(topic, POSE, cdr.pose_stamped(frame, stamp_ns, pose), LATCHED, stamp_ns)


def path_message(rows: FloatArray, frame: str, stamp_ns: int) -> RecordedMessage:
    """A path along rows (L, 3) = (x, y, yaw)."""
    data = cdr.path(frame, stamp_ns, cdr.poses_along(rows))
    return RecordedMessage('/path', PATH, data, LATCHED, stamp_ns)


def grid_values(risk_map: RiskMap, options: OccupancyOptions) -> npt.NDArray[np.int8]:
    """The values (H, W) of an occupancy grid, -1 to 100, whose losses are nearest to the map's."""
    graded = risk_map.graded
    alpha = graded.levels if graded else risk_map.alpha
    span = (options.alpha_max - options.alpha_min) or 1.0
    share = (np.nan_to_num(alpha) - options.alpha_min) / span
    values = np.clip(np.rint(100.0 * share), 0, options.obstacle_threshold - 1).astype(np.int8)
    if graded:
        values = values[graded.grades]
    values[risk_map.obstacles] = OBSTACLE
    if risk_map.unknown is not None:
        values[risk_map.unknown] = UNKNOWN
    return values
