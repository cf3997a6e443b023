# SPDX-License-Identifier: Apache-2.0
"""Layout of a network: nodes, and edges that keep clear of obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from ..maps.risk_map import RiskMap
from .connectivity import delaunay_pairs, drop_slivers, grid8_pairs
from .grading import Grading
from .node_sampling import (
    SAMPLES,
    all_cells,
    graded_points,
    lattice_points,
    lattice_shape,
    mirrored_points,
)
from .shortest_paths import reachable_from

if TYPE_CHECKING:
    from .construction import NetworkOptions


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Map, obstacles and options of a network to lay out.

    ``uv_ends`` (E, 2) are its distinct ends in map axes [m], of which ``start`` is the index of the
    start. ``grading`` is None for a plain lattice.
    """

    risk_map: RiskMap
    field: ObstacleField
    uv_ends: FloatArray
    start: int
    spacing: float
    options: NetworkOptions
    grading: Grading | None = None

    def spacing_at(self, uv: FloatArray) -> FloatArray:
        """Return the spacing of nodes (K,) at points (K, 2) in map axes [m]."""
        if self.grading is None:
            return np.full(len(uv), self.spacing)
        points, ends = (self.risk_map.to_world(each) for each in (uv, self.uv_ends))
        return self.grading.spacing_at(points, ends, self.spacing)


def connect_nodes(space: FreeSpace,
                  extra: FloatArray) -> tuple[FloatArray, IndexArray, list[int]]:
    """Join the lattice or the samples, ``extra`` nodes (K, 2) and the ends, in this order.

    Returns the nodes (N, 2) in map axes, the edges (E, 2) in both directions, and the indices of
    ends that cannot be reached from the start.
    """
    uv, pairs, triangles = _nodes_and_pairs(space, np.concatenate((extra, space.uv_ends)))
    a, b = uv[pairs[:, 0]], uv[pairs[:, 1]]
    clear = space.field.clear_segments(a, b, space.options.clearance)
    pairs, first = drop_slivers(uv, pairs[clear], triangles), len(uv) - len(space.uv_ends)
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    reached = reachable_from(edges, len(uv), first + space.start)
    return uv, edges, np.flatnonzero(~reached[first:]).tolist()


def _nodes_and_pairs(space: FreeSpace,
                     others: FloatArray) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Nodes (N, 2) in map axes, pairs of neighbours (E, 2), and triangles (T, 3).

    ``others`` (K, 2), which include the ends, are the last nodes. Each end replaces the nearest
    node of the lattice or the samples.
    """
    options, clearance = space.options, space.options.clearance
    uv = _points(space)
    free, ends = space.field.clear_points(uv, clearance), space.uv_ends
    if not len(uv):
        return ends, np.array(list(combinations(range(len(ends)), 2))), np.empty((0, 3), int)
    taken = cKDTree(uv).query(ends)[1]
    free[taken] = False
    nodes = np.concatenate((uv[free], others))
    if options.method == 'uniform_grid8':
        cells = all_cells(lattice_shape(space.risk_map, space.spacing))
        pairs = grid8_pairs(np.concatenate((cells[free], cells[taken])))
        return nodes, pairs, np.empty((0, 3), int)
    mirrored = mirrored_points(space.risk_map, space.spacing, nodes)
    return nodes, *delaunay_pairs(nodes, mirrored, space.spacing)


def _points(space: FreeSpace) -> FloatArray:
    """Nodes (K, 2) of the lattice, also those in obstacles, or the samples clear of them."""
    options, risk_map, spacing = space.options, space.risk_map, space.spacing
    if space.grading:
        return graded_points(risk_map, spacing, space.spacing_at)
    if sample := SAMPLES.get(options.method):
        uv = sample(risk_map, spacing, options.seed)
        return uv[space.field.clear_points(uv, options.clearance)]
    return lattice_points(all_cells(lattice_shape(risk_map, spacing)), spacing, options.method)
