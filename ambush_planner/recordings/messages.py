# SPDX-License-Identifier: Apache-2.0
"""Messages as a recording has them: received or published by a node, or made without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from ..arrays import FloatArray
from ..maps.occupancy import OBSTACLE, UNKNOWN, OccupancyOptions
from ..maps.risk_map import RiskMap
from . import cdr
from .schemas import MAP, PATH, POSE

# DDS' infinite duration, 2**63 - 1 ns.
_FOREVER = {'sec': 9_223_372_036, 'nsec': 854_775_807}


class Channel(NamedTuple):
    """A topic with one type and one quality of service, as the text of ``offered_qos_profiles``."""

    topic: str
    type: str
    qos: str


@dataclass(frozen=True)
class RecordedMessage:
    """A message as it was received or published at ``stamp_ns`` by the node's clock.

    ``topic`` is its full name, ``type`` the ROS name of its type, ``data`` the serialised message
    (CDR), and ``qos`` the text of the publisher's profile. Copies of it at other times share
    ``packed``: the data, and its compressed form.
    """

    topic: str
    type: str
    data: bytes
    qos: str
    stamp_ns: int
    packed: list[bytes] = field(default_factory=list, compare=False, repr=False)

    @property
    def channel(self) -> Channel:
        """The channel on which the message is recorded."""
        return Channel(self.topic, self.type, self.qos)


@lru_cache
def qos_text(depth: int, latched: bool) -> str:
    """Return the ``offered_qos_profiles`` of a reliable publisher; rosbag2 demands every field."""
    return yaml.safe_dump([{
        'history': 'keep_last', 'depth': depth, 'reliability': 'reliable',
        'durability': 'transient_local' if latched else 'volatile',
        'deadline': {**_FOREVER}, 'lifespan': {**_FOREVER}, 'liveliness': 'automatic',
        'liveliness_lease_duration': {**_FOREVER}, 'avoid_ros_namespace_conventions': False,
    }], sort_keys=False)


# The quality of service that the node publishes paths with.
LATCHED = qos_text(1, latched=True)


@lru_cache(maxsize=256)
def fields_from_yaml(text: str) -> dict[str, Any]:
    """Return the fields of the first profile in a channel's ``offered_qos_profiles``."""
    fields: dict[str, Any] = yaml.safe_load(text)[0]
    return fields


def type_name(message: Any) -> str:
    """Return the ROS name of the type of a message or message class."""
    type_ = message if isinstance(message, type) else type(message)
    package, kind = type_.__module__.split('.')[:2]
    return f'{package}/{kind}/{type_.__name__}'


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
