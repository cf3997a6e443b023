"""Where the nodes lie: a square lattice, random samples, or samples dense where alpha changes."""

from __future__ import annotations

import numpy as np

from .network import IndexArray
from .risk_map import FloatArray, RiskMap


def lattice_shape(risk_map: RiskMap, spacing: float) -> tuple[int, int]:
    """Rows and columns of the lattice whose nodes (i + 0.5) * spacing lie on the map."""
    width, height = risk_map.size
    rows, columns = (int(np.floor(side / spacing - 0.5 + 1e-9)) + 1 for side in (height, width))
    return rows, columns


def lattice_points(risk_map: RiskMap, spacing: float) -> FloatArray:
    """Lattice nodes in map axes (rows * columns, 2) [m], row by row from the lower left."""
    rows, columns = lattice_shape(risk_map, spacing)
    u, v = np.meshgrid((np.arange(columns) + 0.5) * spacing, (np.arange(rows) + 0.5) * spacing)
    return np.stack((u.ravel(), v.ravel()), axis=1)


def lattice_cells(risk_map: RiskMap, spacing: float, uv: FloatArray) -> IndexArray:
    """(row, column) of the lattice node nearest to each position (K, 2) in map axes."""
    rows, columns = lattice_shape(risk_map, spacing)
    index = np.floor(uv / spacing).astype(np.int64)
    return np.clip(index[:, ::-1], 0, (rows - 1, columns - 1))


def random_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """As many uniform random samples in map axes as the lattice has nodes."""
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    return rng.random((rows * columns, 2)) * risk_map.size


def gradient_points(risk_map: RiskMap, spacing: float, seed: int) -> FloatArray:
    """As many random samples as the lattice has nodes, denser where alpha changes.

    The density is proportional to 1 + |grad alpha| / mean |grad alpha|: half of the samples lie
    as ``random_points`` would lay them, half follow the gradient (the paper's outlook, section
    III-B). Obstacle cells take part with the loss that stands in them.
    """
    rows, columns = lattice_shape(risk_map, spacing)
    rng = np.random.default_rng(seed)
    weight = np.cumsum(_gradient_weights(risk_map).ravel())
    cell = np.searchsorted(weight, rng.random(rows * columns) * weight[-1], side="right")
    row, column = np.divmod(np.minimum(cell, weight.size - 1), risk_map.alpha.shape[1])
    corner = np.stack((column, row), axis=1)
    return (corner + rng.random(corner.shape)) * risk_map.resolution


def _gradient_weights(risk_map: RiskMap) -> FloatArray:
    alpha = np.pad(risk_map.alpha, 1, mode="edge")
    slope = np.hypot(alpha[1:-1, 2:] - alpha[1:-1, :-2], alpha[2:, 1:-1] - alpha[:-2, 1:-1])
    mean = slope.mean()
    return np.ones_like(slope) if mean == 0.0 else 1.0 + slope / mean
