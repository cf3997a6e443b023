# SPDX-License-Identifier: Apache-2.0
"""The current risk map: read from a message, then changed by updates of some of its cells."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import serialize_message

from ..errors import InvalidRiskMap
from ..maps.occupancy import OccupancyMap, check_occupancy
from ..maps.overlay import with_obstacles_of
from ..maps.ros_messages import occupancy_from_ros, update_fault
from ..parameters.values import COSTMAP_OBSTACLE
from ..recordings.messages import RecordedMessage, type_name
from .topics import LATCHED, offered

# Where the bytes of a message have the time of its header.
_STAMP = 4


@dataclass(frozen=True, eq=False, kw_only=True)
class CurrentMap(OccupancyMap):
    """A valid map in a ``frame``, which came on a ``topic`` and was sent at a time [ns].

    ``message`` is the serialised nav_msgs/OccupancyGrid, and ``values`` are a part of it: large
    maps are in memory once.
    """

    topic: str
    frame: str
    sent_ns: int
    message: bytes = field(repr=False)

    @cached_property
    def recorded(self) -> RecordedMessage:
        """The message as recordings keep it, compressed once for all of them."""
        return RecordedMessage(self.topic, type_name(OccupancyGrid), self.message,
                               offered(LATCHED), 0)

    def same_ground(self, other: CurrentMap) -> bool:
        """Return whether each cell covers the same ground on both maps."""
        return (self.values.shape == other.values.shape
                and (self.frame, self.resolution, self.origin)
                == (other.frame, other.resolution, other.origin))

    def same_map(self, other: CurrentMap) -> bool:
        """Return whether two maps differ at most in their time stamps."""
        return self.same_ground(other) and np.array_equal(self.values, other.values)

    def with_costmap(self, costmap: OccupancyMap, unknown: bool) -> CurrentMap:
        """Return the map with the obstacles of a costmap in the same frame."""
        return self._with(with_obstacles_of(self, costmap, COSTMAP_OBSTACLE, unknown).values)

    def check_update(self, update: Any) -> None:
        """Raise InvalidRiskMap if a map_msgs/OccupancyGridUpdate is malformed or does not fit."""
        try:
            if fault := update_fault(update, self.frame, self.values.shape):
                raise InvalidRiskMap(fault)
            check_occupancy(_cells_of(update), self.resolution, self.origin)
        except InvalidRiskMap as error:
            raise InvalidRiskMap(f'map update: {error}') from error

    def updated(self, updates: Iterable[Any]) -> CurrentMap:
        """Return the map with the cells of updates that fit, as if it had been sent with them."""
        cells, stamp = self.values.copy(), b''
        for each in updates:
            cells[each.y:each.y + each.height, each.x:each.x + each.width] = _cells_of(each)
            stamp = struct.pack('<iI', each.header.stamp.sec, each.header.stamp.nanosec)
        return self._with(cells, stamp)

    def _with(self, cells: npt.NDArray[np.int8], stamp: bytes = b'') -> CurrentMap:
        """Return the map with other cells (H, W), and with another time unless it is empty."""
        head = bytearray(self.message[:-cells.size])
        head[_STAMP:_STAMP + len(stamp)] = stamp
        message = b''.join((head, cells.data))
        return replace(self, message=message, values=_last_cells(message, cells.shape))


def map_from(message: OccupancyGrid, topic: str, sent_ns: int = 0) -> CurrentMap:
    """Read a map; raises InvalidRiskMap if it is malformed."""
    cells, resolution, origin = occupancy_from_ros(message)
    head = serialize_message(OccupancyGrid(header=message.header, info=message.info))
    # The cells come last: their number, which is 0 here, and then they.
    data = b''.join((head[:-4], struct.pack('<I', cells.size), cells.data))
    return CurrentMap(_last_cells(data, cells.shape), resolution, origin, topic=topic,
                      frame=message.header.frame_id, sent_ns=sent_ns, message=data)


def _last_cells(message: bytes, shape: tuple[int, ...]) -> npt.NDArray[np.int8]:
    """Return the cells (H, W) of a serialised grid, a part of its memory."""
    return np.frombuffer(message, np.int8)[-math.prod(shape):].reshape(shape)


def _cells_of(update: Any) -> npt.NDArray[np.int8]:
    return np.frombuffer(update.data, np.int8).reshape(update.height, update.width)
