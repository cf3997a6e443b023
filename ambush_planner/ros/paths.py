"""The path of a departure: made from its route as an array, and turned into bytes or a message."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Pose
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Header

from ..core.arrays import frozen_array
from ..core.errors import InvalidOption
from ..core.risk_map import FloatArray
from ..core.routes import densify
from .cdr import path_bytes
from .conversions import path_to_ros

# Nobody drives by more; and making a message of them would keep all else waiting for seconds.
MOST_POSES = 20_000


@dataclass(frozen=True, eq=False)
class DeparturePath:
    """``rows`` (L, 3) = (x, y, yaw) [m, m, rad] between the poses ``start`` and ``goal``.

    The first pose is the start's and the last one the goal's, as they were given.
    """

    header: Header
    rows: FloatArray
    start: Pose
    goal: Pose

    def to_message(self) -> PathMessage:
        """Return the path as a message, which takes some 10 microseconds a pose."""
        return path_to_ros(self.rows, self.start, self.goal, self.header)

    def to_bytes(self) -> bytes:
        """Return the same message serialised."""
        ends = path_to_ros(self.rows[[0, -1]], self.start, self.goal, self.header)
        return path_bytes(ends, _numbers(self.rows[1:-1]))


def departure_path(
    points: FloatArray, spacing: float, start: Pose, goal: Pose, header: Header
) -> DeparturePath:
    """Put poses along the route ``points`` (K, 2), at most ``spacing`` [m] apart.

    The path ends where the route does, with the goal's orientation: a goal that was blocked has
    been moved there.

    Raises
    ------
    InvalidOption
        That would be more than ``MOST_POSES``.
    """
    count = float(np.ceil(np.hypot(*np.diff(points, axis=0).T) / spacing).sum())
    if not count < MOST_POSES:
        raise InvalidOption(
            f'route.path_spacing {spacing:g} m makes a path of {count:.3g} poses, and '
            f'{MOST_POSES} are the most; choose a larger one'
        )
    goal = deepcopy(goal)
    goal.position.x, goal.position.y = points[-1].tolist()
    return DeparturePath(header, frozen_array(densify(points, spacing), np.float64), start, goal)


def _numbers(rows: FloatArray) -> FloatArray:
    """Positions and quaternions (L, 7) of poses (L, 3) in the plane, in a message's order."""
    numbers = np.zeros((len(rows), 7), dtype='<f8')
    numbers[:, :2] = rows[:, :2]
    half = (0.5 * rows[:, 2]).tolist()
    # Not numpy's: they may differ from those of the message in the last digit.
    numbers[:, 5], numbers[:, 6] = [*map(math.sin, half)], [*map(math.cos, half)]
    return numbers
