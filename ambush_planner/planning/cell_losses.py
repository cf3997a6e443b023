"""Ambushers at any cell of the map: how much more they can cause than those at the nodes.

With a reach, an ambush between two nodes hits other routes than one at either of them, and its cell
may have a larger loss. The search for the worst cells goes from blocks of cells to cells: the disc
around a block's centre that contains the discs of all its cells is entered at least as often as any
of them is hit. A block whose largest loss, times these entries, is not above the limit is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.discs import ExposedEdges, near_ends
from ..game.game import Game
from ..game.hits import RouteHits
from ..maps.occupancy import OccupancyMap, OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap, to_map_axes, to_world

# A block of cells is divided into this many along each side.
_DIVISION = 4
# If more than this share of the cells has changed, their losses are computed from the whole map.
_MOST_CHANGED = 0.05
_PARTS = np.indices((_DIVISION, _DIVISION)).reshape(2, -1).T
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
        self._resolution, self._origin = risk_map.resolution, risk_map.origin
        self._largest = {1: risk_map.nearest_free_alpha() if in_obstacles else alpha}

    def at(self, points: FloatArray) -> FloatArray:
        """The losses (K,) at positions (K, 2) [m]; 0 off the map and where nobody can wait."""
        loss = self._largest[1]
        uv, shape = to_map_axes(self._origin, points) / self._resolution, loss.shape[::-1]
        inside = ((uv >= 0.0) & (uv <= shape)).all(axis=1)
        column, row = np.clip(np.floor(uv).astype(np.int64), 0, np.array(shape) - 1).T
        return np.where(inside, loss[row, column], 0.0)

    def in_cells(self, cells: IndexArray) -> FloatArray:
        """The losses (K,) at cells (K, 2) = (row, column)."""
        return np.asarray(self._largest[1][tuple(cells.T)])

    def change(self, cells: IndexArray, alpha: FloatArray) -> None:
        """Set the losses (K,) of some cells (K, 2) = (row, column)."""
        self._largest[1][tuple(cells.T)] = alpha
        for side in sorted(self._largest)[1:]:
            finer = self._largest[side // _DIVISION]
            cells = np.unique(cells // _DIVISION, axis=0)
            parts = np.minimum(cells[:, None] * _DIVISION + _PARTS, np.array(finer.shape) - 1)
            self._largest[side][tuple(cells.T)] = finer[parts[..., 0], parts[..., 1]].max(axis=1)

    def worst(self, game: Game, p: FloatArray, above: float, apart: float,
              among: IndexArray | None = None) -> Places:
        """Cells that cost an acyclic strategy p (M,) more than ``above``, the worst first.

        The first one is the worst of all cells. Of each square of side ``apart`` [m], at most one
        cell is returned, the one with the largest bound. Without ``among`` (K, 2) all cells count.
        """
        used = game.exposed(np.flatnonzero(p > 0.0))
        side = 1
        while among is None and side * _DIVISION * self._resolution <= game.reach:
            side *= _DIVISION
        losses = self._loss_of_blocks(side)
        blocks = np.argwhere(losses > above) if among is None else among[
            losses[tuple(among.T)] > above]
        bound = self._bounds(game, used, p, blocks, side)
        while side > 1:
            blocks = self._divided(blocks[bound > above], side)
            side //= _DIVISION
            bound = self._bounds(game, used, p, blocks, side)
        points = self._centres(blocks, 1)
        bound[near_ends(game.network, game.options.held_radius, points)] = 0.0
        order = np.argsort(-bound, kind='stable')[: np.count_nonzero(bound > above)]
        routes = RouteHits(game.network, p)

        def hit(points: FloatArray) -> FloatArray:
            return routes.probability(used.entering(points, game.reach))

        return self._exact(hit, blocks[order], bound[order], above, apart)

    def _exact(self, hit: Callable[[FloatArray], FloatArray], cells: IndexArray, bound: FloatArray,
               above: float, apart: float) -> Places:
        """Mean losses, each route counted once, of cells (K, 2) ordered by their bounds (K,)."""
        points, alpha = self._centres(cells, 1), self._loss_of_blocks(1)[tuple(cells.T)]
        if not len(cells):
            return Places(points, alpha, np.zeros(0))
        losses = np.zeros(len(cells))
        squares = np.floor(cells * self._resolution / apart).astype(np.int64)
        _, first = np.unique(squares, axis=0, return_index=True)
        chosen = np.sort(first)
        losses[chosen] = alpha[chosen] * hit(points[chosen])
        done, best = 0, max(above, losses.max(initial=0.0))
        while done < len(cells) and bound[done] > best:
            rows = np.arange(done, min(done + _AT_ONCE, len(cells)))
            losses[rows] = alpha[rows] * hit(points[rows])
            done, best = done + _AT_ONCE, max(best, losses[rows].max())
        found = np.union1d(chosen, np.argmax(losses)) if len(cells) else chosen
        found = found[losses[found] > above]
        found = found[np.argsort(-losses[found], kind='stable')]
        return Places(points[found], alpha[found], losses[found])

    def _bounds(self, game: Game, used: ExposedEdges, p: FloatArray, blocks: IndexArray,
                side: int) -> FloatArray:
        """Upper bounds (K,) of the mean losses at all cells of the blocks (K, 2)."""
        reach = game.reach + (side - 1) * self._resolution / np.sqrt(2.0)
        entries = used.entering(self._centres(blocks, side), reach) @ p
        return np.asarray(self._loss_of_blocks(side)[tuple(blocks.T)] * np.minimum(entries, 1.0))

    def _centres(self, blocks: IndexArray, side: int) -> FloatArray:
        return to_world(self._origin, (blocks[:, ::-1] + 0.5) * side * self._resolution)

    def _loss_of_blocks(self, side: int) -> FloatArray:
        """The largest loss of each block of ``side`` x ``side`` cells."""
        if side not in self._largest:
            finer = self._loss_of_blocks(side // _DIVISION)
            margins = [(0, -size % _DIVISION) for size in finer.shape]
            padded = np.pad(finer, margins) if np.any(margins) else finer
            # By whole rows, then columns: ten times as fast as a maximum over two axes.
            rows = reduce(np.maximum, [padded[k::_DIVISION] for k in range(_DIVISION)])
            self._largest[side] = reduce(np.maximum,
                                         [rows[:, k::_DIVISION] for k in range(_DIVISION)])
        return self._largest[side]

    def _divided(self, blocks: IndexArray, side: int) -> IndexArray:
        """The parts (K, 2) of blocks of ``side`` cells."""
        parts = (blocks[:, None] * _DIVISION + _PARTS).reshape(-1, 2)
        shape = np.array(self._loss_of_blocks(side // _DIVISION).shape)
        return np.asarray(parts[(parts < shape).all(axis=1)])


class LatestLosses:
    """The losses at the cells of the latest map: those of the one before with the changes since."""

    def __init__(self) -> None:
        self._latest: tuple[OccupancyMap, tuple[OccupancyOptions, bool], CellLosses] | None = None

    def on(self, grid: OccupancyMap, options: OccupancyOptions, in_obstacles: bool) -> CellLosses:
        """Return the losses on a map, which hold until the next call."""
        read = options, in_obstacles
        # With ambushers in obstacles, a change of one cell can change the losses of many.
        most = 0.0 if in_obstacles else _MOST_CHANGED * grid.values.size
        if self._latest is not None:
            last, read_by, losses = self._latest
            at = _changed(last, grid) if read == read_by else None
            if at is not None and len(at) <= most:
                if len(at):
                    rows, columns = np.divmod(at, grid.values.shape[1])
                    some = replace(grid, values=grid.values[rows, columns][None, :])
                    risk = _risk(some, options)
                    losses.change(np.stack((rows, columns), axis=1),
                                  np.where(risk.obstacles, 0.0, risk.alpha)[0])
                self._latest = grid, read, losses
                return losses
        losses = CellLosses(_risk(grid, options), in_obstacles)
        self._latest = grid, read, losses
        return losses


def _risk(grid: OccupancyMap, options: OccupancyOptions) -> RiskMap:
    return risk_map_from_occupancy(grid.values, grid.resolution, grid.origin, options)


def _changed(one: OccupancyMap, other: OccupancyMap) -> IndexArray | None:
    """Return the flat indices of the cells that differ; None if the maps cover other ground."""
    if (one.values.shape, one.resolution, one.origin) != (
            other.values.shape, other.resolution, other.origin):
        return None
    return np.flatnonzero(one.values.ravel() != other.values.ravel())
