"""Where the nodes lie: on a lattice, at random, or at random and dense where alpha changes."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..maps.risk_map import RiskMap

# Nodes of the even lattice lie off the square one by up to this much along each axis [spacings].
# Measured on an empty map for 0.25, 0.3, 0.35, over 20 spacings: shortest route over straight line
# in the worst direction from any of 24 places, best of six patterns: 1.107, 1.108, 1.103; smallest
# angle 19, 15, 11 degrees.
MOVED = 0.25
PATTERN = 2
# The pattern of these moves repeats itself after so many nodes.
PERIOD = 32
# As far inside as this, nodes have a mirror image beyond the map's edge [spacings].
MIRRORED = 4.0


def shifts(method: str) -> FloatArray:
    """How far (PERIOD, PERIOD, 2) nodes lie off the square lattice [spacings], by (row, column).

    On 'uniform_delaunay' no direction is preferred, because nodes are moved as if at random; the
    moves are always the same ones. Other lattices are square.
    """
    if method != 'uniform_delaunay':
        return np.zeros((PERIOD, PERIOD, 2))
    # A bit generator's numbers never change from version to version.
    raw = np.random.PCG64(PATTERN).random_raw(PERIOD * PERIOD * 2)
    unit = (raw >> np.uint64(11)) * 2.0**-53
    moves = (2.0 * unit.reshape(PERIOD, PERIOD, 2) - 1.0) * MOVED
    return np.asarray(moves, dtype=np.float64)


def lattice_shape(risk_map: RiskMap, spacing: float) -> tuple[int, int]:
    """Rows and columns of the lattice whose nodes (i + 0.5) * spacing lie on the map."""
    width, height = risk_map.size
    rows, columns = (int(np.floor(side / spacing - 0.5 + 1e-9)) + 1 for side in (height, width))
    return rows, columns


def lattice_points(cells: IndexArray, spacing: float, method: str) -> FloatArray:
    """Places (K, 2) in map axes [m] of the lattice nodes ``cells`` (K, 2) = (row, column)."""
    row, column = cells.T
    square = np.stack((column, row), axis=1) + 0.5
    places: FloatArray = (square + shifts(method)[row % PERIOD, column % PERIOD]) * spacing
    return places


def all_cells(shape: tuple[int, int]) -> IndexArray:
    """(row, column) of every lattice node, row by row from the lower left."""
    return np.stack(np.divmod(np.arange(shape[0] * shape[1]), shape[1]), axis=1)


def nearest_cells(
    shape: tuple[int, int], spacing: float, method: str, uv: FloatArray
) -> IndexArray:
    """(row, column) of the lattice node nearest to each position (K, 2) in map axes [m]."""
    around = all_cells((5, 5)) - 2
    near = np.floor(uv[:, ::-1] / spacing).astype(np.int64)[:, None] + around
    near = np.clip(near, 0, np.array(shape) - 1)
    places = lattice_points(near.reshape(-1, 2), spacing, method).reshape(*near.shape)
    nearest = np.argmin(((places - uv[:, None]) ** 2).sum(axis=2), axis=1)
    cells: IndexArray = near[np.arange(len(uv)), nearest]
    return cells


def random_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """As many uniform random samples in map axes as the lattice has nodes."""
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    return rng.random((rows * columns, 2)) * risk_map.size


def mirrored(risk_map: RiskMap, spacing: float, uv: FloatArray) -> FloatArray:
    """Mirror images (F, 2) of the nodes near the map's outer edge, beyond that edge [m]."""
    images = []
    for axis, side in ((0, 0.0), (1, 0.0), (0, risk_map.size[0]), (1, risk_map.size[1])):
        near = uv[np.abs(uv[:, axis] - side) < MIRRORED * spacing].copy()
        near[:, axis] = 2.0 * side - near[:, axis]
        images.append(near)
    return np.concatenate(images)


def gradient_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """As many random samples as the lattice has nodes, denser where alpha changes.

    The density is proportional to 1 + |grad alpha| / mean |grad alpha|: half of the samples lie
    as ``random_points`` would lay them, half follow the gradient (the paper's outlook, section
    III-B). Obstacle cells take part with the loss that stands in them.
    """
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    weight = np.cumsum(_gradient_weights(risk_map).ravel())
    cell = np.searchsorted(weight, rng.random(rows * columns) * weight[-1], side='right')
    row, column = np.divmod(np.minimum(cell, weight.size - 1), risk_map.alpha.shape[1])
    corner = np.stack((column, row), axis=1)
    return (corner + rng.random(corner.shape)) * risk_map.resolution


def _gradient_weights(risk_map: RiskMap) -> FloatArray:
    alpha = np.pad(risk_map.nearest_free_alpha(), 1, mode='edge')
    slope = np.hypot(alpha[1:-1, 2:] - alpha[1:-1, :-2], alpha[2:, 1:-1] - alpha[:-2, 1:-1])
    mean = slope.mean()
    return np.ones_like(slope) if mean == 0.0 else 1.0 + slope / mean
