# SPDX-License-Identifier: Apache-2.0
"""The mean loss that an ambush at each place of the map causes to a trip; and the best ambush."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..arrays import ROUNDING, BoolArray, FloatArray
from ..game.hits import largest_product
from ..game.legs import exposed_legs
from ..game.strategy import TripStrategy
from ..maps.risk_map import RiskMap
from .cell_losses import CellLosses, CellSearch

# Share of the value below which upper bounds of mean losses are shown instead of the mean losses.
_NEGLIGIBLE = 1e-3


class BestAmbush(NamedTuple):
    """Position (x, y) of a best ambush [m], and the share of departures that it hits on any leg."""

    xy: tuple[float, float]
    hit: float


class CostRaster(NamedTuple):
    """Mean loss (H, W) that an ambush causes at the costliest cell of each block.

    Blocks have ``block`` cells a side. The cost is NaN in obstacles and in the secured area, which
    ``secured`` (H, W) marks.
    """

    cost: FloatArray
    secured: BoolArray
    block: int


def has_cell_sites(trip: TripStrategy) -> bool:
    """Return whether the value holds for ambushes at any cell, not only at the network's nodes."""
    return trip.game.options.widened > 0.0


def best_ambush(trip: TripStrategy, risk_map: RiskMap) -> BestAmbush | None:
    """Find a place at which an ambush causes the value; None if the value is 0."""
    game, legs = trip.game, trip.joint
    loss, row = largest_product(legs.loss, legs.entering, trip.law)
    if not trip.value > 0.0 or row < 0:
        return None
    point, entering = legs.site_points[row], legs.entering[row]
    if has_cell_sites(trip) and loss < trip.value * (1.0 - ROUNDING):
        cells = CellLosses(risk_map, game.options.ambush_in_obstacles)
        used = trip.law.uses(legs.edge_count) > 0.0
        found = CellSearch(cells, legs.games, used).worst(trip.law, loss)
        if len(found.points):
            point, entering = found.points[0], found.entering[0]
    hits = [float(leg.law.meets(row)[0]) for leg, row in zip(
        trip.legs, legs.rows_by_leg(csr_matrix(entering)), strict=True)]
    x, y = point.tolist()
    return BestAmbush((x, y), 1.0 - float(np.prod(1.0 - np.minimum(hits, 1.0))))


def cost_raster(trip: TripStrategy, risk_map: RiskMap, most: int) -> CostRaster:
    """Compute the cost of ambushes on a map, with at most ``most`` blocks along each side.

    Without a reach, the cost is that of an ambush at the nearest node.
    """
    block = math.ceil(max(risk_map.alpha.shape) / most)
    cells = CellLosses(risk_map, trip.game.options.ambush_in_obstacles)
    costliest, loss = cells.costliest_cells(block)
    points, shape = cells.centres(costliest.reshape(-1, 2), 1), costliest.shape[:2]
    loss, secured = loss.ravel(), trip.game.secured.covers(points)
    cost = np.full(len(loss), np.nan)
    sites = np.flatnonzero((loss >= 0.0) & ~secured)
    if has_cell_sites(trip):
        cost[sites] = _costs_at_cells(trip, points[sites], loss[sites])
    else:
        node_costs = np.zeros(trip.game.node_count)
        node_costs[trip.game.sites] = trip.joint.loss * trip.law.meets(trip.joint.entering)
        cost[sites] = node_costs[cKDTree(trip.game.network.points).query(points[sites])[1]]
    return CostRaster(cost.reshape(shape), secured.reshape(shape), block)


def _costs_at_cells(trip: TripStrategy, points: FloatArray, loss: FloatArray) -> FloatArray:
    """Mean losses (K,) that ambushes exactly at ``points`` (K, 2) cause."""
    game, legs, law = trip.game, trip.joint, trip.law
    exposed = exposed_legs(legs.games, law.uses(legs.edge_count) > 0.0)
    rows = exposed.entering(points, game.reach - game.options.widened)
    cost = loss * law.meets_at_most(rows)
    exact = np.flatnonzero(cost > _NEGLIGIBLE * trip.value)
    cost[exact] = loss[exact] * law.meets(csr_matrix(rows[exact]))
    return np.asarray(cost)
