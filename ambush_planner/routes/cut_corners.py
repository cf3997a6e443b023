# SPDX-License-Identifier: Apache-2.0
"""Lines in the middle of corridors: drawn routes with their corners cut as far as is free.

A chord near a corner can be driven instead of the corner if every place within the reach R of the
chord is within R of the route's two edges there: then no ambush with this reach hits the chord and
not the route (docs/theory.md, Proposition 9.2). Held ground protects by where the convoy is, so a
corner is only cut if the edges around it are, as far as they count, either outside or inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..game.discs import HeldGround
from .corridors import Corridors

# Largest share of an edge that the cuts at its two ends may use together.
CUT = 0.9
# Cuts shorter than this share of an edge are left out, so that no segment is too short.
SHORT = 1e-3


@dataclass(frozen=True, eq=False)
class CutRoutes:
    """The lines of routes, concatenated [m].

    Line i has the ``points`` (K, 2) from ``bounds[i]`` to ``bounds[i + 1]`` (R + 1,). Segments
    (K - 1,) from each point to the next have a ``length``, a ``unit`` vector, and the ``widths``
    (K - 1, 2) of their left and right strips; not ``joined`` ones lead from a line to the next.
    ``room`` (K - 1, 2) is how much wider the strips are free of obstacles, and ``quarters`` (K, 2)
    are the radii of the left and right quarters at the points.
    """

    points: FloatArray
    joined: BoolArray
    unit: FloatArray
    length: FloatArray
    widths: FloatArray
    room: FloatArray
    quarters: FloatArray
    bounds: IndexArray


@dataclass(frozen=True, eq=False)
class _Corners:
    """The inner nodes (C,) of concatenated routes as corners.

    ``edge`` (C, 2) has the lengths of the edges before and after; ``inner`` and ``outer`` (C, 2)
    the free widths of their strips on the inner and on the outer side of the turn, the latter at
    most the tube; ``sine`` and ``cosine`` (C,) are those of half the turn.
    """

    nodes: FloatArray
    edge: FloatArray
    inner: FloatArray
    outer: FloatArray
    quarter: FloatArray
    sine: FloatArray
    cosine: FloatArray


def cut_routes(corridors: Corridors, routes: list[IndexArray]) -> CutRoutes:
    """The lines of the routes (K,)."""
    bounds = np.cumsum([0, *map(len, routes)])
    route = np.concatenate(routes)
    nodes = corridors.uv[route]
    joined = np.ones(len(route) - 1, dtype=bool)  # False from one route to the next
    joined[bounds[1:-1] - 1] = False
    links = np.zeros(len(joined), dtype=np.int64)
    links[joined] = corridors.links_along(route[:-1][joined], route[1:][joined])
    unit, length = _directions(nodes, joined)
    free = corridors.widths[links]
    widths = np.minimum(free, corridors.tube)
    quarters = np.zeros((len(route), 2))
    quarters[1:-1] = np.minimum(corridors.beyond[links[:-1], 1], corridors.beyond[links[1:], 0])
    whole = CutRoutes(nodes, joined, unit, length, widths, free - widths, quarters, bounds)
    if corridors.reach == 0.0:
        return whole
    left = cross(unit[:-1], unit[1:]) > 0.0
    half = 0.5 * np.hypot(*(unit[:-1] - unit[1:]).T)
    corners = _Corners(
        nodes[1:-1], np.stack((length[:-1], length[1:]), axis=1),
        _side(free, left), _side(widths, ~left),
        np.where(left, quarters[1:-1, 1], quarters[1:-1, 0]),
        half, np.sqrt(np.maximum(1.0 - half**2, 0.0)))
    cut = _cuts(corners, corridors.reach, corridors.held)
    cut[~(joined[:-1] & joined[1:])] = 0.0
    return _with_chords(whole, corners, _shared(cut, length), left, corridors.tube)


def _directions(points: FloatArray, joined: BoolArray) -> tuple[FloatArray, FloatArray]:
    step = np.where(joined[:, None], np.diff(points, axis=0), (1.0, 0.0))
    length = np.hypot(*step.T)
    return step / length[:, None], length


def _side(widths: FloatArray, left: BoolArray) -> FloatArray:
    """Widths (C, 2) of the strips before and after each corner, on the left or right of it."""
    pairs = np.stack((widths[:-1], widths[1:]), axis=1)
    return np.where(left[:, None], pairs[:, :, 0], pairs[:, :, 1])


def _cuts(corners: _Corners, reach: float, held: HeldGround) -> FloatArray:
    """How far from each corner (C,) a chord between its edges may begin and end [m]."""
    sine, cosine = corners.sine, corners.cosine
    depth = free_depth(corners.nodes, corners.edge.min(axis=1), sine, cosine, reach, held)
    with np.errstate(divide='ignore', invalid='ignore'):
        cut = np.minimum(depth / sine, 0.999 * corners.inner.min(axis=1) / (sine * cosine))
    cut[(sine < SHORT) | (cosine < SHORT)] = 0.0
    return cut


def free_depth(corners: FloatArray, short: FloatArray, sine: FloatArray, cosine: FloatArray,
               reach: float, held: HeldGround) -> FloatArray:
    """How far from corners (C, 2) a shorter line may pass without being hit more [m].

    Where an ambush hits a cut line but not the edges first is on the corner's axis: it must be
    within the reach of inner points of the edges, or, if the ``short`` one ends before, of its end.
    ``sine`` and ``cosine`` (C,) are those of half the turn.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        used = reach * sine / cosine
        deepest = np.where(
            short >= used, reach / cosine,
            short * sine + np.sqrt(np.maximum(reach**2 - (short * cosine)**2, 0.0)))
    depth = deepest - reach
    used = np.minimum(short, used)
    for centre, radius in zip(*held, strict=True):
        depth[np.abs(np.hypot(*(corners - centre).T) - radius) < used] = 0.0
    return depth


def _shared(cut: FloatArray, length: FloatArray) -> FloatArray:
    """Limit cuts (C,) to what the edges (C + 1,) have room for: half each, or what is left over."""
    padded_cut = padded(cut)
    before = np.maximum(0.5 * CUT * length, CUT * length - padded_cut[:-1])[:-1]
    after = np.maximum(0.5 * CUT * length, CUT * length - padded_cut[1:])[1:]
    cut = np.minimum(cut, np.minimum(before, after))
    return np.where(cut > SHORT * np.minimum(length[:-1], length[1:]), cut, 0.0)


def _with_chords(whole: CutRoutes, corners: _Corners, cut: FloatArray, left: BoolArray,
                 tube: float) -> CutRoutes:
    """Replace each corner with a cut (C,) over 0 by a chord."""
    depth = cut * corners.sine  # of the chord's middle
    inside = corners.inner.min(axis=1) / np.maximum(corners.cosine, SHORT) - depth
    outside = np.minimum(corners.outer.min(axis=1), depth + corners.quarter * corners.cosine)
    room = np.maximum(inside - tube, 0.0)
    inside, outside = np.clip((inside, outside), 0.0, tube)
    ends = np.minimum(np.minimum(corners.outer, outside[:, None]),
                      (cut / np.maximum(corners.sine, SHORT))[:, None])
    cut = padded(cut)
    count = np.where(cut > 0.0, 2, 1)
    last = np.cumsum(count) - 1
    first, chords = last - count + 1, np.flatnonzero(count == 2)
    points = np.empty((last[-1] + 1, 2))
    points[last], points[first] = whole.points, whole.points
    points[first[chords]] -= cut[chords, None] * whole.unit[chords - 1]
    points[last[chords]] += cut[chords, None] * whole.unit[chords]
    joined = np.ones(len(points) - 1, dtype=bool)
    widths, rooms = np.empty((2, len(points) - 1, 2))
    quarters = np.empty((len(points), 2))
    joined[last[:-1]], widths[last[:-1]], rooms[last[:-1]] = whole.joined, whole.widths, whole.room
    quarters[last] = whole.quarters
    at, left = chords - 1, left[chords - 1, None]
    widths[first[chords]] = np.where(left, np.stack((inside, outside), axis=1)[at],
                                     np.stack((outside, inside), axis=1)[at])
    rooms[first[chords]] = np.where(left == (True, False), room[at, None], 0.0)
    quarters[first[chords]] = ends[at, 0, None]  # the inner side has no quarter
    quarters[last[chords]] = ends[at, 1, None]
    unit, length = _directions(points, joined)
    return CutRoutes(points, joined, unit, length, widths, rooms, quarters,
                     np.append(first[whole.bounds[:-1]], len(points)))


def padded(values: FloatArray) -> FloatArray:
    """Append zeros for the first and last points to the values (K - 2, ...) of all others."""
    padded = np.zeros((len(values) + 2, *values.shape[1:]))
    padded[1:-1] = values
    return padded


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (C,) of plane vectors (C, 2)."""
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
