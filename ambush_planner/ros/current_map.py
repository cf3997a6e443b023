# SPDX-License-Identifier: Apache-2.0
"""The current risk map: read from a message, then changed by updates of some of its cells."""

from __future__ import annotations

import array
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

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


def map_from(received: ReceivedMessage) -> CurrentMap:
    """Read a map; raises InvalidRiskMap if it is malformed."""
    return CurrentMap(*occupancy_from_ros(received.message), received=received)


def joined_map(risk: CurrentMap, costmap: OccupancyMap, unknown: bool) -> CurrentMap:
    """Return a risk map with the obstacles of a costmap in the same frame, as if it had arrived."""
    values = with_obstacles_of(risk, costmap, COSTMAP_OBSTACLE, unknown).values
    before = risk.received.message
    message = OccupancyGrid(header=before.header, info=before.info,
                            data=array.array('b', values.tobytes()))
    received = replace(risk.received, message=message, serialised=None)
    return replace(risk, values=values, received=received)


def updated_map(present: CurrentMap, update: Any) -> CurrentMap:
    """Return the map with the cells of a map_msgs/OccupancyGridUpdate.

    Raises InvalidRiskMap if the update is malformed or does not fit the map.
    """
    (rows, columns), x, y = (update.height, update.width), update.x, update.y
    if fault := update_fault(update, present.frame, present.values.shape):
        raise InvalidRiskMap(f'map update: {fault}')
    new = np.frombuffer(update.data, np.int8).reshape(rows, columns)
    try:
        check_occupancy(new, present.resolution, present.origin)
    except InvalidRiskMap as error:
        raise InvalidRiskMap(f'map update: {error}') from error
    cells = present.received.message.data[:]
    values = np.frombuffer(cells, np.int8).reshape(present.values.shape)
    values[y:y + rows, x:x + columns] = new
    message = OccupancyGrid(header=update.header, info=present.received.message.info, data=cells)
    received = replace(present.received, message=message, serialised=None)
    return CurrentMap(values, present.resolution, present.origin, received=received)
