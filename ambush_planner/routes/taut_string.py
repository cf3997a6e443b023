# SPDX-License-Identifier: Apache-2.0
"""Shortest lines through the corridors of many routes at once.

A route's strips and quarters (``corridors``) overlap in a *portal* at each of its nodes: a segment
on the bisector of its two edges. Strips are convex, so straight lines from portal to portal stay in
them. The shortest such line, the taut string, is found by the funnel algorithm (Lee and Preparata
1984) in one pass.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from .corridors import Corridors

# Largest extent of portals along their edges [edge lengths]; below 0.5, neighbours never cross.
ALONG = 0.45


@dataclass(frozen=True, eq=False)
class Portals:
    """The portals at the ``nodes`` (K, 2) of routes, concatenated [m].

    ``leftward`` (K, 2) are unit vectors, ``left`` and ``right`` (K,) the extents to both sides, 0
    at the ends of a route, and ``length`` (K,) is that of the shorter edge. Route i has the portals
    from ``bounds[i]`` to ``bounds[i + 1]`` (R + 1,).
    """

    nodes: FloatArray
    leftward: FloatArray
    left: FloatArray
    right: FloatArray
    length: FloatArray
    bounds: IndexArray

    @property
    def width(self) -> FloatArray:
        """Distance between the two ends of each portal (K,) [m]."""
        return self.left + self.right

    def places(self, margin: FloatArray, side: float) -> FloatArray:
        """Points (K, 2) on the portals, ``margin`` from their left (1) or right (-1) ends."""
        aside = np.where(side > 0, self.left - margin, margin - self.right)
        return self.nodes + aside[:, None] * self.leftward


def portals_along(corridors: Corridors, routes: list[IndexArray]) -> Portals:
    """The portals at the nodes of routes (K,)."""
    bounds = np.cumsum([0, *map(len, routes)])
    route = np.concatenate(routes)
    nodes = corridors.uv[route]
    joined = np.ones(len(route) - 1, dtype=bool)  # False from one route to the next
    joined[bounds[1:-1] - 1] = False
    links = np.zeros(len(joined), dtype=np.int64)
    links[joined] = corridors.links_along(route[:-1][joined], route[1:][joined])
    step = np.where(joined[:, None], np.diff(nodes, axis=0), (1.0, 0.0))
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    halves = unit[:-1] + unit[1:]
    size = np.hypot(*halves.T)
    # Components of the portal's direction across and along the edges.
    off = np.maximum(size / 2, 1e-9)
    along = np.sqrt(np.maximum(1.0 - off**2, 0.0))
    leftward = np.stack((-halves[:, 1], halves[:, 0]), axis=1) / np.maximum(size, 1e-9)[:, None]
    limit = ALONG * np.minimum(length[:-1], length[1:]) / np.maximum(along, 1e-9)
    before, after = links[:-1], links[1:]
    inner, outer = [], []
    for side, width in enumerate(corridors.widths.T):
        inner.append(np.minimum(np.minimum(width[before], width[after]) / off, limit))
        quarter = np.minimum(corridors.beyond[before, 1, side], corridors.beyond[after, 0, side])
        # A line from a portal's outer end to the next portal must enter the strip where it meets
        # the quarter.
        steep = np.maximum(width[before] / length[:-1], width[after] / length[1:]) / (1.0 - ALONG)
        outer.append(quarter / np.maximum(off + along * steep, 1.0))
    turn = cross(unit[:-1], unit[1:])
    within = joined[:-1] & joined[1:]
    usable = within & (size > 1e-6)
    return Portals(nodes, padded(leftward * within[:, None]),
                   padded(np.where(turn >= 0, inner[0], outer[0]) * usable),
                   padded(np.where(turn <= 0, inner[1], outer[1]) * usable),
                   padded(np.minimum(length[:-1], length[1:])), bounds)


def taut_strings(portals: Portals, margin: FloatArray,
                 routes: Iterable[int]) -> list[list[tuple[int, int]]]:
    """Corners of the shortest line of each of ``routes``, ``margin`` (K,) [m] inside the portals.

    A corner is (portal, side): side 1 is the left end, -1 the right end, 0 an end of the route.
    """
    left, right = (portals.places(margin, side) for side in (1, -1))
    first = np.where(_left_first(left, right), 1, -1)
    side = np.stack((first, -first), axis=1)
    xy = np.where(side[:, :, None] > 0, left[:, None], right[:, None])
    steps = list(zip(side.ravel().tolist(), *xy.reshape(-1, 2).T.tolist(), strict=True))
    bounds = portals.bounds.tolist()
    return [_taut_string(steps, *bounds[each : each + 2]) for each in routes]


def _taut_string(steps: list[tuple[int, float, float]], first: int,
                 end: int) -> list[tuple[int, int]]:
    """Corners of the line through the portals from ``first`` to before ``end``.

    ``steps`` are (side, x, y) of the ends of all portals, in the order in which they are advanced.
    """
    corners, k = [(first, 0)], 2 * first + 2
    _, ax, ay = steps[2 * first]  # the apex of the funnel
    # Tips of the funnel relative to the apex and their steps, indexed by side 1 and -1.
    tip = [(0.0, 0.0, k - 2)] * 3
    while k < 2 * end:
        side, x, y = steps[k]
        x, y = x - ax, y - ay
        sx, sy, _ = tip[side]
        # A side advances if the next end narrows the funnel.
        if side * (sx * y - sy * x) <= 0.0:
            ox, oy, other = tip[-side]
            if side * (ox * y - oy * x) > 0.0 or sx == sy == 0.0:
                tip[side] = x, y, k
            else:  # it crosses the other side, whose tip becomes a corner and the new apex
                corners.append((other // 2, -side))
                _, ax, ay = steps[other]
                tip = [(0.0, 0.0, other)] * 3
                k = other // 2 * 2 + 1
        k += 1
    return [*(corner for corner in corners if corner[0] != end - 1), (end - 1, 0)]


def _left_first(left: FloatArray, right: FloatArray) -> BoolArray:
    """Whether the left end may advance to the next portal before the right end does.

    It may if the diagonal from the old right to the new left end lies between the portals.
    """
    old, new = right[:-1], left[1:]
    before = cross(old - left[:-1], new - left[:-1]) >= 0.0
    after = cross(right[1:] - old, new - old) >= 0.0
    return np.append(True, before & after)


def padded(values: FloatArray) -> FloatArray:
    """Append zeros for the first and last portals to the values (K - 2, ...) of all others."""
    padded = np.zeros((len(values) + 2, *values.shape[1:]))
    padded[1:-1] = values
    return padded


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (C,) of plane vectors (C, 2)."""
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
