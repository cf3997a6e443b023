# SPDX-License-Identifier: Apache-2.0
"""Layout of a network: its nodes, and the pairs of them joined by obstacle-free edges."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import BoolArray, FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from .connectivity import delaunay_pairs, grid8_pairs, lattice_delaunay_pairs, without_slivers
from .node_sampling import (
    all_cells,
    gradient_points,
    lattice_points,
    lattice_shape,
    mirrored_points,
    nearest_cells,
    random_points,
)

if TYPE_CHECKING:
    from .construction import NetworkOptions


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The map, options and distinct ends ``uv_ends`` (E, 2) in map axes [m] of a network."""

    risk_map: RiskMap
    field: ObstacleField
    uv_ends: FloatArray
    spacing: float
    options: NetworkOptions


def connect_nodes(space: FreeSpace, extra: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Nodes in map axes, the ends last, and the pairs of them joined by clear edges.

    ``extra`` (K, 2) are nodes in addition to the lattice or the samples.
    """
    uv, pairs, triangles = _nodes_and_pairs(space, np.concatenate((extra, space.uv_ends)))
    a, b = uv[pairs[:, 0]], uv[pairs[:, 1]]
    clear = space.field.clear_segments(a, b, space.options.clearance)
    return uv, without_slivers(uv, pairs[clear], triangles)


def _nodes_and_pairs(space: FreeSpace,
                     others: FloatArray) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Nodes in map axes, the joined pairs, and the triangles that may be flat.

    ``others`` (K, 2), which include the ends, are the last nodes.
    """
    options, spacing = space.options, space.spacing
    if options.method in ('random_delaunay', 'gradient_delaunay'):
        return _sampled_nodes_and_pairs(space, others)
    none = np.empty((0, 3), dtype=np.int64)
    shape = lattice_shape(space.risk_map, spacing)
    uv = lattice_points(all_cells(shape), spacing, options.method)
    free = space.field.clear_points(uv, options.clearance).reshape(shape)
    if free.size == 0:
        ends = range(len(space.uv_ends))
        return space.uv_ends, np.array(list(combinations(ends, 2))), none
    taken = nearest_cells(shape, spacing, options.method, space.uv_ends)
    free[tuple(taken.T)] = False
    uv = np.concatenate((uv[free.ravel()], others))
    if options.method == 'uniform_grid8':
        return uv, _grid8_with_ends(free, taken), none
    return uv, *lattice_delaunay_pairs(free, others / spacing, options.method)


def _sampled_nodes_and_pairs(space: FreeSpace,
                             others: FloatArray) -> tuple[FloatArray, IndexArray, IndexArray]:
    options = space.options
    sample = random_points if options.method == 'random_delaunay' else gradient_points
    uv = sample(space.risk_map, space.spacing, options.seed)
    uv = uv[space.field.clear_points(uv, options.clearance)]
    taken = {int(np.argmin(((uv - end) ** 2).sum(axis=1))) for end in space.uv_ends if len(uv)}
    uv = np.concatenate((np.delete(uv, sorted(taken), axis=0), others))
    return uv, *delaunay_pairs(uv, mirrored_points(space.risk_map, space.spacing, uv))


def _grid8_with_ends(free: BoolArray, cells: IndexArray) -> IndexArray:
    """Join the 8-connected lattice, with the ends in the cells of the nodes they replaced.

    Ends in the same cell are joined to each other, and each to the cell's neighbours.
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
