"""A network laid on the ground: where nodes lie, and which of them are joined on free ground."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from .connectivity import (
    delaunay_pairs,
    grid8_pairs,
    lattice_delaunay_pairs,
    without_slivers,
)
from .node_sampling import (
    all_cells,
    gradient_points,
    lattice_points,
    lattice_shape,
    mirrored,
    nearest_cells,
    random_points,
)

if TYPE_CHECKING:
    from .construction import NetworkOptions


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """What a network is laid on: ``uv_ends`` (E, 2) are its ends in map axes [m], all different."""

    risk_map: RiskMap
    field: ObstacleField
    uv_ends: FloatArray
    spacing: float
    options: NetworkOptions


def joined(ground: FreeSpace, passage: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Nodes in map axes, the ends last, and the pairs that are joined on free ground.

    ``passage`` (K, 2) are nodes beside the lattice or the samples.
    """
    uv, pairs, triangles = _nodes_and_pairs(ground, np.concatenate((passage, ground.uv_ends)))
    a, b = uv[pairs[:, 0]], uv[pairs[:, 1]]
    clear = ground.field.clear_segments(a, b, ground.options.clearance)
    return uv, without_slivers(uv, pairs[clear], triangles)


def _nodes_and_pairs(
    ground: FreeSpace, others: FloatArray
) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Return nodes in map axes, the pairs that connectivity joins, and triangles that may be flat.

    ``others`` (K, 2), the ends last, are the last nodes.
    """
    options, spacing = ground.options, ground.spacing
    if options.method in ('random_delaunay', 'gradient_delaunay'):
        return _samples(ground, others)
    none = np.empty((0, 3), dtype=np.int64)
    shape = lattice_shape(ground.risk_map, spacing)
    uv = lattice_points(all_cells(shape), spacing, options.method)
    free = ground.field.clear_points(uv, options.clearance).reshape(shape)
    if free.size == 0:
        ends = range(len(ground.uv_ends))
        return ground.uv_ends, np.array(list(combinations(ends, 2))), none
    taken = nearest_cells(shape, spacing, options.method, ground.uv_ends)
    free[tuple(taken.T)] = False
    uv = np.concatenate((uv[free.ravel()], others))
    if options.method == 'uniform_grid8':
        return uv, _grid8_with_ends(free, taken), none
    return uv, *lattice_delaunay_pairs(free, others / spacing, options.method)


def _samples(
    ground: FreeSpace, others: FloatArray
) -> tuple[FloatArray, IndexArray, IndexArray]:
    options = ground.options
    sample = random_points if options.method == 'random_delaunay' else gradient_points
    uv = sample(ground.risk_map, ground.spacing, options.seed)
    uv = uv[ground.field.clear_points(uv, options.clearance)]
    taken = {int(np.argmin(((uv - end) ** 2).sum(axis=1))) for end in ground.uv_ends if len(uv)}
    uv = np.concatenate((np.delete(uv, sorted(taken), axis=0), others))
    return uv, *delaunay_pairs(uv, mirrored(ground.risk_map, ground.spacing, uv))


def _grid8_with_ends(free: BoolArray, cells: IndexArray) -> IndexArray:
    """Join the 8-connected lattice, the ends in the cells of the nodes they replaced.

    Ends in the same cell are joined with each other, and each with the cell's neighbours.
    """
    node_of = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    first = int(free.sum())
    in_cell: dict[tuple[int, ...], int] = {}
    shared = []
    for node, cell in enumerate(map(tuple, cells.tolist()), start=first):
        if cell in in_cell:
            shared.append((in_cell[cell], node))
        else:
            in_cell[cell] = node_of[cell] = node
    pairs = grid8_pairs(node_of)
    for present, node in shared:
        copies = pairs[(pairs == present).any(axis=1)]
        copies = np.where(copies == present, node, copies)
        pairs = np.concatenate((pairs, copies, [[present, node]]))
    return np.unique(pairs, axis=0) if shared else pairs
