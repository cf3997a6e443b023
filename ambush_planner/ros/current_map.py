"""The risk map in force: read from a message, then from updates of some of its cells."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from ..errors import InvalidRiskMap
from ..maps.occupancy import OccupancyMap, check_occupancy
from ..maps.ros_messages import occupancy_from_ros
from .cdr import GridUpdate, grid_bytes, grid_cells


@dataclass(frozen=True, eq=False)
class Received:
    """A message as it came in.

    ``topic`` is the full name, ``type`` the name of the type of ``data``, the message serialised;
    ``message`` is what the planner needs of it.
    """

    topic: str
    type: str
    message: Any
    data: bytes
    qos: QoSProfile


@dataclass(frozen=True, eq=False, kw_only=True)
class CurrentMap(OccupancyMap):
    """A map that was accepted, with the message that brought it.

    ``received.message`` has the header and the info but no cells, which are in memory only once,
    in ``received.data``.
    """

    received: Received

    @property
    def frame(self) -> str:
        """The frame of positions on the map."""
        name: str = self.received.message.header.frame_id
        return name

    def same_ground(self, other: CurrentMap) -> bool:
        """Whether a cell of one map is the same piece of ground on the other."""
        return (
            self.values.shape == other.values.shape
            and (self.frame, self.resolution, self.origin)
            == (other.frame, other.resolution, other.origin)
        )

    def same_map(self, other: CurrentMap) -> bool:
        """Whether two maps differ in their time stamps at most."""
        return self.same_ground(other) and np.array_equal(self.values, other.values)


def map_from(received: Received) -> CurrentMap:
    """Read a map; raises InvalidRiskMap where it is malformed."""
    message: OccupancyGrid = received.message
    values, resolution, origin = occupancy_from_ros(message)
    shared = grid_cells(message, received.data)
    if shared is not None:
        received = replace(received, message=_without_cells(message))
        values = shared
    return CurrentMap(values, resolution, origin, received=received)


def changed_map(present: CurrentMap, update: GridUpdate) -> CurrentMap:
    """Return the map with the cells of the update; raises InvalidRiskMap where it does not fit."""
    if update.frame != present.frame:
        raise InvalidRiskMap(
            f'map update: it is given in the frame {update.frame[:80]!r}, the map in '
            f'{present.frame!r}'
        )
    (rows, columns), (height, width) = update.values.shape, present.values.shape
    if update.x < 0 or update.y < 0 or update.x + columns > width or update.y + rows > height:
        raise InvalidRiskMap(
            f'map update: {columns} x {rows} cells from ({update.x}, {update.y}) on do not lie '
            f'within the map of {width} x {height}'
        )
    try:
        check_occupancy(update.values, present.resolution, present.origin)
    except InvalidRiskMap as error:
        raise InvalidRiskMap(f'map update: {error}') from error
    values = present.values.copy()
    values[update.y:update.y + rows, update.x:update.x + columns] = update.values
    head = _without_cells(present.received.message)
    head.header = Header(frame_id=update.frame, stamp=update.stamp)
    data = grid_bytes(head, values)
    shared = grid_cells(head, data)
    received = replace(present.received, message=head, data=data)
    return CurrentMap(
        values if shared is None else shared, present.resolution, present.origin,
        received=received,
    )


def _without_cells(message: OccupancyGrid) -> OccupancyGrid:
    return OccupancyGrid(header=message.header, info=copy(message.info))
