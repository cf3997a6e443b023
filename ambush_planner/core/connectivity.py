"""Which nodes are joined: 8-connected lattice or Delaunay triangulation; pairs (K, 2)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay, QhullError

from .network import IndexArray
from .risk_map import FloatArray

BoolArray = npt.NDArray[np.bool_]

# Cocircular points have several Delaunay triangulations. Where the lattice's own rule does not
# decide, ties fall as if the plane were stretched and sheared by about one part in a million:
# lines stay lines, so no slivers appear along the border.
TIE_BREAK = np.array([[1.0, 1.0e-6], [0.0, 1.0 + 0.7e-6]])
# Nodes on one line give triangles without area when rounding bends the line; in lattice units^2.
NO_AREA = 1e-9


def grid8_pairs(node_of: IndexArray) -> IndexArray:
    """Join each node to its eight neighbours; ``node_of`` (rows, columns) is -1 where none is."""
    pairs = [
        _stack(node_of[:, :-1], node_of[:, 1:]),
        _stack(node_of[:-1, :], node_of[1:, :]),
        _stack(node_of[:-1, :-1], node_of[1:, 1:]),
        _stack(node_of[:-1, 1:], node_of[1:, :-1]),
    ]
    joined = np.concatenate(pairs)
    return joined[(joined >= 0).all(axis=1)]


def delaunay_pairs(points: FloatArray) -> IndexArray:
    """Edges of the Delaunay triangulation of points (K, 2); fewer than 3 points form a chain."""
    return _triangle_edges(_triangles(points))


def lattice_delaunay_pairs(points: FloatArray, node_of: IndexArray, spacing: float) -> IndexArray:
    """Edges of a Delaunay triangulation of a lattice with gaps and a few nodes off the lattice.

    ``points`` (K, 2) are in map axes, ``node_of`` (rows, columns) numbers those that lie on the
    lattice (-1: a gap); a node off the lattice stands in the cell of a gap. A lattice square with
    four nodes has an empty circumcircle, so it is a cell of the triangulation, and either diagonal
    will do. The rule is a herringbone: rising diagonals in even rows of squares, falling ones in
    odd rows. No direction is preferred and every inner node has six neighbours. What lies between
    the full squares is triangulated on its own (Qhull), from the nodes on its rim: a triangle
    there can have no other corners.

    The lattice is taken to go on for one node beyond its border. Otherwise two nodes that stand
    off it near the same border would be joined along the whole border, past every site.
    """
    count = len(points)
    points, node_of = _with_frame(points, node_of, spacing)
    whole = np.stack(
        (node_of[:-1, :-1], node_of[:-1, 1:], node_of[1:, :-1], node_of[1:, 1:])
    )
    full = np.asarray((whole >= 0).all(axis=0))
    rising = full & (np.arange(full.shape[0]) % 2 == 1)[:, None]  # row 0 is the frame's
    falling = full & ~rising
    sides = _full_square_sides(whole, full)
    diagonals = [
        _stack(whole[0][rising], whole[3][rising]),
        _stack(whole[1][falling], whole[2][falling]),
    ]
    pairs = np.concatenate([sides, *diagonals, _gap_pairs(points, node_of, full, spacing)])
    return _unique_pairs(pairs[(pairs < count).all(axis=1)])


def _with_frame(
    points: FloatArray, node_of: IndexArray, spacing: float
) -> tuple[FloatArray, IndexArray]:
    """Lay one more row or column of lattice nodes round the lattice, numbered after the others."""
    framed = np.pad(node_of, 1, constant_values=-2)
    row, column = np.nonzero(framed == -2)
    framed[row, column] = len(points) + np.arange(len(row))
    frame = (np.stack((column, row), axis=1) - 0.5) * spacing
    return np.concatenate((points, frame)), framed


def _full_square_sides(whole: IndexArray, full: BoolArray) -> IndexArray:
    corners = whole[:, full]
    return np.concatenate(
        [_stack(corners[i], corners[j]) for i, j in ((0, 1), (2, 3), (0, 2), (1, 3))]
    )


def _gap_pairs(
    points: FloatArray, node_of: IndexArray, full: BoolArray, spacing: float
) -> IndexArray:
    """Delaunay edges in the part of the plane that the full squares leave."""
    rim = np.ones(len(points), dtype=bool)
    # The border is on the rim: a node off the lattice may lie beyond it.
    inner = np.pad(full, 1, constant_values=False)
    surrounded = inner[:-1, :-1] & inner[:-1, 1:] & inner[1:, :-1] & inner[1:, 1:]
    rim[node_of[surrounded & (node_of >= 0)]] = False
    chosen = np.flatnonzero(rim)
    units = points[chosen] / spacing + 0.5  # from the frame's first node
    triangles = _triangles(units)
    if triangles.shape[1] == 3:
        corners = units[triangles]
        spurious = _in_full_square(corners.mean(axis=1), full) | (_areas(corners) < NO_AREA)
        triangles = triangles[~spurious]
    pairs: IndexArray = chosen[_triangle_edges(triangles)]
    return pairs


def _areas(corners: FloatArray) -> FloatArray:
    """Areas of triangles (T, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas: FloatArray = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return areas


def _in_full_square(units: FloatArray, full: BoolArray) -> BoolArray:
    """Tell which positions, in lattice units from the first node, lie in a full square."""
    index = np.floor(units).astype(np.int64)
    column, row = index.T
    inside = (index >= 0).all(axis=1) & (row < full.shape[0]) & (column < full.shape[1])
    result = np.zeros(len(units), dtype=bool)
    result[inside] = full[row[inside], column[inside]]
    return result


def _triangles(points: FloatArray) -> IndexArray:
    """Triangles (T, 3); where all points lie on a line, the links (T, 2) of their chain."""
    if len(points) >= 3:
        try:
            return Delaunay(points @ TIE_BREAK).simplices.astype(np.int64)
        except QhullError:
            pass  # all points on one line: a chain joins them
    order = np.lexsort(points.T).astype(np.int64)
    return _stack(order[:-1], order[1:])


def _triangle_edges(triangles: IndexArray) -> IndexArray:
    k = triangles.shape[1]
    links = [triangles] if k == 2 else [triangles[:, [i, (i + 1) % k]] for i in range(k)]
    return _unique_pairs(np.concatenate(links))


def _stack(a: IndexArray, b: IndexArray) -> IndexArray:
    return np.stack((a.ravel(), b.ravel()), axis=1)


def _unique_pairs(pairs: IndexArray) -> IndexArray:
    if len(pairs) == 0:
        return pairs.reshape(0, 2)
    low, high = pairs.min(axis=1), pairs.max(axis=1)
    size = int(high.max()) + 1
    keys = np.unique(low * size + high)
    return np.stack(np.divmod(keys, size), axis=1)
