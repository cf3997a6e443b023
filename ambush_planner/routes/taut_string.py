# SPDX-License-Identifier: Apache-2.0
"""Shortest lines through the corridors of many routes at once.

At each point of a route with cut corners (``cut_corners``), the strips and quarters of its two
segments overlap in a *portal*: a piece of the bisector. Strips are convex, so straight lines from
portal to portal stay in them. The funnel algorithm (Lee and Preparata 1984) finds the shortest such
line, the taut string, in one pass.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.discs import SecuredArea
from .corridors import Corridors
from .cut_corners import cross, cut_routes, pad

# Largest extent of portals along their edges [edge lengths]; below 0.5, neighbours never cross.
EDGE_SHARE = 0.45


@dataclass(frozen=True, eq=False)
class Portals:
    """Portals at the ``nodes`` (K, 2) of lines, concatenated [m].

    Line i has the portals from ``bounds[i]`` to ``bounds[i + 1]`` (R + 1,). ``leftward`` (K, 2) are
    unit vectors, ``left`` and ``right`` (K,) the extents to both sides, 0 at the ends of a line;
    ``length`` (K,) is that of the shorter segment. ``room`` (K, 2) is the free space beyond the
    left and right ends on the inner side of a turn: lines may use it if no ambush with the
    ``reach`` [m] gains by it. In the ``secured`` discs no ambush hits.
    """

    nodes: FloatArray
    leftward: FloatArray
    left: FloatArray
    right: FloatArray
    length: FloatArray
    bounds: IndexArray
    room: FloatArray
    reach: float
    secured: SecuredArea

    @property
    def width(self) -> FloatArray:
        """Distance between the two ends of each portal (K,) [m]."""
        return self.left + self.right

    def places(self, margin: FloatArray, side: float) -> FloatArray:
        """Points (K, 2) on the portals, ``margin`` (K,) inside the left (1) or right (-1) end."""
        lateral = np.where(side > 0, self.left - margin, margin - self.right)
        return self.nodes + lateral[:, None] * self.leftward


def portals_along(corridors: Corridors, routes: list[IndexArray]) -> Portals:
    """Find the portals along routes (K,) with their corners cut."""
    lines = cut_routes(corridors, routes)
    unit, length, widths, quarters = lines.unit, lines.length, lines.widths, lines.quarters[1:-1]
    halves = unit[:-1] + unit[1:]
    size = np.hypot(*halves.T)
    # Components of the portal's direction across and along the segments.
    sine = np.maximum(size / 2, 1e-9)
    cosine = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    leftward = np.stack((-halves[:, 1], halves[:, 0]), axis=1) / np.maximum(size, 1e-9)[:, None]
    limit = EDGE_SHARE * np.minimum(length[:-1], length[1:]) / np.maximum(cosine, 1e-9)
    inner, outer, room = [], [], []
    for side, (width, more) in enumerate(zip(widths.T, lines.room.T, strict=True)):
        inner.append(np.minimum(np.minimum(width[:-1], width[1:]) / sine, limit))
        wide = width + more
        room.append(np.minimum(np.minimum(wide[:-1], wide[1:]) / sine, limit) - inner[-1])
        # A line from a portal's outer end to the next portal must enter the strip where it meets
        # the quarter.
        steep = np.maximum(width[:-1] / length[:-1], width[1:] / length[1:]) / (1.0 - EDGE_SHARE)
        outer.append(quarters[:, side] / np.maximum(sine + cosine * steep, 1.0))
    turn = cross(unit[:-1], unit[1:])
    inner_corner = lines.joined[:-1] & lines.joined[1:]
    usable = inner_corner & (size > 1e-6)
    secured = corridors.secured._replace(radii=corridors.secured.radii + corridors.tube)
    return Portals(lines.points, pad(leftward * inner_corner[:, None]),
                   pad(np.where(turn >= 0, inner[0], outer[0]) * usable),
                   pad(np.where(turn <= 0, inner[1], outer[1]) * usable),
                   pad(np.minimum(length[:-1], length[1:])), lines.bounds,
                   pad(np.stack((room[0] * (turn >= 0), room[1] * (turn <= 0)), axis=1)
                          * usable[:, None]),
                   max(corridors.reach - corridors.tube, 0.0), secured)


def taut_strings(portals: Portals, margin: FloatArray,
                 routes: Iterable[int]) -> list[list[tuple[int, int]]]:
    """Corners of the shortest line of each of ``routes``, ``margin`` (K,) [m] inside the portals.

    A corner is (portal, side): side 1 is the left end, -1 the right end, 0 an end of the route.
    """
    left, right = (portals.places(margin, side) for side in (1, -1))
    # The left end may advance to the next portal before the right end does if the diagonal from
    # the old right end to the new left end lies between the portals.
    old, new = right[:-1], left[1:]
    diagonal = (cross(old - left[:-1], new - left[:-1]) >= 0.0) & (
        cross(right[1:] - old, new - old) >= 0.0)
    first = np.where(np.append(True, diagonal), 1, -1)
    side = np.stack((first, -first), axis=1)
    xy = np.where(side[:, :, None] > 0, left[:, None], right[:, None])
    steps = list(zip(side.ravel().tolist(), *xy.reshape(-1, 2).T.tolist(), strict=True))
    bounds = portals.bounds.tolist()
    return [_taut_string(steps, *bounds[each : each + 2]) for each in routes]


def _taut_string(steps: list[tuple[int, float, float]], first: int,
                 end: int) -> list[tuple[int, int]]:
    """Corners of the shortest line through the portals from ``first`` up to ``end``, exclusive.

    ``steps`` are (side, x, y) of the ends of all portals, in the order in which they advance.
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
