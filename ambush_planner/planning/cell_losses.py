# SPDX-License-Identifier: Apache-2.0
"""Separation over the cells of a map: the sites between nodes that cost a strategy most.

With a reach, an ambush between two nodes hits other routes than one at either of them, and its cell
may have a larger loss. The search is a branch and bound from blocks of cells to cells: the disc
around a block's centre that contains the discs of all its cells is entered at least as often as
any of them is hit. A block is dropped if its largest loss times these entries is not above the
threshold.
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
# Number of parts into which a block is divided along each side.
_DIVISION = 4
# If a law uses at most this share of the edges, as that of a program's flow, the search looks at
# these alone: their rows are found fast, but serve only laws of the same edges.
_FEW = 0.3
# Maximum share of changed cells; beyond it losses are computed from the whole map.
_MAX_CHANGED = 0.05
# Least number of blocks that are searched at once.
_MIN_BATCH = 200
_PARTS = np.indices((_DIVISION, _DIVISION)).reshape(2, -1).T


class CellLosses:
    """Losses at the cells of a map, and the largest loss in each block of cells.

    Of a map with graded losses only the grades are kept; the first grade stands for cells where
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

    def losses_at(self, points: FloatArray) -> FloatArray:
        """Losses (K,) at positions (K, 2) [m]; 0 off the map and where nobody can wait."""
        shape = self._largest[1].shape
        uv, size = to_map_axes(self._origin, points), np.array(shape[::-1]) * self.resolution
        on_map = ((uv >= 0.0) & (uv <= size)).all(axis=1)
        cells = np.stack(cells_at(uv, self.resolution, shape), axis=1)
        return np.where(on_map, self.block_losses(cells), 0.0)

    def block_losses(self, blocks: IndexArray, side: int = 1) -> FloatArray:
        """Largest losses (K,) in blocks (K, 2) = (row, column) of ``side`` cells a side."""
        return np.maximum(self._losses(self._largest_in(side)[tuple(blocks.T)]), 0.0)

    def costly_blocks(self, side: int) -> IndexArray:
        """Blocks (K, 2) of ``side`` cells a side in which an ambush may cause a loss."""
        return np.argwhere(self._largest_in(side) > 0)

    def change(self, cells: IndexArray, alpha: FloatArray) -> None:
        """Set the losses (K,) of cells (K, 2) = (row, column); ``NOBODY`` where nobody can wait."""
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

    def _largest_in(self, side: int) -> npt.NDArray[Any]:
        """Largest loss of each block of ``side`` x ``side`` cells, or its grade."""
        if side not in self._largest:
            finer = self._largest_in(side // _DIVISION)
            self._largest[side] = pooled(np.maximum, finer, _DIVISION)
        return self._largest[side]

    def divide(self, blocks: IndexArray, side: int) -> IndexArray:
        """Divide blocks (K, 2) of ``side`` cells a side into the next smaller ones."""
        parts = (blocks[:, None] * _DIVISION + _PARTS).reshape(-1, 2)
        shape = np.array(self._largest_in(side // _DIVISION).shape)
        return np.asarray(parts[(parts < shape).all(axis=1)])


class CellSearch:
    """Search for violated sites at cells, which caches the edges that enter their discs.

    A site is the centre of a cell, or of one of ``parts`` x ``parts`` parts of it. It stands for
    all places around it: the radius of its disc is the game's reach, widened. ``used`` (M,) marks
    the edges of all legs that routes may use, by default all playable ones.
    """

    def __init__(self, cells: CellLosses, games: Sequence[Game],
                 used: BoolArray | None = None) -> None:
        self._cells, self._games, self._game = cells, games, games[0]
        self._used = (np.concatenate([each.playable for each in games]) if used is None else used)
        self._exposed, self._widened = exposed_legs(games, self._used), games[0].options.widened
        self._parts = parts_of_cells(cells.resolution, self._game.options)
        self._caches: dict[float, _RowCache] = {}
        self._few_edges: CellSearch | None = None
        self._returned = np.zeros(0, dtype=np.int64)  # keys of parts
        self._first = 1
        while self._first * _DIVISION * cells.resolution <= self._game.reach:
            self._first *= _DIVISION

    def with_losses(self, cells: CellLosses) -> CellSearch:
        """Start again with the losses of another map, as if no site had been returned."""
        self._cells, self._returned = cells, self._returned[:0]
        return self

    def worst(self, law: Law, threshold: float, spacing: float = 0.0,
              cells: IndexArray | None = None) -> FoundSites:
        """Find sites whose mean loss exceeds ``threshold``, the worst first.

        From each of the ``cells`` (K, 2), by default all, at most one site is returned: the worst
        that was not returned before, unless it is within ``spacing`` [m] of a worse one.
        """
        search, used = self, law.uses(len(self._used)) > 0.0
        if used.sum() < _FEW * self._used.sum():
            if self._few_edges is None or (used & ~self._few_edges._used).any():
                self._few_edges = CellSearch(self._cells, self._games, used)
            search = self._few_edges
            search._cells, search._returned = self._cells, self._returned
        if cells is None:
            found = search._best_first(law, threshold, spacing)
        else:
            found = search._worst_parts(search._violated(cells, 1, law, threshold)[0], law,
                                        threshold, spacing)
        self._returned = np.append(self._returned, _keys(found.parts))
        return FoundSites(found.points, found.loss, found.mean_loss,
                          self._rows(found.parts, 1.0 / self._parts))

    def _best_first(self, law: Law, threshold: float, spacing: float) -> _Sites:
        """Worst parts of all cells, no two within ``spacing`` [m].

        The smallest blocks are searched in the order of their upper bounds: a site is final once it
        costs more than the next bound. Blocks within ``spacing`` of such a site are dropped.
        """
        side, blocks = self._first, self._cells.costly_blocks(self._first)
        while side > _DIVISION:
            blocks = self._cells.divide(self._violated(blocks, side, law, threshold)[0], side)
            side //= _DIVISION
        blocks, bounds = self._violated(blocks, side, law, threshold)
        if side == 1 or self._parts > 1 or spacing == 0.0:
            if side > 1:
                blocks, _ = self._violated(self._cells.divide(blocks, side), 1, law, threshold)
            return self._worst_parts(blocks, law, threshold, spacing)
        order, keys = np.argsort(-bounds, kind='stable'), _keys(blocks)
        place = np.argsort(keys)
        inner = spacing - side * self._cells.resolution / math.sqrt(2.0)
        final = pending = self._worst_parts(blocks[:0], law, threshold, spacing)
        while len(order):
            batch, order = np.split(order, [max(_MIN_BATCH, len(order) // 32)])
            batch = batch[_no_place_within(inner, self._cells.centres(blocks[batch], side),
                                           final.points)]
            cells, _ = self._violated(self._cells.divide(blocks[batch], side), 1, law, threshold)
            pending = pending.append(self._worst_parts(cells, law, threshold, 0.0))
            pending = pending.subset(_no_place_within(spacing, pending.points, final.points))
            next_bound = (1.0 + ROUNDING) * bounds[order[0]] if len(order) else threshold
            certain = pending.mean_loss > next_bound
            worst = pending.subset(certain)
            block = place[np.searchsorted(keys, _keys(worst.parts // side), sorter=place)]
            worst_first = np.lexsort((*(worst.parts % side).T[::-1], block, -worst.mean_loss))
            final = final.append(worst.subset(thin_out(worst.points, worst_first, spacing)))
            pending = pending.subset(~certain)
        return final

    def _violated(self, blocks: IndexArray, side: int, law: Law,
                  threshold: float) -> tuple[IndexArray, FloatArray]:
        """Blocks (K, 2) whose mean loss may exceed the threshold, and its upper bounds (K,)."""
        loss = self._cells.block_losses(blocks, side)
        large = loss * len(self._games) > threshold
        blocks, loss = blocks[large], loss[large]
        rows = self._rows(blocks, side)
        bounds = loss * law.meets_at_most(rows)
        large = bounds > threshold
        blocks, loss, bounds = blocks[large], loss[large], bounds[large]
        if side > _DIVISION or side == self._parts == 1:
            return blocks, bounds
        bounds = loss * law.meets(csr_matrix(rows[large]))
        return np.asarray(blocks[bounds > threshold]), bounds[bounds > threshold]

    def _worst_parts(self, cells: IndexArray, law: Law, threshold: float,
                     spacing: float) -> _Sites:
        """Worst part of each cell (K, 2), if its mean loss exceeds the threshold."""
        loss, n = self._cells.block_losses(cells), self._parts
        parts, cell = cells, np.arange(len(cells))
        if n > 1:
            parts = (cells[:, None] * n + np.indices((n, n)).reshape(2, -1).T).reshape(-1, 2)
            cell = np.repeat(cell, n * n)
        points = self._cells.centres(parts, 1.0 / n)
        exposed = ~self._game.secured.shrink(self._widened).covers(points)
        parts, cell, points = parts[exposed], cell[exposed], points[exposed]
        rows = self._rows(parts, 1.0 / n)
        bounds = loss[cell] * law.meets_at_most(rows)
        large = np.flatnonzero((bounds > threshold) & ~np.isin(_keys(parts), self._returned))
        cell, parts, points = cell[large], parts[large], points[large]
        mean_loss = loss[cell] * law.meets(csr_matrix(rows[large]))
        order = np.argsort(-mean_loss, kind='stable')
        order = order[mean_loss[order] > threshold]
        _, first = np.unique(cell[order], return_index=True)
        found = thin_out(points, order[np.sort(first)], spacing)
        return _Sites(parts[found], points[found], loss[cell[found]], mean_loss[found])

    def _rows(self, blocks: IndexArray, side: float) -> csr_matrix:
        """Rows (K, M) of the edges that enter the discs of blocks (K, 2)."""
        if side not in self._caches:
            to_corner = side * self._cells.resolution / np.sqrt(2.0)
            reach = self._game.reach - self._widened + to_corner
            self._caches[side] = _RowCache(self._exposed, reach)
        return self._caches[side].find(blocks, lambda new: self._cells.centres(new, side))


class _Sites(NamedTuple):
    """Parts of cells (K, 2), their positions (K, 2) [m], losses (K,) and mean losses (K,)."""

    parts: IndexArray
    points: FloatArray
    loss: FloatArray
    mean_loss: FloatArray

    def append(self, others: _Sites) -> _Sites:
        """Return these sites, then others."""
        return _Sites(np.concatenate((self.parts, others.parts)),
                      np.concatenate((self.points, others.points)),
                      np.append(self.loss, others.loss),
                      np.append(self.mean_loss, others.mean_loss))

    def subset(self, index: BoolArray | IndexArray) -> _Sites:
        """Return the sites that ``index`` marks or numbers."""
        return _Sites(self.parts[index], self.points[index], self.loss[index],
                      self.mean_loss[index])


def _no_place_within(distance: float, points: FloatArray, places: FloatArray) -> BoolArray:
    """Return whether points (K, 2) have no place within a distance [m]."""
    if not len(places) or not len(points):
        return np.ones(len(points), dtype=bool)
    return np.asarray(cKDTree(places).query(points)[0] > distance)


def thin_out(points: FloatArray, order: IndexArray, spacing: float) -> IndexArray:
    """Drop from ``order`` the points (K, 2) that are within ``spacing`` [m] of one kept before."""
    if spacing == 0.0 or not len(order):
        return order
    kept, covered, tree = [], np.zeros(len(order), dtype=bool), cKDTree(points[order])
    for k, point in enumerate(points[order]):
        if not covered[k]:
            kept.append(order[k])
            covered[tree.query_ball_point(point, spacing)] = True
    return np.array(kept)


def _keys(blocks: IndexArray) -> IndexArray:
    """Return a number for each of the blocks (K, 2) of one side."""
    return np.asarray((blocks[:, 0] << 32) + blocks[:, 1])


class _RowCache:
    """Cache of the rows of edges that enter the discs of blocks of one side."""

    def __init__(self, exposed: ExposedEdges | ExposedLegs, reach: float) -> None:
        self._exposed, self._reach = exposed, reach
        self._keys, self._row = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._rows: csr_matrix | None = None

    def find(self, blocks: IndexArray,
             centres: Callable[[IndexArray], FloatArray]) -> csr_matrix:
        """Return the rows (K, M) of blocks (K, 2); ``centres`` gives the positions of new ones."""
        keys = _keys(blocks)
        place = np.searchsorted(self._keys, keys)
        known = place < len(self._keys)
        known[known] = self._keys[place[known]] == keys[known]
        if not known.all() or self._rows is None:
            new = self._exposed.entering(centres(blocks[~known]), self._reach)
            rows = new if self._rows is None else csr_matrix(vstack((self._rows, new)))
            first = rows.shape[0] - new.shape[0]
            row = np.append(self._row, first + np.arange(new.shape[0]))
            all_keys = np.append(self._keys, keys[~known])
            order = np.argsort(all_keys, kind='stable')
            self._rows, self._keys, self._row = rows, all_keys[order], row[order]
            place = np.searchsorted(self._keys, keys)
        return csr_matrix(self._rows[self._row[place]])


class LatestLosses:
    """The losses at the cells of the latest map, updated from map to map."""

    def __init__(self) -> None:
        self._latest: tuple[OccupancyMap, tuple[OccupancyOptions, bool], CellLosses] | None = None

    def update(self, grid: OccupancyMap, options: OccupancyOptions,
               in_obstacles: bool) -> CellLosses:
        """Return the losses on a map; the next call changes them."""
        reading = options, in_obstacles
        # With ambushers in obstacles, a change of one cell can change the losses of many.
        max_changed = 0.0 if in_obstacles else _MAX_CHANGED * grid.values.size
        if self._latest is not None:
            previous, previous_reading, losses = self._latest
            same_ground = (previous.values.shape, previous.resolution, previous.origin) == (
                grid.values.shape, grid.resolution, grid.origin)
            changed = np.flatnonzero(previous.values.ravel() != grid.values.ravel()) if (
                reading == previous_reading and same_ground) else None
            if changed is not None and len(changed) <= max_changed:
                if len(changed):
                    rows, columns = np.divmod(changed, grid.values.shape[1])
                    cells = replace(grid, values=grid.values[rows, columns][None, :])
                    risk = cells.risk_map(options)
                    losses.change(np.stack((rows, columns), axis=1),
                                  np.where(risk.obstacles, NOBODY, risk.alpha)[0])
                self._latest = grid, reading, losses
                return losses
        losses = CellLosses(grid.risk_map(options), in_obstacles)
        self._latest = grid, reading, losses
        return losses
