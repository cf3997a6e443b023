# SPDX-License-Identifier: Apache-2.0
"""The current risk map: read from a message, then changed by updates of some of its cells."""

from __future__ import annotations

import array
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from ..errors import InvalidRiskMap
from ..maps.occupancy import OccupancyMap, check_occupancy
from ..maps.overlay import with_obstacles_of
from ..maps.ros_messages import occupancy_from_ros, update_fault
from ..parameters.values import COSTMAP_OBSTACLE


@dataclass(frozen=True, eq=False)
class ReceivedMessage:
    """A message with the full name of its topic.

    ``serialised`` are the bytes that arrived, of the message type called ``type``; None if the
    planner made the message itself.
    """

    topic: str
    type: str
    message: Any
    qos: QoSProfile
    serialised: bytes | None = None

    @cached_property
    def data(self) -> bytes:
        """The serialised message."""
        if self.serialised is not None:
            return self.serialised
        return bytes(serialize_message(self.message))


@dataclass(frozen=True, eq=False, kw_only=True)
class CurrentMap(OccupancyMap):
    """A valid map with the message that it came in."""

    received: ReceivedMessage

    @property
    def frame(self) -> str:
        """The frame of positions on the map."""
        name: str = self.received.message.header.frame_id
        return name

    def same_ground(self, other: CurrentMap) -> bool:
        """Whether each cell covers the same ground on both maps."""
        return (self.values.shape == other.values.shape
                and (self.frame, self.resolution, self.origin)
                == (other.frame, other.resolution, other.origin))

    def same_map(self, other: CurrentMap) -> bool:
        """Whether two maps differ at most in their time stamps."""
        return self.same_ground(other) and np.array_equal(self.values, other.values)

    def with_costmap(self, costmap: OccupancyMap, unknown: bool) -> CurrentMap:
        """Return the map with the obstacles of a costmap in the same frame."""
        values = with_obstacles_of(self, costmap, COSTMAP_OBSTACLE, unknown).values
        return self._with_values(values, self.received.message.header)

    def updated(self, update: Any) -> CurrentMap:
        """Return the map with the cells of a map_msgs/OccupancyGridUpdate.

        Raises InvalidRiskMap if the update is malformed or does not fit the map.
        """
        if fault := update_fault(update, self.frame, self.values.shape):
            raise InvalidRiskMap(f'map update: {fault}')
        cells = np.frombuffer(update.data, np.int8).reshape(update.height, update.width)
        try:
            check_occupancy(cells, self.resolution, self.origin)
        except InvalidRiskMap as error:
            raise InvalidRiskMap(f'map update: {error}') from error
        values, x, y = self.values.copy(), update.x, update.y
        values[y:y + update.height, x:x + update.width] = cells
        return self._with_values(values, update.header)

    def _with_values(self, values: npt.NDArray[np.int8], header: Header) -> CurrentMap:
        """Return the map with other cell values (H, W), as if it had arrived with them."""
        data = array.array('b', values.tobytes())
        message = OccupancyGrid(header=header, info=self.received.message.info, data=data)
        return replace(self, values=np.frombuffer(data, np.int8).reshape(values.shape),
                       received=replace(self.received, message=message, serialised=None))


def map_from(received: ReceivedMessage) -> CurrentMap:
    """Read a map; raises InvalidRiskMap if it is malformed."""
    return CurrentMap(*occupancy_from_ros(received.message), received=received)
