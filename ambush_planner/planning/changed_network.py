# SPDX-License-Identifier: Apache-2.0
"""A plan's networks on another map of the same ground: lost edges, and losses of the nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..maps.obstacles import nearest_on_segments
from ..maps.occupancy import OccupancyMap, OccupancyOptions, obstacles_in, risk_from_occupancy
from ..maps.risk_map import TOUCH, cells_at, to_map_axes
from .cell_losses import LatestLosses
from .plan import Plan

# Maximum number of new obstacle cells; with more, all edges count as lost.
_MAX_CELLS = 100_000


@dataclass(frozen=True, eq=False)
class ChangedNetwork:
    """A plan's networks on the ``newest`` map, compared with the map that it was planned on.

    Attributes
    ----------
    changed : (K,)
        Flat indices of the cells with another value.
    new_obstacles : (L, 2)
        Centres of the cells that have become obstacles, in map axes [m].
    lost : (M,)
        Marks the edges of all legs that meet a new obstacle or lead to a forbidden node.
    alpha : (N,)
        Losses of the nodes on the newest map.
    """

    newest: OccupancyMap
    changed: IndexArray
    new_obstacles: FloatArray
    lost: BoolArray
    alpha: FloatArray


class PlannedNetwork:
    """A plan's networks, with the map ``planned_on`` to compare others with."""

    def __init__(self, plan: Plan, planned_on: OccupancyMap, occupancy: OccupancyOptions,
                 losses: LatestLosses) -> None:
        networks, self._planned_on = [leg.network for leg in plan.legs], planned_on
        self._ends = [(each.source, each.target) for each in networks]
        self._edges = np.concatenate([each.edges for each in networks])
        self._occupancy, self._losses = occupancy, losses
        self._clearance = plan.options.network.clearance
        self._threshold = plan.options.game.alpha_threshold
        # Whether an ambusher can hide in an obstacle, at the loss of the nearest free cell.
        self.hiding = plan.trip.game.reach > 0.0 and plan.options.game.ambush_in_obstacles
        self.uv = to_map_axes(planned_on.origin, plan.network.points)
        # The construction of networks and plans takes a node's loss from the same cell.
        self._cells = cells_at(self.uv, planned_on.resolution, planned_on.values.shape)
        self._tails, self._heads = (self.uv[self._edges[:, k]] for k in (0, 1))
        self._middles = cKDTree((self._tails + self._heads) / 2)

    def compare(self, newest: OccupancyMap) -> ChangedNetwork:
        """Compare the newest map, which is of the same ground, with that of the plan."""
        old_values, values = self._planned_on.values.ravel(), newest.values.ravel()
        # Flat indices: with rows and columns numpy takes five times as long.
        changed = np.flatnonzero(old_values != values)
        old, new = (obstacles_in(each[changed], self._occupancy) for each in (old_values, values))
        cells = np.divmod(changed[new & ~old], newest.values.shape[1])
        new_obstacles = np.multiply(np.stack(cells[::-1], axis=1) + 0.5, newest.resolution)
        alpha = self._node_losses(newest)
        lost = (alpha > self._threshold)[self._edges[:, 1]]
        if len(new_obstacles) > _MAX_CELLS:
            lost[:] = True
        else:
            lost[self._edges_near(new_obstacles, newest.resolution)] = True
        return ChangedNetwork(newest, changed, new_obstacles, lost, alpha)

    def _node_losses(self, newest: OccupancyMap) -> FloatArray:
        """Losses alpha (N,) of the nodes on the newest map."""
        if self.hiding:
            losses = self._losses.update(newest, self._occupancy, True)
            alpha = losses.block_losses(np.stack(self._cells, axis=1))
        else:
            values = newest.values[self._cells][None, :]
            alpha = risk_from_occupancy(values, 1.0, options=self._occupancy).alpha[0].copy()
        alpha[np.unique(self._ends)] = 0.0
        return alpha

    def _edges_near(self, centres: FloatArray, resolution: float) -> IndexArray:
        """Edges (K,) whose clearance meets the circumscribed circle of a cell of centres (L, 2)."""
        reach = self._clearance + (math.sqrt(0.5) + TOUCH) * resolution
        half = float(np.hypot(*(self._heads - self._tails).T).max(initial=0.0)) / 2
        pairs = cKDTree(centres).sparse_distance_matrix(self._middles, half + reach,
                                                        output_type='ndarray')
        place, edge = centres[pairs['i']], pairs['j']
        nearest = nearest_on_segments(place, self._tails[edge], self._heads[edge])
        return np.unique(edge[np.hypot(*(place - nearest).T) <= reach])
