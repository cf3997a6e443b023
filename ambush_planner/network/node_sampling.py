# SPDX-License-Identifier: Apache-2.0
"""Node positions: on a lattice, plain or graded, at random, or denser where alpha changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..maps.risk_map import RiskMap

# Largest offset of 'uniform_delaunay' nodes from the square lattice along each axis [spacings].
# Measured for 0.25, 0.3, 0.35 on an empty map, over 20 spacings from 24 places: worst ratio of
# shortest route to straight line, best of six patterns: 1.107, 1.108, 1.103; smallest angle 19,
# 15, 11 degrees.
MAX_SHIFT = 0.25
# Seed of the best pattern of offsets.
PATTERN_SEED = 2
# Rows and columns after which the pattern of offsets repeats.
PERIOD = 32
# Ratio of a cell's side to the grading's spacing above which the cell is divided into four.
MAX_SIDE = 1.42
# Maximum number of nodes that grading adds.
MAX_GRADED = 30_000
# Distance from the map's edge within which nodes have mirror images beyond it [spacings].
MIRROR_DISTANCE = 4.0


def shifts(method: str) -> FloatArray:
    """Offsets (PERIOD, PERIOD, 2) of nodes from the square lattice [spacings], by (row, column).

    For 'uniform_delaunay' they are pseudorandom but fixed, so that no direction is preferred; for
    other lattices they are 0.
    """
    if method != 'uniform_delaunay':
        return np.zeros((PERIOD, PERIOD, 2))
    # Unlike Generator methods, a bit generator's raw output is stable between numpy versions.
    raw = np.random.PCG64(PATTERN_SEED).random_raw(PERIOD * PERIOD * 2)
    unit = (raw >> np.uint64(11)) * 2.0**-53
    moves = (2.0 * unit.reshape(PERIOD, PERIOD, 2) - 1.0) * MAX_SHIFT
    return np.asarray(moves, dtype=np.float64)


def lattice_shape(risk_map: RiskMap, spacing: float, place: float = 0.5) -> tuple[int, int]:
    """Rows and columns of the lattice whose cells' points (i + place) * spacing lie on the map."""
    width, height = risk_map.size
    rows, columns = (int(np.floor(side / spacing - place + 1e-9)) + 1 for side in (height, width))
    return rows, columns


def lattice_points(cells: IndexArray, spacing: float, method: str) -> FloatArray:
    """Positions (K, 2) in map axes [m] of the lattice nodes ``cells`` (K, 2) = (row, column)."""
    row, column = cells.T
    square = np.stack((column, row), axis=1) + 0.5
    places: FloatArray = (square + shifts(method)[row % PERIOD, column % PERIOD]) * spacing
    return places


def all_cells(shape: tuple[int, int]) -> IndexArray:
    """(row, column) of every lattice node, row by row from the lower left."""
    return np.stack(np.divmod(np.arange(shape[0] * shape[1]), shape[1]), axis=1)


def graded_points(risk_map: RiskMap, spacing: float,
                  spacing_at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Nodes (K, 2) in map axes [m] of 'uniform_delaunay' lattices with the spacing at each place.

    Cells of the plain lattice are divided into four until they are as small as ``spacing_at`` their
    centres asks for; each cell that remains has a node. All spacings grow if there would be more
    than ``MAX_GRADED`` nodes beyond the plain lattice's.
    """
    plain = math.prod(lattice_shape(risk_map, spacing))
    growth = 1.0
    while True:
        points = _quadtree_points(risk_map, spacing, spacing_at, growth)
        if len(points) <= plain + MAX_GRADED:
            return points
        growth *= 1.5


def _quadtree_points(risk_map: RiskMap, side: float,
                     spacing_at: Callable[[FloatArray], FloatArray], growth: float) -> FloatArray:
    """Nodes (K, 2) in cells of a ``side`` [m] and their parts, for spacings times ``growth``."""
    cells, points = all_cells(lattice_shape(risk_map, side, 0.0)), []
    while len(cells):
        centres = np.asarray((cells[:, ::-1] + 0.5) * side, dtype=np.float64)
        large = MAX_SIDE * growth * spacing_at(centres) < side
        whole = ~large & (centres <= np.array(risk_map.size) + 1e-9 * side).all(axis=1)
        points.append(lattice_points(cells[whole], side, 'uniform_delaunay'))
        quarters = np.indices((2, 2)).reshape(2, -1).T
        cells, side = (cells[large][:, None] * 2 + quarters).reshape(-1, 2), side / 2.0
    return np.concatenate(points)


def random_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """Uniform random samples (K, 2) in map axes [m], as many as the lattice has nodes."""
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    return rng.random((rows * columns, 2)) * risk_map.size


def mirrored_points(risk_map: RiskMap, spacing: float, uv: FloatArray) -> FloatArray:
    """Mirror images (F, 2) of the nodes near the map's edge, beyond it [m]."""
    images = []
    for axis, side in ((0, 0.0), (1, 0.0), (0, risk_map.size[0]), (1, risk_map.size[1])):
        near = uv[np.abs(uv[:, axis] - side) < MIRROR_DISTANCE * spacing].copy()
        near[:, axis] = 2.0 * side - near[:, axis]
        images.append(near)
    return np.concatenate(images)


def gradient_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """Random samples (K, 2) in map axes [m], denser where alpha changes, as many as lattice nodes.

    The density is proportional to 1 + |grad alpha| / mean |grad alpha| (the paper's outlook,
    section III-B). Obstacle cells take the loss of the nearest free cell.
    """
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    alpha = np.pad(risk_map.nearest_free_alpha(), 1, mode='edge')
    slope = np.hypot(alpha[1:-1, 2:] - alpha[1:-1, :-2], alpha[2:, 1:-1] - alpha[:-2, 1:-1])
    weight = np.cumsum(1.0 + slope.ravel() / (slope.mean() or 1.0))
    cell = np.searchsorted(weight, rng.random(rows * columns) * weight[-1], side='right')
    row, column = np.divmod(np.minimum(cell, weight.size - 1), risk_map.alpha.shape[1])
    corner = np.stack((column, row), axis=1)
    return (corner + rng.random(corner.shape)) * risk_map.resolution


# Samplers of the methods that join random samples by a Delaunay triangulation.
SAMPLES: Mapping[str, Callable[[RiskMap, float, int], FloatArray]] = MappingProxyType(
    {'random_delaunay': random_points, 'gradient_delaunay': gradient_points})
