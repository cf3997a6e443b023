# SPDX-License-Identifier: Apache-2.0
"""Pairs (K, 2) of neighbouring nodes: 8-connected lattice or Delaunay triangulation."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from ..arrays import BoolArray, FloatArray, IndexArray

# Cocircular points have several Delaunay triangulations. Ties are broken by shifting odd lattice
# rows by 1e-5 spacings, which alternates the diagonals from row to row, and by stretching and
# shearing the plane by about 1e-6. Straight lines stay straight, so no slivers appear at a border.
ROW_SHIFT = -1.0e-5
TIE_BREAK = np.array([[1.0, 1.0e-6], [0.0, 1.0 + 0.7e-6]])
# Height of a triangle, as a share of its longest side, below which it is flat.
FLAT = 0.25


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


def delaunay_pairs(points: FloatArray, mirrored: FloatArray,
                   spacing: float) -> tuple[IndexArray, IndexArray]:
    """Edges (E, 2) and triangles (T, 3) of the Delaunay triangulation of points (K, 2) on a map.

    Their mirror images (F, 2) beyond the map's edge prevent long edges between nodes along it: two
    nodes are joined only if their Voronoi cells meet on the map.
    """
    places = np.concatenate((points, mirrored)) / spacing
    places[:, 0] += ROW_SHIFT * (np.floor(places[:, 1]) % 2)
    triangles = _triangles(places @ TIE_BREAK)
    pairs = _triangle_edges(triangles)
    pairs = _unique_pairs(pairs[(pairs < len(points)).all(axis=1)])
    return pairs, triangles[(triangles < len(points)).all(axis=1)]


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
