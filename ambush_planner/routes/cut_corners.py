# SPDX-License-Identifier: Apache-2.0
"""Centre lines of corridors: drawn routes with their corners cut as far as no ambush gains by it.

A chord between the two edges at a corner can replace the corner if every place within the reach R
of the chord is also within R of the edges: then no ambush with this reach hits the chord but not
the route (docs/theory.md, Proposition 9.2). The secured area protects by the convoy's place, so a
corner is only cut if the relevant parts of its edges are all inside or all outside.

First, nodes that are close to each other are skipped by straight lines over open ground: an ambush
that hits such a line with a slightly smaller reach hits an end of it (Proposition 9.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..game.discs import SecuredArea
from .corridors import Corridors

# Maximum length of lines that skip nodes, as a share of the reach without the tube.
SKIP = 0.4
# Least share of an edge between its two cuts, if these do not meet.
CHORD_GAP = 0.25
# Smallest cut [edges]: shorter chords would leave no room for round turns at their ends.
SHORT = 0.1
# Smallest sine and cosine of half a turn at a corner that is cut.
TINY = 1e-3


@dataclass(frozen=True, eq=False)
class CutRoutes:
    """Lines of routes, concatenated [m].

    Line i has the ``points`` (K, 2) from ``bounds[i]`` to ``bounds[i + 1]`` (R + 1,). Segments
    (K - 1,) lead from each point to the next; ``joined`` is false from one line to the next.
    Segments have a ``length``, a ``unit`` vector, and the ``widths`` (K - 1, 2) of their left and
    right strips; ``room`` (K - 1, 2) is the space beyond these that is free of obstacles.
    ``quarters`` (K, 2) are the radii of the left and right quarters at the points.
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
    """Corners at the inner nodes (C, 2) of concatenated routes.

    ``unit`` (C, 2, 2) are the directions of the edges before and after the corner, ``edge`` (C, 2)
    their lengths, ``inner`` and ``outer`` (C, 2) the free widths of their strips on the inner and
    outer side of the turn, the latter at most the tube. ``left`` (C,) marks turns to the left;
    ``quarter`` (C,) is the radius on the outer side; ``sine`` and ``cosine`` (C,) are those of half
    the turn.
    """

    nodes: FloatArray
    unit: FloatArray
    edge: FloatArray
    left: BoolArray
    inner: FloatArray
    outer: FloatArray
    quarter: FloatArray
    sine: FloatArray
    cosine: FloatArray


def cut_routes(corridors: Corridors, routes: list[IndexArray]) -> CutRoutes:
    """Cut the corners of routes (K,)."""
    if corridors.reach > 0.0:
        routes = [_skip_nodes(corridors, route) for route in routes]
    bounds = np.cumsum([0, *map(len, routes)])
    route = np.concatenate(routes)
    nodes = corridors.uv[route]
    joined = np.ones(len(route) - 1, dtype=bool)  # False from one route to the next
    joined[bounds[1:-1] - 1] = False
    unit, length = _directions(nodes, joined)
    links = corridors.links_along(route[:-1], route[1:])
    known = links >= 0  # others skip nodes, or lead from a line to the next
    tubes = np.where(known, corridors.tube, skipping_tube(corridors, length))
    free = corridors.widths[links]
    radii = corridors.radii[links].copy()
    clear = np.maximum(corridors.open_ground[route[:-1]], corridors.open_ground[route[1:]]) - length
    free[~known] = np.minimum(clear, 2.0 * corridors.tube)[~known, None]
    radii[~known] = tubes[~known, None, None]
    widths = np.minimum(free, tubes[:, None])
    quarters = np.zeros((len(route), 2))
    quarters[1:-1] = np.minimum(radii[:-1, 1], radii[1:, 0])
    whole = CutRoutes(nodes, joined, unit, length, widths, free - widths, quarters, bounds)
    if corridors.reach == 0.0:
        return whole
    left = cross(unit[:-1], unit[1:]) > 0.0
    half = 0.5 * np.hypot(*(unit[:-1] - unit[1:]).T)
    corners = _Corners(
        nodes[1:-1], np.stack((unit[:-1], unit[1:]), axis=1),
        np.stack((length[:-1], length[1:]), axis=1), left,
        _side(free, left), _side(widths, ~left),
        np.where(left, quarters[1:-1, 1], quarters[1:-1, 0]),
        half, np.sqrt(np.maximum(1.0 - half**2, 0.0)))
    tube = np.minimum(tubes[:-1], tubes[1:])
    max_cut = _max_cuts(corners, corridors.reach - corridors.tube + tube, corridors.secured)
    max_cut[~(joined[:-1] & joined[1:])] = 0.0
    return _with_chords(whole, corners, *_divide_edges(max_cut, length), tube)


def _skip_nodes(corridors: Corridors, route: IndexArray) -> IndexArray:
    """Drop the nodes of a route that straight lines can skip."""
    max_length = SKIP * (corridors.reach - corridors.tube)
    uv, open_ground = corridors.uv[route], corridors.open_ground[route]
    inside = [np.hypot(*(uv - centre).T) < radius
              for centre, radius in zip(*corridors.secured, strict=True)]
    side = np.array(inside).T.tolist() if inside else [[]] * len(route)
    points, room = uv.tolist(), (open_ground - corridors.tube).tolist()
    nodes, last = [0], len(route) - 1
    while nodes[-1] < last:
        k = nodes[-1]
        next_node = k + 1
        while next_node < last and side[next_node + 1] == side[k]:
            distance = math.dist(points[k], points[next_node + 1])
            if distance > max_length or distance > max(room[k], room[next_node + 1]):
                break
            next_node += 1
        nodes.append(next_node)
    return route[nodes]


def skipping_tube(corridors: Corridors, length: FloatArray) -> FloatArray:
    """Return the largest distance of paths from lines of a length (K,) that skip nodes [m]."""
    ambush_radius = corridors.reach - corridors.tube
    half = np.minimum(length / 2, corridors.reach)
    tubes: FloatArray = np.maximum(np.sqrt(corridors.reach**2 - half**2) - ambush_radius, 0.0)
    return tubes


def _directions(points: FloatArray, joined: BoolArray) -> tuple[FloatArray, FloatArray]:
    step = np.where(joined[:, None], np.diff(points, axis=0), (1.0, 0.0))
    length = np.hypot(*step.T)
    return step / length[:, None], length


def _side(widths: FloatArray, left: BoolArray) -> FloatArray:
    """Widths (C, 2) of the strips before and after each corner, on the left or right of it."""
    pairs = np.stack((widths[:-1], widths[1:]), axis=1)
    return np.where(left[:, None], pairs[:, :, 0], pairs[:, :, 1])


def _max_cuts(corners: _Corners, reach: FloatArray, secured: SecuredArea) -> FloatArray:
    """Largest distance of chords from each corner (C,), along its edges [m]."""
    sine, cosine = corners.sine, corners.cosine
    depth = free_depth(corners.nodes, corners.edge.min(axis=1), sine, cosine, reach, secured)
    with np.errstate(divide='ignore', invalid='ignore'):
        cut = np.minimum(depth / sine, 0.999 * corners.inner.min(axis=1) / (sine * cosine))
    cut[(sine < TINY) | (cosine < TINY)] = 0.0
    return cut


def free_depth(corners: FloatArray, short: FloatArray, sine: FloatArray, cosine: FloatArray,
               reach: FloatArray | float, secured: SecuredArea) -> FloatArray:
    """Return the largest depth (C,) to which lines may cut ``corners`` (C, 2) at no risk [m].

    A line that is cut too deep is first hit from the corner's axis, at a place that reaches no
    inner point of the edges, nor the end of the ``short`` edge (C,) if that ends before. ``sine``
    and ``cosine`` (C,) are those of half the turn.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        used = reach * sine / cosine
        deepest = np.where(
            short >= used, reach / cosine,
            short * sine + np.sqrt(np.maximum(reach**2 - (short * cosine)**2, 0.0)))
    depth = deepest - reach
    used = np.minimum(short, used)
    for centre, radius in zip(*secured, strict=True):
        depth[np.abs(np.hypot(*(corners - centre).T) - radius) < used] = 0.0
    return depth


def _divide_edges(max_cut: FloatArray, length: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Divide edges (C + 1,) between the cuts at their ends, at most ``max_cut`` (C,) each.

    Returns the cuts (C, 2) before and after each corner, and whether they meet on edges (C + 1,).
    """
    max_cut = pad(max_cut)
    tail, head = max_cut[:-1], max_cut[1:]
    together = tail + head
    meet = together >= length
    tail_meeting = np.clip(0.5 * length, length - head, tail)
    shrink = np.minimum(1.0, (1.0 - CHORD_GAP) * length / np.maximum(together, TINY * length))
    tail, head = (np.where(meet, tail_meeting, shrink * tail),
                  np.where(meet, length - tail_meeting, shrink * head))
    cuts = np.stack((head[:-1], tail[1:]), axis=1)
    cuts[(cuts < SHORT * np.stack((length[:-1], length[1:]), axis=1)).any(axis=1)] = 0.0
    cut = pad(cuts[:, 0]) > 0.0
    return cuts, np.asarray(meet & cut[:-1] & cut[1:])


def _with_chords(whole: CutRoutes, corners: _Corners, cuts: FloatArray, meet: BoolArray,
                 tube: FloatArray) -> CutRoutes:
    """Replace each corner with cuts (C, 2) > 0 by a chord; on some edges, chords ``meet``."""
    at = np.flatnonzero(cuts[:, 0] > 0.0)
    inside, outside, room, ends = _chord_widths(corners, cuts, at, tube[at])
    chords, count = at + 1, np.ones(len(whole.points), dtype=np.int64)
    count[chords] = 2
    last = np.cumsum(count) - 1
    first = last - count + 1
    points = np.empty((last[-1] + 1, 2))
    points[last], points[first] = whole.points, whole.points
    points[first[chords]] -= cuts[at, :1] * corners.unit[at, 0]
    points[last[chords]] += cuts[at, 1:] * corners.unit[at, 1]
    joined = np.ones(len(points) - 1, dtype=bool)
    widths, rooms = np.zeros((2, len(points) - 1, 2))
    quarters = np.empty((len(points), 2))
    joined[last[:-1]], widths[last[:-1]], rooms[last[:-1]] = whole.joined, whole.widths, whole.room
    quarters[last] = whole.quarters
    inner = np.where(corners.left[at], 0, 1)
    widths[first[chords], inner], widths[first[chords], 1 - inner] = inside, outside
    rooms[first[chords], inner] = room
    quarters[first[chords]] = quarters[last[chords]] = np.inf  # on the inner side, no limit
    quarters[first[chords], 1 - inner], quarters[last[chords], 1 - inner] = ends.T
    # Nothing is left of an edge on which chords meet.
    dropped = last[:-1][meet]
    quarters[dropped + 1] = np.minimum(quarters[dropped], quarters[dropped + 1])
    used = np.ones(len(points), dtype=bool)
    used[dropped] = False
    points, quarters = points[used], quarters[used]
    unit, length = _directions(points, joined[used[:-1]])
    begins = np.cumsum(used)[first[whole.bounds[:-1]]] - 1
    return CutRoutes(points, joined[used[:-1]], unit, length, widths[used[:-1]], rooms[used[:-1]],
                     quarters, np.append(begins, len(points)))


def _chord_widths(corners: _Corners, cuts: FloatArray, at: IndexArray,
                  tube: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sizes of the strips and quarters along chords at the corners ``at`` (K,).

    Returns the widths (K,) on the inner and on the outer side, the free space (K,) beyond the inner
    strips, and the radii (K, 2) of the quarters on the outer side.
    """
    cuts, sine, cosine = cuts[at], corners.sine[at], corners.cosine[at]
    before, after = cuts.T
    size = np.hypot(*(cuts[:, :1] * corners.unit[at, 0] + cuts[:, 1:] * corners.unit[at, 1]).T)
    # Sines and cosines of the turns at both ends, and the cosine of the chord's slant.
    sines = 2.0 * sine[:, None] * cosine[:, None] * cuts[:, ::-1] / size[:, None]
    cosines = np.sqrt(np.maximum(1.0 - sines**2, 0.0))
    slant = np.minimum((before + after) * cosine / size, 1.0)
    # Farthest from both edges is where the corner's axis meets the chord.
    depth = 2.0 * before * after * sine / (before + after)
    inside = np.maximum((corners.inner[at].min(axis=1) / cosine - depth) * slant, 0.0)
    depth = before * sines[:, 0] + corners.quarter[at] * cosines.min(axis=1)
    outside = np.clip(np.minimum(corners.outer[at].min(axis=1), depth), 0.0, tube)
    ends = np.minimum(np.minimum(corners.outer[at], outside[:, None]), cuts / sines)
    return np.minimum(inside, tube), outside, np.maximum(inside - tube, 0.0), ends


def pad(values: FloatArray) -> FloatArray:
    """Add zeros for the first and last points to the values (K - 2, ...) of all others."""
    padded = np.zeros((len(values) + 2, *values.shape[1:]))
    padded[1:-1] = values
    return padded


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (C,) of plane vectors (C, 2)."""
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
