"""The route and the path of a departure: drawn, then serialised or turned into a message."""

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
    """A path of poses ``rows`` (L, 3) = (x, y, yaw) [m, m, rad].

    The messages have exactly ``start`` and ``goal`` as first and last pose.
    """

    header: Header
    rows: FloatArray
    start: Pose
    goal: Pose

    def to_message(self) -> PathMessage:
        """Return the path as a message."""
        return path_to_ros(self.rows, self.start, self.goal, self.header)

    def to_bytes(self) -> bytes:
        """Return the same message serialised."""
        ends = path_to_ros(self.rows[[0, -1]], self.start, self.goal, self.header)
        inner = self.rows[1:-1]
        numbers = np.zeros((len(inner), 7), dtype='<f8')
        numbers[:, :2] = inner[:, :2]
        # The math module's sine, as in the message: numpy's may differ in the last digit.
        half = (0.5 * inner[:, 2]).tolist()
        numbers[:, 5], numbers[:, 6] = [*map(math.sin, half)], [*map(math.cos, half)]
        return path_bytes(ends, numbers)


def route_entropy_source(seed: int, departure: int) -> list[int]:
    """Return the seed of one departure's random generator.

    With seed -1 this is 256 bits from the operating system. With a fixed seed it follows from the
    number of the departure, so that each route can be reproduced on its own. Nothing else goes in:
    no time, no input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, departure]


def draw_path(
    cached: CachedPlan, trip: Trip, source: list[int], spacing: float, stamp: Time
) -> tuple[Route, DeparturePath] | None:
    """Draw a route that is clear on the trip's map, with its path; None if hardly any is clear.

    ``source`` seeds the random generator. Poses are at most ``spacing`` [m] apart; 0: as far as the
    plan says.
    """
    route = cached.ground.draw(np.random.default_rng(source), trip.map)
    if route is None:
        return None
    ends = cached.ends(trip)
    plan = cached.ground.fitted(trip.map, ends)
    rows = departure_path(plan, route, spacing or plan.spacing, ends)
    header = Header(frame_id=trip.map.frame, stamp=stamp)
    return route, path_between(rows, trip.start_pose.pose, trip.goal_pose.pose, header)


def path_between(rows: FloatArray, start: Pose, goal: Pose, header: Header) -> DeparturePath:
    """Return the path along poses (L, 3) from ``start`` to ``goal``.

    It ends at the position of the last row with the goal's height and orientation: a blocked goal
    has been moved there.
    """
    x, y = rows[-1, :2].tolist()
    end = Pose(position=Point(x=x, y=y, z=goal.position.z), orientation=goal.orientation)
    return DeparturePath(header, frozen_array(rows, np.float64), start, end)
