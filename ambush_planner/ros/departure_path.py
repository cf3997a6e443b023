"""The path of a departure: drawn, an array between two poses, turned into bytes or a message."""

from __future__ import annotations

import math
import secrets
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Header

from ..arrays import FloatArray, frozen_array
from ..planning.plan import Route, departure_path
from .cdr import path_bytes
from .conversions import path_to_ros
from .inputs import Trip
from .plan_cache import CachedPlan


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


def route_entropy_source(seed: int, departure: int) -> list[int]:
    """Return what the generator of one departure is made from.

    With seed -1 these are 256 bits from the operating system. With a fixed seed they follow from
    the departure's number, so that the same sequence of departures gives the same routes and each
    can be drawn again on its own. Nothing else goes in: no time, no input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, departure]


def draw_path(
    held: CachedPlan, trip: Trip, source: list[int], spacing: float, stamp: Time
) -> tuple[Route, DeparturePath] | None:
    """Draw a route that is clear on the newest map, with its path; None where hardly any is.

    ``source`` is that of its randomness. The path has a pose at least every ``spacing`` [m];
    0: as the plan has it.
    """
    route = held.ground.draw(np.random.default_rng(source), trip.map)
    if route is None:
        return None
    ends = held.ends(trip)
    rows = departure_path(
        held.ground.fitted(trip.map, ends), route, spacing or held.plan.spacing, ends
    )
    header = Header(frame_id=trip.map.frame, stamp=stamp)
    return route, path_between(rows, trip.start_pose.pose, trip.goal_pose.pose, header)


def path_between(rows: FloatArray, start: Pose, goal: Pose, header: Header) -> DeparturePath:
    """Take poses (L, 3) for the path of a departure between two poses that were given.

    The path ends where the last row lies, with the goal's orientation: a goal that was blocked has
    been moved there.
    """
    x, y = rows[-1, :2].tolist()
    end = Pose(position=Point(x=x, y=y, z=goal.position.z), orientation=goal.orientation)
    return DeparturePath(header, frozen_array(rows, np.float64), start, end)


def _numbers(rows: FloatArray) -> FloatArray:
    """Positions and quaternions (L, 7) of poses (L, 3) in the plane, in a message's order."""
    numbers = np.zeros((len(rows), 7), dtype='<f8')
    numbers[:, :2] = rows[:, :2]
    half = (0.5 * rows[:, 2]).tolist()
    # Not numpy's: they may differ from those of the message in the last digit.
    numbers[:, 5], numbers[:, 6] = [*map(math.sin, half)], [*map(math.cos, half)]
    return numbers
