# SPDX-License-Identifier: Apache-2.0
"""Mean loss by an ambush at each place of the map, against one strategy; and the best ambush."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..arrays import ROUNDING, BoolArray, FloatArray, IndexArray
from ..game.distribution.acyclic import is_acyclic
from ..game.distribution.chain import chain_of
from ..game.hits import hit_probabilities, worst_site
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from .cell_losses import CellLosses, CellSearch

# Losses below this share of the value count as none.
_LEAST = 1e-3


class BestAmbush(NamedTuple):
    """The place (x, y) [m] of a best ambush, and the share of the departures that it hits."""

    xy: tuple[float, float]
    hit: float


class CostRaster(NamedTuple):
    """Mean loss (H, W) by an ambush at the dearest cell of each block of ``block`` cells a side.

    NaN where nobody can wait: in obstacles, and in the ``secured`` (H, W) area.
    """

    cost: FloatArray
    secured: BoolArray
    block: int


def holds_at_cells(strategy: Strategy) -> bool:
    """Whether the ambusher may wait anywhere, not only at the network's nodes."""
    return strategy.game.options.widened > 0.0


def best_ambush(strategy: Strategy, risk_map: RiskMap) -> BestAmbush | None:
    """Find the place where an ambush causes the value; None if none causes a loss."""
    game, p = strategy.game, strategy.edge_probability
    loss, row = worst_site(game, p)
    if not strategy.value > 0.0 or row < 0:
        return None
    site = game.sites[row]
    point, hit = game.network.points[site], loss / float(game.loss[site])
    if holds_at_cells(strategy) and loss < strategy.value * (1.0 - ROUNDING):
        cells = CellLosses(risk_map, game.options.ambush_in_obstacles)
        search = CellSearch(cells, game, np.flatnonzero(p > 0.0))
        found = search.worst(chain_of(game.network, p), loss)
        if len(found.points):
            point, hit = found.points[0], float(found.mean_loss[0] / found.alpha[0])
    x, y = point.tolist()
    return BestAmbush((x, y), min(hit, 1.0))


def cost_raster(strategy: Strategy, risk_map: RiskMap, most: int) -> CostRaster:
    """Compute the cost of ambushes on a map, with at most ``most`` blocks along each side.

    Without a reach, an ambusher waits at the nearest node.
    """
    block = math.ceil(max(risk_map.alpha.shape) / most)
    hides = strategy.game.options.ambush_in_obstacles
    cells = CellLosses(risk_map, hides)
    no_place = -1.0 * (risk_map.obstacles & (not hides))
    dearest, loss = _dearest_cells(cells.of_blocks(1) + no_place, block)
    points, shape = cells.centres(dearest.reshape(-1, 2), 1), dearest.shape[:2]
    loss, secured = loss.ravel(), strategy.game.secured.covers(points)
    cost = np.full(len(loss), np.nan)
    waits = np.flatnonzero((loss >= 0.0) & ~secured)
    costs = _costs_at_cells if holds_at_cells(strategy) else _costs_at_nodes
    cost[waits] = costs(strategy, points[waits], loss[waits])
    return CostRaster(cost.reshape(shape), secured.reshape(shape), block)


def _dearest_cells(loss: FloatArray, block: int) -> tuple[IndexArray, FloatArray]:
    """Row and column (H, W, 2) of the dearest cell of each block of an array, and its loss (H, W).

    Of equally dear cells it is the one nearest to the block's centre.
    """
    padded = np.pad(loss, [(0, -size % block) for size in loss.shape], constant_values=-1.0)
    rows, columns = (size // block for size in padded.shape)
    blocks = padded.reshape(rows, block, columns, block).swapaxes(1, 2).reshape(rows, columns, -1)
    inside = np.argwhere(np.ones((block, block), bool))
    central = np.argsort(np.hypot(*(inside - (block - 1) / 2.0).T), kind='stable')
    found = central[blocks[:, :, central].argmax(axis=2)]
    corner = np.moveaxis(np.indices((rows, columns)), 0, 2) * block
    return corner + inside[found], np.take_along_axis(blocks, found[..., None], axis=2)[..., 0]


def _costs_at_cells(strategy: Strategy, points: FloatArray, loss: FloatArray) -> FloatArray:
    """Mean losses (K,) by ambushes exactly at points (K, 2)."""
    game, p = strategy.game, strategy.edge_probability
    exposed = game.exposed(np.flatnonzero(p > 0.0))
    rows = exposed.entering(points, game.reach - game.options.widened)
    if not is_acyclic(game.network, p):
        return np.asarray(loss * (rows @ p))
    chain = chain_of(game.network, p)
    cost = loss * chain.meets_at_most(rows)
    some = np.flatnonzero(cost > _LEAST * strategy.value)
    cost[some] = loss[some] * chain.meets(csr_matrix(rows[some]))
    return np.asarray(cost)


def _costs_at_nodes(strategy: Strategy, points: FloatArray, _: FloatArray) -> FloatArray:
    """Mean losses (K,) by ambushes at the nodes nearest to points (K, 2)."""
    game = strategy.game
    losses = np.zeros(game.node_count)
    losses[game.sites] = game.loss[game.sites] * hit_probabilities(game, strategy.edge_probability)
    places = game.network.representatives
    nearest = cKDTree(game.network.points[places]).query(points)[1]
    return np.asarray(losses[places[nearest]])
