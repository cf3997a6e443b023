# SPDX-License-Identifier: Apache-2.0
"""Pairs (K, 2) of neighbouring nodes: 8-connected lattice or Delaunay triangulation."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from .node_sampling import PERIOD, shifts

# Cocircular points have several Delaunay triangulations. Ties are broken by shifting odd lattice
# rows by 1e-5 spacings, which alternates the diagonals from row to row, and by stretching and
# shearing the plane by about 1e-6. Straight lines stay straight, so no slivers appear at a border.
ROW_SHIFT = -1.0e-5
TIE_BREAK = np.array([[1.0, 1.0e-6], [0.0, 1.0 + 0.7e-6]])
# Height of a triangle, as a share of its longest side, below which it is flat.
FLAT = 0.25
# Rows and columns of lattice nodes added beyond the border; triangles of inner nodes stay within.
FRAME = 3


def grid8_pairs(node_of: IndexArray) -> IndexArray:
    """Join each node to its eight neighbours; ``node_of`` (rows, columns) is -1 without a node."""
    pairs = [
        _stack(node_of[:, :-1], node_of[:, 1:]),
        _stack(node_of[:-1, :], node_of[1:, :]),
        _stack(node_of[:-1, :-1], node_of[1:, 1:]),
        _stack(node_of[:-1, 1:], node_of[1:, :-1]),
    ]
    joined = np.concatenate(pairs)
    return joined[(joined >= 0).all(axis=1)]


def delaunay_pairs(points: FloatArray, mirrored: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Edges (E, 2) and triangles (T, 3) of the Delaunay triangulation of points (K, 2) on a map.

    Their mirror images (F, 2) beyond the map's edge prevent long edges between nodes along it: two
    nodes are joined only if their Voronoi cells meet on the map.
    """
    triangles = _triangles(np.concatenate((points, mirrored)))
    pairs = _triangle_edges(triangles)
    pairs = _unique_pairs(pairs[(pairs < len(points)).all(axis=1)])
    return pairs, triangles[(triangles < len(points)).all(axis=1)]


def lattice_delaunay_pairs(free: BoolArray, others: FloatArray,
                           method: str) -> tuple[IndexArray, IndexArray]:
    """Delaunay triangulation of a lattice with holes and a few additional nodes.

    ``free`` (rows, columns) marks the existing lattice nodes, numbered row by row; the ``others``
    (K, 2), in spacings from the map's corner, are numbered last. The lattice is continued beyond
    its border to prevent long edges along it.

    A lattice is periodic, so its triangulation is computed once for a tile (Qhull) and repeated
    over the map. Its triangles are kept if all their corners exist and their circumcircles contain
    none of the others. The holes between them are triangulated separately, from the nodes on their
    rims: a triangle there can have no other corners.

    Returns the edges (E, 2) and the triangles (G, 3) in the holes.
    """
    exists = np.pad(free, FRAME, constant_values=True)
    number = np.full(exists.shape, -1, dtype=np.int64)
    number[FRAME:-FRAME, FRAME:-FRAME][free] = np.arange(int(free.sum()))
    number = np.concatenate((number.ravel(), int(free.sum()) + np.arange(len(others))))
    # Ties are broken as for lattice nodes: one that replaces a lattice node gets the same edges.
    moved = ROW_SHIFT * (np.floor(others[:, 1]) % 2)
    others = (others + FRAME + np.stack((moved, np.zeros_like(moved)), axis=1)) @ TIE_BREAK
    places = np.concatenate((_lattice_places(exists.shape, method), others))
    triangles = _lattice_triangles(exists.shape, method)
    kept = np.asarray(exists.ravel()[triangles].all(axis=1))
    kept[kept] = ~_circle_contains(places, triangles[kept], others, exists.shape)
    present = np.concatenate((exists.ravel(), np.ones(len(others), dtype=bool)))
    rim = np.zeros(len(places), dtype=bool)
    rim[triangles[~kept]] = True
    rim[-len(others):] = True
    holes = _hole_triangles(places, present, rim)
    joined = number[_triangle_edges(np.concatenate((triangles[kept], holes)))]
    pairs = _unique_pairs(joined[(joined >= 0).all(axis=1)])
    holes = number[holes]
    return pairs, holes[(holes >= 0).all(axis=1)]


def without_slivers(points: FloatArray, pairs: IndexArray, triangles: IndexArray) -> IndexArray:
    """Drop the longest sides of flat triangles (T, 3) whose two other sides are among the pairs.

    Otherwise nodes along an obstacle would be joined past those between them that lie only slightly
    further off. The pairs must be sorted, as the functions above return them.
    """
    size = len(points)
    corners = points[triangles]
    sides = np.stack(
        [np.hypot(*(corners[:, (k + 1) % 3] - corners[:, (k + 2) % 3]).T) for k in range(3)], axis=1
    )
    (bx, by), (cx, cy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    flat = np.abs(bx * cy - by * cx) < FLAT * sides.max(axis=1) ** 2
    triangles, longest = triangles[flat], sides[flat].argmax(axis=1)
    row = np.arange(len(triangles))
    apex, a, b = (triangles[row, (longest + k) % 3] for k in range(3))
    known = pairs[:, 0] * size + pairs[:, 1]

    def find(i: IndexArray, j: IndexArray) -> tuple[IndexArray, BoolArray]:
        keys = np.minimum(i, j) * size + np.maximum(i, j)
        index = np.minimum(np.searchsorted(known, keys), len(known) - 1)
        return index, known[index] == keys

    if len(known) == 0:
        return pairs
    side, found = find(a, b)
    found &= find(apex, a)[1] & find(apex, b)[1]
    return np.delete(pairs, side[found], axis=0)


def _lattice_places(shape: tuple[int, ...], method: str) -> FloatArray:
    """Positions [spacings] of all nodes of a framed lattice, row by row, with ties broken."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    moved = shifts(method)[(row - FRAME) % PERIOD, (column - FRAME) % PERIOD]
    places = np.stack((column + ROW_SHIFT * ((row - FRAME) % 2), row), axis=1) + 0.5 + moved
    tied: FloatArray = places @ TIE_BREAK
    return tied


@lru_cache(maxsize=2)
def _tile(method: str) -> IndexArray:
    """Triangles (T, 3, 2) of one tile, as lattice (row, column) of their corners, each once."""
    side = PERIOD + 4 * FRAME
    triangles = Delaunay(_lattice_places((side, side), method)).simplices.astype(np.int64)
    corners = np.stack(np.divmod(triangles, side), axis=-1) - FRAME
    first = corners[np.arange(len(corners)), triangles.argmin(axis=1)]
    tile: IndexArray = corners[((first >= 0) & (first < PERIOD)).all(axis=1)]
    return tile


def _lattice_triangles(shape: tuple[int, ...], method: str) -> IndexArray:
    """Triangles (T, 3) of a whole framed lattice, as indices of its nodes."""
    tiles = [np.arange(-1, -(-side // PERIOD) + 1) * PERIOD + FRAME for side in shape]
    origin = np.stack(np.meshgrid(*tiles, indexing='ij'), axis=-1).reshape(-1, 1, 1, 2)
    corners = (origin + _tile(method)).reshape(-1, 3, 2)
    inside = ((corners >= 0) & (corners < np.array(shape))).all(axis=(1, 2))
    triangles: IndexArray = corners[inside] @ np.array([shape[1], 1])
    return triangles


def _circle_contains(places: FloatArray, triangles: IndexArray, others: FloatArray,
                     shape: tuple[int, ...]) -> BoolArray:
    """Return which circumcircles contain one of the others; a lattice's circles are small."""
    around = np.zeros(shape, dtype=bool)
    column, row = np.floor(others).astype(np.int64).T
    for down, right in np.ndindex(2 * FRAME + 1, 2 * FRAME + 1):
        at = row + down - FRAME, column + right - FRAME
        around[np.clip(at[0], 0, shape[0] - 1), np.clip(at[1], 0, shape[1] - 1)] = True
    contains = np.asarray(around.ravel()[triangles[:, 0]])
    centre, radius = _circles(places[triangles[contains]])
    contains[contains] = cKDTree(others).query(centre)[0] < radius
    return contains


def _hole_triangles(places: FloatArray, present: BoolArray, rim: BoolArray) -> IndexArray:
    """Delaunay triangles of the nodes present that have all corners on the rim of holes."""
    chosen = np.flatnonzero(rim & present)
    triangles = _triangles(places[chosen])
    if triangles.shape[1] == 2:
        return np.empty((0, 3), dtype=np.int64)
    triangles = chosen[triangles]
    # Outside the holes, circles contain nodes that are not on a rim.
    others = np.flatnonzero(present & ~rim)
    if len(others) == 0:
        return triangles
    centre, radius = _circles(places[triangles])
    real = np.isfinite(radius)
    tree = cKDTree(places[others], balanced_tree=False, compact_nodes=False)
    nearest = tree.query(np.where(real[:, None], centre, 0.0))[0]
    return triangles[real & (nearest >= radius)]


def _circles(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres (T, 2) and radii (T,) of the circumcircles of triangles (T, 3, 2); inf if flat."""
    a = corners[:, 0]
    (bx, by), (cx, cy) = (corners[:, 1] - a).T, (corners[:, 2] - a).T
    with np.errstate(divide='ignore', invalid='ignore'):
        scale = 0.5 / (bx * cy - by * cx)
        b, c = bx * bx + by * by, cx * cx + cy * cy
        to = np.stack(((cy * b - by * c) * scale, (bx * c - cx * b) * scale), axis=1)
    return a + to, np.where(np.isfinite(to).all(axis=1), np.hypot(*to.T), np.inf)


def _triangles(points: FloatArray) -> IndexArray:
    """Delaunay triangles (T, 3), or the links (T, 2) of a chain if all points are collinear."""
    if len(points) >= 3:
        try:
            return Delaunay(points).simplices.astype(np.int64)
        except QhullError:
            pass  # the points are collinear
    order = np.lexsort(points.T).astype(np.int64)
    return _stack(order[:-1], order[1:])


def _triangle_edges(triangles: IndexArray) -> IndexArray:
    k = triangles.shape[1]
    links = [triangles] if k == 2 else [triangles[:, [i, (i + 1) % k]] for i in range(k)]
    return np.concatenate(links)


def _stack(a: IndexArray, b: IndexArray) -> IndexArray:
    return np.stack((a.ravel(), b.ravel()), axis=1)


def _unique_pairs(pairs: IndexArray) -> IndexArray:
    if len(pairs) == 0:
        return pairs.reshape(0, 2)
    a, b = pairs.T
    low, high = np.minimum(a, b), np.maximum(a, b)
    size = int(high.max()) + 1
    keys = np.sort(low * size + high)  # numpy's unique takes five times as long
    keys = keys[np.concatenate(([True], keys[1:] != keys[:-1]))]
    return np.stack(np.divmod(keys, size), axis=1)
