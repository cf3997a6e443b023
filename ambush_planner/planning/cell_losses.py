"""Ambushers at any cell of the map: how much more they can cause than those at the nodes.

With a reach, an ambush between two nodes hits other routes than one at either of them, and its cell
may have a larger loss. The search for the worst cells goes from blocks of cells to cells: the disc
around a block's centre that contains the discs of all its cells is entered at least as often as any
of them is hit. A block whose largest loss, times these entries, is not above the limit is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.discs import near_ends
from ..game.game import Game
from ..game.hits import RouteHits
from ..maps.risk_map import RiskMap

# A block of cells is divided into this many along each side.
_DIVISION = 4
# Cells whose hits are computed together.
_AT_ONCE = 64


class Places(NamedTuple):
    """Places where an ambusher can wait: positions (K, 2) [m], losses (K,), mean losses (K,)."""

    points: FloatArray
    alpha: FloatArray
    mean_loss: FloatArray


class CellLosses:
    """The loss at each cell of a map where an ambusher can wait, and the largest of each block."""

    def __init__(self, risk_map: RiskMap, in_obstacles: bool) -> None:
        alpha = np.where(risk_map.obstacles, 0.0, risk_map.alpha)
        self._map = risk_map
        self._largest = {1: risk_map.nearest_free_alpha() if in_obstacles else alpha}

    def at(self, points: FloatArray) -> FloatArray:
        """The losses (K,) at positions (K, 2) [m]; 0 off the map and where nobody can wait."""
        uv = self._map.to_map_axes(points)
        return np.where(self._map.contains(uv), self._loss_of_blocks(1)[self._map.cells(uv)], 0.0)

    def worst(self, game: Game, p: FloatArray, above: float, apart: float) -> Places:
        """Cells that cost an acyclic strategy p (M,) more than ``above``, the worst first.

        The first one is the worst of all cells. Of each square of side ``apart`` [m], at most one
        cell is returned, the one with the largest bound.
        """
        side = 1
        while side * _DIVISION * self._map.resolution <= game.reach:
            side *= _DIVISION
        blocks = np.argwhere(self._loss_of_blocks(side) > above)
        bound = self._entries(game, p, blocks, side)
        while side > 1:
            blocks = self._divided(blocks[bound > above], side)
            side //= _DIVISION
            bound = self._entries(game, p, blocks, side)
        points = self._centres(blocks, 1)
        bound[near_ends(game.network, game.options.held_radius, points)] = 0.0
        order = np.argsort(-bound, kind='stable')[: np.count_nonzero(bound > above)]
        return self._exact(game, p, blocks[order], bound[order], above, apart)

    def _exact(self, game: Game, p: FloatArray, cells: IndexArray, bound: FloatArray,
               above: float, apart: float) -> Places:
        """Mean losses, each route counted once, of cells (K, 2) ordered by their bounds (K,)."""
        points, alpha = self._centres(cells, 1), self._loss_of_blocks(1)[tuple(cells.T)]
        used = np.flatnonzero(p > 0.0)
        hits, losses = RouteHits(game.network, p), np.zeros(len(cells))
        squares = np.floor(cells * self._map.resolution / apart).astype(np.int64)
        _, first = np.unique(squares, axis=0, return_index=True)
        chosen = np.sort(first)
        losses[chosen] = alpha[chosen] * hits.probability(game.hits_from(points[chosen], used))
        done, best = 0, max(above, losses.max(initial=0.0))
        while done < len(cells) and bound[done] > best:
            rows = np.arange(done, min(done + _AT_ONCE, len(cells)))
            losses[rows] = alpha[rows] * hits.probability(game.hits_from(points[rows], used))
            done, best = done + _AT_ONCE, max(best, losses[rows].max())
        found = np.union1d(chosen, np.argmax(losses)) if len(cells) else chosen
        found = found[losses[found] > above]
        found = found[np.argsort(-losses[found], kind='stable')]
        return Places(points[found], alpha[found], losses[found])

    def _entries(self, game: Game, p: FloatArray, blocks: IndexArray, side: int) -> FloatArray:
        """Upper bounds (K,) of the mean losses at all cells of the blocks (K, 2)."""
        used = np.flatnonzero(p > 0.0)
        wider = (side - 1) * self._map.resolution / np.sqrt(2.0)
        rows = game.hits_from(self._centres(blocks, side), used, wider)
        hit = np.minimum(rows @ p, 1.0)
        return np.asarray(self._loss_of_blocks(side)[tuple(blocks.T)] * hit)

    def _centres(self, blocks: IndexArray, side: int) -> FloatArray:
        return self._map.to_world((blocks[:, ::-1] + 0.5) * side * self._map.resolution)

    def _loss_of_blocks(self, side: int) -> FloatArray:
        """The largest loss of each block of ``side`` x ``side`` cells."""
        if side not in self._largest:
            finer = self._loss_of_blocks(side // _DIVISION)
            rows, columns = (-(-size // _DIVISION) * _DIVISION for size in finer.shape)
            padded = np.zeros((rows, columns))
            padded[: finer.shape[0], : finer.shape[1]] = finer
            parts = padded.reshape(rows // _DIVISION, _DIVISION, columns // _DIVISION, _DIVISION)
            self._largest[side] = parts.max(axis=(1, 3))
        return self._largest[side]

    def _divided(self, blocks: IndexArray, side: int) -> IndexArray:
        """The parts (K, 2) of blocks of ``side`` cells."""
        steps = np.indices((_DIVISION, _DIVISION)).reshape(2, -1).T
        parts = (blocks[:, None] * _DIVISION + steps).reshape(-1, 2)
        shape = np.array(self._loss_of_blocks(side // _DIVISION).shape)
        return np.asarray(parts[(parts < shape).all(axis=1)])
