# SPDX-License-Identifier: Apache-2.0
"""Ambushers anywhere on the map: how much more they can cause than those at the nodes.

With a reach, an ambush between two nodes hits other routes than one at either of them, and its cell
may have a larger loss. The search for the worst cells goes from blocks of cells to cells: the disc
around a block's centre that contains the discs of all its cells is entered at least as often as any
of them is hit. A block whose largest loss, times these entries, is not above the limit is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree

from ..arrays import ROUNDING, BoolArray, FloatArray, IndexArray, pooled
from ..game.discs import ExposedEdges
from ..game.game import Game
from ..game.hits import Law
from ..game.legs import ExposedLegs, exposed_legs
from ..game.search import FoundSites
from ..maps.occupancy import OccupancyMap, OccupancyOptions
from ..maps.risk_map import GRADES, RiskMap, cells_at, to_map_axes, to_world
from .options import parts_of_cells

# Stands for the loss at cells where nobody can wait.
NOBODY = -1.0
# A block of cells is divided into this many along each side.
_DIVISION = 4
# Maximum share of the edges that a law uses, such as that of a program's flow, for a search among
# these alone: their rows are found fast, but serve no other law.
_FEW = 0.3
# Maximum share of changed cells; beyond it losses are computed from the whole map.
_MAX_CHANGED = 0.05
# Least number of blocks whose cells are searched at once; of many, a share of those left.
_AT_ONCE = 200
_PARTS = np.indices((_DIVISION, _DIVISION)).reshape(2, -1).T


class CellLosses:
    """The loss at each cell of a map where an ambusher can wait, and the largest of each block.

    Of a map with graded losses only the grades are kept, the first of which is that of cells where
    nobody can wait.
    """

    def __init__(self, risk_map: RiskMap, in_obstacles: bool) -> None:
        graded, self._levels = risk_map.graded, np.empty(0)
        self.resolution, self._origin = risk_map.resolution, risk_map.origin
        if in_obstacles:
            losses: npt.NDArray[Any] = risk_map.nearest_free_alpha()
        elif graded and len(graded.levels) < GRADES:
            self._levels = np.append(NOBODY, graded.levels)
            losses = graded.grades + np.uint8(1)
            losses[risk_map.obstacles] = 0
        else:
            losses = np.where(risk_map.obstacles, NOBODY, risk_map.alpha)
        self._largest = {1: losses}

    def at(self, points: FloatArray) -> FloatArray:
        """The losses (K,) at positions (K, 2) [m]; 0 off the map and where nobody can wait."""
        shape = self._largest[1].shape
        uv, size = to_map_axes(self._origin, points), np.array(shape[::-1]) * self.resolution
        inside = ((uv >= 0.0) & (uv <= size)).all(axis=1)
        cells = np.stack(cells_at(uv, self.resolution, shape), axis=1)
        return np.where(inside, self.in_blocks(cells), 0.0)

    def in_blocks(self, blocks: IndexArray, side: int = 1) -> FloatArray:
        """The largest losses (K,) in blocks (K, 2) = (row, column) of ``side`` cells a side."""
        return np.maximum(self._losses(self._of_blocks(side)[tuple(blocks.T)]), 0.0)

    def dear_blocks(self, side: int) -> IndexArray:
        """The blocks (K, 2) in which an ambush may cause a loss."""
        return np.argwhere(self._of_blocks(side) > 0)

    def change(self, cells: IndexArray, alpha: FloatArray) -> None:
        """Set the losses (K,) of cells (K, 2) = (row, column); below 0 where nobody can wait."""
        graded = len(self._levels) > 0
        self._largest[1][tuple(cells.T)] = (np.searchsorted(self._levels, alpha) if graded
                                            else alpha)
        for side in sorted(self._largest)[1:]:
            finer = self._largest[side // _DIVISION]
            cells = np.unique(cells // _DIVISION, axis=0)
            parts = np.minimum(cells[:, None] * _DIVISION + _PARTS, np.array(finer.shape) - 1)
            self._largest[side][tuple(cells.T)] = finer[parts[..., 0], parts[..., 1]].max(axis=1)

    def centres(self, blocks: IndexArray, side: float) -> FloatArray:
        """Centres (K, 2) [m] of blocks (K, 2) of ``side`` cells."""
        return to_world(self._origin, (blocks[:, ::-1] + 0.5) * side * self.resolution)

    def _losses(self, found: npt.NDArray[Any]) -> FloatArray:
        return np.asarray(self._levels[found] if len(self._levels) else found)

    def _of_blocks(self, side: int) -> npt.NDArray[Any]:
        """The largest loss of each block of ``side`` x ``side`` cells, or its grade."""
        if side not in self._largest:
            finer = self._of_blocks(side // _DIVISION)
            self._largest[side] = pooled(np.maximum, finer, _DIVISION)
        return self._largest[side]

    def divided(self, blocks: IndexArray, side: int) -> IndexArray:
        """The next smaller blocks (K, 2) in blocks of ``side`` cells."""
        parts = (blocks[:, None] * _DIVISION + _PARTS).reshape(-1, 2)
        shape = np.array(self._of_blocks(side // _DIVISION).shape)
        return np.asarray(parts[(parts < shape).all(axis=1)])


class CellSearch:
    """The search for the places that cost a strategy most; it keeps the geometry that it finds.

    A site is a cell, or the centre of one of ``parts`` x ``parts`` parts of it, whose discs contain
    those of all places around it: their radius is the game's reach. ``used`` (M,) marks the edges
    of all legs that routes may use, by default all playable ones.
    """

    def __init__(self, cells: CellLosses, games: Sequence[Game],
                 used: BoolArray | None = None) -> None:
        self._cells, self._games, self._game = cells, games, games[0]
        self._used = (np.concatenate([each.playable for each in games]) if used is None else used)
        self._exposed, self._widened = exposed_legs(games, self._used), games[0].options.widened
        self._parts = parts_of_cells(cells.resolution, self._game.options)
        self._kept: dict[float, _KeptRows] = {}
        self._among_few: CellSearch | None = None
        self._returned = np.zeros(0, dtype=np.int64)  # keys of parts
        self._first = 1
        while self._first * _DIVISION * cells.resolution <= self._game.reach:
            self._first *= _DIVISION

    def on(self, cells: CellLosses) -> CellSearch:
        """Return the search with the losses of another map, of which nothing was returned yet."""
        self._cells, self._returned = cells, self._returned[:0]
        return self

    def worst(self, law: Law, above: float, apart: float = 0.0,
              among: IndexArray | None = None) -> FoundSites:
        """Places that cost drawn routes more than ``above``, the worst first.

        Of each cell only the worst part is returned that was not returned before, and none within
        ``apart`` [m] of a worse one. Without ``among`` (K, 2) all cells count.
        """
        search, used = self, law.uses(len(self._used)) > 0.0
        if used.sum() < _FEW * self._used.sum():
            if self._among_few is None or (used & ~self._among_few._used).any():
                self._among_few = CellSearch(self._cells, self._games, used)
            search = self._among_few
            search._cells, search._returned = self._cells, self._returned
        if among is None:
            parts, points, loss, losses = search._best_first(law, above, apart)
        else:
            parts, points, loss, losses = search._of_parts(search._above(among, 1, law, above)[0],
                                                           law, above, apart)
        self._returned = np.append(self._returned, _keys(parts))
        return FoundSites(points, loss, losses, self._rows(parts, 1.0 / self._parts))

    def _best_first(self, law: Law, above: float, apart: float) -> _Costly:
        """The worst parts of cells, no two within ``apart`` [m].

        The smallest blocks are searched in the order of the most that a place in them may cost: a
        place found is the next one if it costs more than that. Blocks within ``apart`` of such a
        place are left out.
        """
        side, blocks = self._first, self._cells.dear_blocks(self._first)
        while side > _DIVISION:
            blocks = self._cells.divided(self._above(blocks, side, law, above)[0], side)
            side //= _DIVISION
        blocks, most = self._above(blocks, side, law, above)
        if side == 1 or self._parts > 1 or apart == 0.0:
            if side > 1:
                blocks, _ = self._above(self._cells.divided(blocks, side), 1, law, above)
            return self._of_parts(blocks, law, above, apart)
        order, keys = np.argsort(-most, kind='stable'), _keys(blocks)
        place = np.argsort(keys)
        inner = apart - side * self._cells.resolution / math.sqrt(2.0)
        found = waiting = self._of_parts(blocks[:0], law, above, apart)
        while len(order):
            some, order = np.split(order, [max(_AT_ONCE, len(order) // 32)])
            some = some[_away(self._cells.centres(blocks[some], side), found.points, inner)]
            cells, _ = self._above(self._cells.divided(blocks[some], side), 1, law, above)
            waiting = waiting.joined(self._of_parts(cells, law, above, 0.0))
            waiting = waiting.some(_away(waiting.points, found.points, apart))
            least = (1.0 + ROUNDING) * most[order[0]] if len(order) else above
            enough = waiting.losses > least
            best = waiting.some(enough)
            block = place[np.searchsorted(keys, _keys(best.parts // side), sorter=place)]
            worst_first = np.lexsort((*(best.parts % side).T[::-1], block, -best.losses))
            found = found.joined(best.some(thinned(best.points, worst_first, apart)))
            waiting = waiting.some(~enough)
        return found

    def _above(self, blocks: IndexArray, side: int, law: Law,
               above: float) -> tuple[IndexArray, FloatArray]:
        """Blocks (K, 2) in which a place may cost more, and the most that one may cost (K,)."""
        loss = self._cells.in_blocks(blocks, side)
        some = loss * len(self._games) > above
        blocks, loss = blocks[some], loss[some]
        rows = self._rows(blocks, side)
        most = loss * law.meets_at_most(rows)
        some = most > above
        blocks, loss, most = blocks[some], loss[some], most[some]
        if side > _DIVISION or side == self._parts == 1:
            return blocks, most
        most = loss * law.meets(csr_matrix(rows[some]))
        return np.asarray(blocks[most > above]), most[most > above]

    def _of_parts(self, cells: IndexArray, law: Law, above: float, apart: float) -> _Costly:
        """The worst part of each cell (K, 2) in which one costs more than ``above``."""
        loss, n = self._cells.in_blocks(cells), self._parts
        parts, which = cells, np.arange(len(cells))
        if n > 1:
            parts = (cells[:, None] * n + np.indices((n, n)).reshape(2, -1).T).reshape(-1, 2)
            which = np.repeat(which, n * n)
        points = self._cells.centres(parts, 1.0 / n)
        out = ~self._game.secured.shrunk(self._widened).covers(points)
        parts, which, points = parts[out], which[out], points[out]
        rows = self._rows(parts, 1.0 / n)
        most = loss[which] * law.meets_at_most(rows)
        some = np.flatnonzero((most > above) & ~np.isin(_keys(parts), self._returned))
        which, parts, points = which[some], parts[some], points[some]
        losses = loss[which] * law.meets(csr_matrix(rows[some]))
        order = np.argsort(-losses, kind='stable')
        order = order[losses[order] > above]
        _, first = np.unique(which[order], return_index=True)
        found = thinned(points, order[np.sort(first)], apart)
        return _Costly(parts[found], points[found], loss[which[found]], losses[found])

    def _rows(self, blocks: IndexArray, side: float) -> csr_matrix:
        """The edges (K, M) that enter the discs of blocks (K, 2)."""
        if side not in self._kept:
            around = side * self._cells.resolution / np.sqrt(2.0)
            reach = self._game.reach - self._widened + around
            self._kept[side] = _KeptRows(self._exposed, reach)
        kept = self._kept[side]
        return kept.find(blocks, lambda some: self._cells.centres(some, side))


class _Costly(NamedTuple):
    """Parts of cells (K, 2), their positions (K, 2), losses and mean losses (K,)."""

    parts: IndexArray
    points: FloatArray
    loss: FloatArray
    losses: FloatArray

    def joined(self, others: _Costly) -> _Costly:
        """These and others."""
        return _Costly(np.concatenate((self.parts, others.parts)),
                       np.concatenate((self.points, others.points)),
                       np.append(self.loss, others.loss), np.append(self.losses, others.losses))

    def some(self, which: BoolArray | IndexArray) -> _Costly:
        """Those that ``which`` marks or numbers."""
        return _Costly(self.parts[which], self.points[which], self.loss[which],
                       self.losses[which])


def _away(points: FloatArray, places: FloatArray, distance: float) -> BoolArray:
    """Return which points (K, 2) have no place within a distance [m]."""
    if not len(places) or not len(points):
        return np.ones(len(points), dtype=bool)
    return np.asarray(cKDTree(places).query(points)[0] > distance)


def thinned(points: FloatArray, order: IndexArray, apart: float) -> IndexArray:
    """Those of the points ``order`` that are not within ``apart`` [m] of one before."""
    if apart == 0.0 or not len(order):
        return order
    kept, covered, tree = [], np.zeros(len(order), dtype=bool), cKDTree(points[order])
    for k, point in enumerate(points[order]):
        if not covered[k]:
            kept.append(order[k])
            covered[tree.query_ball_point(point, apart)] = True
    return np.array(kept)


def _keys(blocks: IndexArray) -> IndexArray:
    """A number for each of the blocks (K, 2) of one side."""
    return np.asarray((blocks[:, 0] << 32) + blocks[:, 1])


class _KeptRows:
    """Rows of edges that enter the discs around blocks of one side, found once."""

    def __init__(self, exposed: ExposedEdges | ExposedLegs, reach: float) -> None:
        self._exposed, self._reach = exposed, reach
        self._keys, self._row = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._rows: csr_matrix | None = None

    def find(self, blocks: IndexArray,
             centres: Callable[[IndexArray], FloatArray]) -> csr_matrix:
        """The rows of the blocks (K, 2)."""
        keys = _keys(blocks)
        at = np.searchsorted(self._keys, keys)
        known = at < len(self._keys)
        known[known] = self._keys[at[known]] == keys[known]
        if not known.all() or self._rows is None:
            more = self._exposed.entering(centres(blocks[~known]), self._reach)
            rows = more if self._rows is None else csr_matrix(vstack((self._rows, more)))
            first = rows.shape[0] - more.shape[0]
            row = np.append(self._row, first + np.arange(more.shape[0]))
            all_keys = np.append(self._keys, keys[~known])
            order = np.argsort(all_keys, kind='stable')
            self._rows, self._keys, self._row = rows, all_keys[order], row[order]
            at = np.searchsorted(self._keys, keys)
        return csr_matrix(self._rows[self._row[at]])


class LatestLosses:
    """The losses at the cells of the latest map: those of the one before with the changes since."""

    def __init__(self) -> None:
        self._latest: tuple[OccupancyMap, tuple[OccupancyOptions, bool], CellLosses] | None = None

    def on(self, grid: OccupancyMap, options: OccupancyOptions, in_obstacles: bool) -> CellLosses:
        """Return the losses on a map, which hold until the next call."""
        read = options, in_obstacles
        # With ambushers in obstacles, a change of one cell can change the losses of many.
        most = 0.0 if in_obstacles else _MAX_CHANGED * grid.values.size
        if self._latest is not None:
            last, read_by, losses = self._latest
            at = _changed(last, grid) if read == read_by else None
            if at is not None and len(at) <= most:
                if len(at):
                    rows, columns = np.divmod(at, grid.values.shape[1])
                    some = replace(grid, values=grid.values[rows, columns][None, :])
                    risk = some.risk_map(options)
                    losses.change(np.stack((rows, columns), axis=1),
                                  np.where(risk.obstacles, NOBODY, risk.alpha)[0])
                self._latest = grid, read, losses
                return losses
        losses = CellLosses(grid.risk_map(options), in_obstacles)
        self._latest = grid, read, losses
        return losses


def _changed(one: OccupancyMap, other: OccupancyMap) -> IndexArray | None:
    """Return the flat indices of the cells that differ; None if the maps cover other ground."""
    if (one.values.shape, one.resolution, one.origin) != (
            other.values.shape, other.resolution, other.origin):
        return None
    return np.flatnonzero(one.values.ravel() != other.values.ravel())
