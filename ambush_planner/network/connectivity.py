# SPDX-License-Identifier: Apache-2.0
"""Pairs of nodes to join: 8-connected lattice or Delaunay triangulation."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from ..arrays import FloatArray, IndexArray, found_in

# Cocircular points have several Delaunay triangulations. Ties are broken by shifting odd lattice
# rows by 1e-5 spacings, which alternates the diagonals from row to row, and by stretching and
# shearing the plane by about 1e-6. Straight lines stay straight, so no slivers appear at a border.
ROW_SHIFT = -1.0e-5
TIE_BREAK = np.array([[1.0, 1.0e-6], [0.0, 1.0 + 0.7e-6]])
# Height of a triangle, as a share of its longest side, below which it is flat.
FLAT = 0.25


def grid8_pairs(cells: IndexArray) -> IndexArray:
    """Pairs (E, 2) of nodes whose lattice cells (K, 2) = (row, column) are equal or adjacent."""
    pairs: IndexArray = cKDTree(cells).query_pairs(1.0, np.inf, output_type='ndarray')
    return pairs


def delaunay_pairs(points: FloatArray, mirrored: FloatArray,
                   spacing: float) -> tuple[IndexArray, IndexArray]:
    """Pairs (E, 2) and triangles (T, 3) of the Delaunay triangulation of points (K, 2) on a map.

    Mirror images (F, 2) of the points beyond the map's edge prevent long edges along it: two nodes
    are joined only if their Voronoi cells meet on the map. The lower node of a pair comes first.
    """
    places = np.concatenate((points, mirrored)) / spacing
    places[:, 0] += ROW_SHIFT * (np.floor(places[:, 1]) % 2)
    triangles = _triangles(places @ TIE_BREAK)
    sides = np.concatenate([np.sort(triangles[:, [k - 1, k]], axis=1)
                            for k in range(triangles.shape[1])])
    size = int(sides.max(initial=0)) + 1
    pairs = np.stack(np.divmod(np.unique(sides @ (size, 1)), size), axis=1)
    if triangles.shape[1] == 2:  # a chain has no triangles
        triangles = np.empty((0, 3), dtype=np.int64)
    return pairs[pairs[:, 1] < len(points)], triangles[(triangles < len(points)).all(axis=1)]


def drop_slivers(points: FloatArray, pairs: IndexArray, triangles: IndexArray) -> IndexArray:
    """Drop the longest side of each flat triangle (T, 3) whose other two sides are pairs (E, 2).

    Along an obstacle such a side would join two nodes past one that lies between them and only
    slightly further from the obstacle.
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
    known = pairs @ (size, 1)
    side, one, other = (found_in(known, np.minimum(i, j) * size + np.maximum(i, j))
                        for i, j in ((a, b), (apex, a), (apex, b)))
    return np.delete(pairs, side[(side >= 0) & (one >= 0) & (other >= 0)], axis=0)


def _triangles(points: FloatArray) -> IndexArray:
    """Delaunay triangles (T, 3), or the links (T, 2) of a chain if all points are collinear."""
    if len(points) >= 3:
        try:
            return Delaunay(points).simplices.astype(np.int64)
        except QhullError:
            pass  # the points are collinear
    order = np.lexsort(points.T).astype(np.int64)
    return np.stack((order[:-1], order[1:]), axis=1)

