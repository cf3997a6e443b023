"""The shortest line through a route's corridors.

A route's strips and quarters (``corridors``) overlap in a *portal* at each of its nodes: a piece of
the line that halves the angle between its two edges. Strips are convex, so what leads from portal
to portal in straight lines stays in them, and the shortest such line, the taut string, is found by
the funnel algorithm (Lee and Preparata 1984) in one pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IndexArray
from .corridors import Corridors

# Portals reach at most so far along their edges [lengths], so that those next to each other never
# cross.
ALONG = 0.45


@dataclass(frozen=True, eq=False)
class Portals:
    """The portals at the ``nodes`` (K, 2) of a route [m]; of no width at its ends.

    ``leftward`` (K, 2) are unit vectors, ``left`` and ``right`` (K,) the room to both sides, and
    ``length`` (K,) is that of the shorter edge there.
    """

    nodes: FloatArray
    leftward: FloatArray
    left: FloatArray
    right: FloatArray
    length: FloatArray

    @property
    def width(self) -> FloatArray:
        """From end to end (K,) [m]."""
        return self.left + self.right

    def places(self, margin: FloatArray, side: float) -> FloatArray:
        """Points (K, 2) of the portals, by ``margin`` from their left (1) or right ends (-1)."""
        aside = np.where(side > 0, self.left - margin, margin - self.right)
        return self.nodes + aside[:, None] * self.leftward


def portals_along(corridors: Corridors, route: IndexArray) -> Portals:
    """The portals at the nodes of a route (K,)."""
    nodes = corridors.uv[route]
    links = corridors.links_along(route)
    step = np.diff(nodes, axis=0)
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    halves = unit[:-1] + unit[1:]
    size = np.hypot(*halves.T)
    # Half the turn: how much of a portal leads along the edges, and how much off them.
    off = np.maximum(size / 2, 1e-9)
    along = np.sqrt(np.maximum(1.0 - off**2, 0.0))
    leftward = np.stack((-halves[:, 1], halves[:, 0]), axis=1) / np.maximum(size, 1e-9)[:, None]
    limit = ALONG * np.minimum(length[:-1], length[1:]) / np.maximum(along, 1e-9)
    before, after = links[:-1], links[1:]
    inner, outer = [], []
    for side, width in enumerate((corridors.left, corridors.right)):
        inner.append(np.minimum(np.minimum(width[before], width[after]) / off, limit))
        quarter = np.minimum(corridors.beyond[before, 1, side], corridors.beyond[after, 0, side])
        # What leads from a portal's outer end to the next portal must enter the strip on its way
        # where strip and quarter meet.
        steep = np.maximum(width[before] / length[:-1], width[after] / length[1:]) / (1.0 - ALONG)
        outer.append(quarter / np.maximum(off + along * steep, 1.0))
    turn = unit[:-1, 0] * unit[1:, 1] - unit[:-1, 1] * unit[1:, 0]
    usable = size > 1e-6
    zero = np.zeros(1)
    return Portals(
        nodes,
        np.concatenate((np.zeros((1, 2)), leftward, np.zeros((1, 2)))),
        np.concatenate((zero, np.where(turn >= 0, inner[0], outer[0]) * usable, zero)),
        np.concatenate((zero, np.where(turn <= 0, inner[1], outer[1]) * usable, zero)),
        np.concatenate((zero, np.minimum(length[:-1], length[1:]), zero)),
    )


def taut_string(portals: Portals, margin: FloatArray) -> list[tuple[int, int]]:
    """The corners of the shortest line through all portals, ``margin`` (K,) [m] from their ends.

    A corner is (portal, side): side 1 is the left end, -1 the right one, 0 an end of the route.
    """
    left, right = (portals.places(margin, side) for side in (1, -1))
    ends = {1: left.tolist(), -1: right.tolist()}
    last = len(left) - 1
    first_side = np.where(_left_first(left, right), 1, -1).tolist()
    corners, apex, k, half = [(0, 0)], ends[1][0], 1, 0
    tip = {1: apex, -1: apex}
    at = {1: 0, -1: 0}
    while k <= last:
        side = first_side[k] if half == 0 else -first_side[k]
        (ax, ay), (x, y), (sx, sy), (ox, oy) = apex, ends[side][k], tip[side], tip[-side]
        # The funnel is as wide as its tips say; a side moves in where the next end is within.
        if side * ((sx - ax) * (y - ay) - (sy - ay) * (x - ax)) <= 0.0:
            if tip[side] == apex or side * ((ox - ax) * (y - ay) - (oy - ay) * (x - ax)) > 0.0:
                tip[side], at[side] = ends[side][k], k
            else:  # beyond the other side: a corner there, from which it goes on
                corners.append((at[-side], -side))
                apex, k, half = tip[-side], at[-side] + 1, 0
                tip = {1: apex, -1: apex}
                at = {1: at[-side], -1: at[-side]}
                continue
        k, half = (k, 1) if half == 0 else (k + 1, 0)
    return [*(corner for corner in corners if corner[0] != last), (last, 0)]


def _left_first(left: FloatArray, right: FloatArray) -> list[bool]:
    """Whether, from one portal to the next, the left end may move before the right one does.

    It may if the diagonal from the old right to the new left end lies between the portals.
    """
    old, new = right[:-1], left[1:]
    before = cross(old - left[:-1], new - left[:-1]) >= 0.0
    after = cross(right[1:] - old, new - old) >= 0.0
    return [True, *(before & after).tolist()]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (C,) of plane vectors (C, 2)."""
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
