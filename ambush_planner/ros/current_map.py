# SPDX-License-Identifier: Apache-2.0
"""The current risk map: read from a message, then changed by updates of some of its cells."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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
    message: bytearray = field(repr=False)

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
        result, cells = self._copy()
        cells[:] = with_obstacles_of(self, costmap, COSTMAP_OBSTACLE, unknown).values
        return result

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
        result, cells = self._copy()
        for each in updates:
            cells[each.y:each.y + each.height, each.x:each.x + each.width] = _cells_of(each)
            stamp = each.header.stamp
            struct.pack_into('<iI', result.message, _STAMP, stamp.sec, stamp.nanosec)
        return result

    def _copy(self) -> tuple[CurrentMap, npt.NDArray[np.int8]]:
        """Return a copy, and its cells (H, W), which may be changed."""
        message = bytearray(self.message)
        cells = _last_cells(message, self.values.shape)
        return replace(self, message=message, values=_frozen_view(cells)), cells


def map_from(message: OccupancyGrid, topic: str, sent_ns: int = 0) -> CurrentMap:
    """Read a map; raises InvalidRiskMap if it is malformed."""
    cells, resolution, origin = occupancy_from_ros(message)
    head = serialize_message(OccupancyGrid(header=message.header, info=message.info))
    # The cells come last: their number, which is 0 here, and then they.
    data = bytearray(head[:-4] + struct.pack('<I', cells.size) + cells.tobytes())
    return CurrentMap(_frozen_view(_last_cells(data, cells.shape)), resolution, origin,
                      topic=topic, frame=message.header.frame_id, sent_ns=sent_ns, message=data)


def _last_cells(message: bytearray, shape: tuple[int, ...]) -> npt.NDArray[np.int8]:
    """Return the cells (H, W) of a serialised grid, a part of its memory."""
    return np.frombuffer(message, np.int8)[-math.prod(shape):].reshape(shape)


def _cells_of(update: Any) -> npt.NDArray[np.int8]:
    return np.frombuffer(update.data, np.int8).reshape(update.height, update.width)


def _frozen_view(cells: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    view = cells.view()
    view.setflags(write=False)
    return view
