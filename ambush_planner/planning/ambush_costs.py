# SPDX-License-Identifier: Apache-2.0
"""Mean loss by an ambush at each place of the map, against one trip; and the best ambush."""

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

# Losses below this share of the value count as none.
_LEAST = 1e-3


class BestAmbush(NamedTuple):
    """The place (x, y) [m] of a best ambush, and the share of the departures that it hits.

    On a trip with stops, those that are hit on any leg.
    """

    xy: tuple[float, float]
    hit: float


class CostRaster(NamedTuple):
    """Mean loss (H, W) by an ambush at the dearest cell of each block of ``block`` cells a side.

    NaN where nobody can wait: in obstacles, and in the ``secured`` (H, W) area.
    """

    cost: FloatArray
    secured: BoolArray
    block: int


def holds_at_cells(trip: TripStrategy) -> bool:
    """Return whether the ambusher may wait anywhere, not only at the network's nodes."""
    return trip.game.options.widened > 0.0


def best_ambush(trip: TripStrategy, risk_map: RiskMap) -> BestAmbush | None:
    """Find the place where an ambush causes the value; None if none causes a loss."""
    game, legs = trip.game, trip.joint
    loss, row = largest_product(legs.loss, legs.entering, trip.law)
    if not trip.value > 0.0 or row < 0:
        return None
    point, entering = legs.site_points[row], legs.entering[row]
    if holds_at_cells(trip) and loss < trip.value * (1.0 - ROUNDING):
        cells = CellLosses(risk_map, game.options.ambush_in_obstacles)
        used = trip.law.uses(legs.edge_count) > 0.0
        found = CellSearch(cells, legs.games, used).worst(trip.law, loss)
        if len(found.points):
            point, entering = found.points[0], found.entering[0]
    hits = [float(leg.law.meets(own)[0]) for leg, own in zip(
        trip.legs, legs.rows_by_leg(csr_matrix(entering)), strict=True)]
    x, y = point.tolist()
    return BestAmbush((x, y), 1.0 - float(np.prod(1.0 - np.minimum(hits, 1.0))))


def cost_raster(trip: TripStrategy, risk_map: RiskMap, most: int) -> CostRaster:
    """Compute the cost of ambushes on a map, with at most ``most`` blocks along each side.

    Without a reach, an ambusher waits at the nearest node.
    """
    block = math.ceil(max(risk_map.alpha.shape) / most)
    cells = CellLosses(risk_map, trip.game.options.ambush_in_obstacles)
    dearest, loss = cells.dearest_cells(block)
    points, shape = cells.centres(dearest.reshape(-1, 2), 1), dearest.shape[:2]
    loss, secured = loss.ravel(), trip.game.secured.covers(points)
    cost = np.full(len(loss), np.nan)
    waits = np.flatnonzero((loss >= 0.0) & ~secured)
    costs = _costs_at_cells if holds_at_cells(trip) else _costs_at_nodes
    cost[waits] = costs(trip, points[waits], loss[waits])
    return CostRaster(cost.reshape(shape), secured.reshape(shape), block)


def _costs_at_cells(trip: TripStrategy, points: FloatArray, loss: FloatArray) -> FloatArray:
    """Mean losses (K,) by ambushes exactly at points (K, 2)."""
    game, legs, law = trip.game, trip.joint, trip.law
    exposed = exposed_legs(legs.games, law.uses(legs.edge_count) > 0.0)
    rows = exposed.entering(points, game.reach - game.options.widened)
    cost = loss * law.meets_at_most(rows)
    some = np.flatnonzero(cost > _LEAST * trip.value)
    cost[some] = loss[some] * law.meets(csr_matrix(rows[some]))
    return np.asarray(cost)


def _costs_at_nodes(trip: TripStrategy, points: FloatArray, _: FloatArray) -> FloatArray:
    """Mean losses (K,) by ambushes at the nodes nearest to points (K, 2)."""
    game, legs = trip.game, trip.joint
    losses = np.zeros(game.node_count)
    losses[game.sites] = legs.loss * trip.law.meets(legs.entering)
    return np.asarray(losses[cKDTree(game.network.points).query(points)[1]])
