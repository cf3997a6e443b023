# SPDX-License-Identifier: Apache-2.0
"""Exact clearance checks of points and segments against obstacle cells."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray, IndexArray, members
from .risk_map import TOUCH, RiskMap

# Number of (segment, cell) pairs tested at once; bounds the memory.
CHUNK = 1_000_000
# Longest segment tested in one piece [cells]: its bounding box grows with the square of this.
PIECE = 8.0
# Number of pieces from which on points on a segment are tested before the pieces.
POINTS = 32


class CellCounts:
    """Counts of the marked cells (H, W) in boxes, by a summed-area table."""

    def __init__(self, marked: BoolArray) -> None:
        counts = marked.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        self._sums = np.pad(counts, ((1, 0), (1, 0)))

    def within(self, rows: tuple[IndexArray, IndexArray],
               columns: tuple[IndexArray, IndexArray]) -> npt.NDArray[np.int32]:
        """Count in boxes from the first of their rows and columns to before the second ones."""
        (low, high), (left, right), sums = rows, columns, self._sums
        return np.asarray(sums[high, right] - sums[low, right] - sums[high, left]
                          + sums[low, left])


class ObstacleField:
    """Obstacle cells of a risk map, prepared for many clearance queries in map axes [m].

    The map's outer edge and everything beyond it are never clear. With ``clear_of_edge`` the
    clearance also applies to that edge.
    """

    def __init__(self, risk_map: RiskMap, clear_of_edge: bool = True) -> None:
        self._size, self._resolution = risk_map.size, risk_map.resolution
        self._obstacles = risk_map.obstacles
        self.clear_of_edge = clear_of_edge
        blocks, self._block = risk_map.obstacle_blocks
        self._counts = CellCounts(blocks)

    def clear_points(self, uv: FloatArray, clearance: float) -> BoolArray:
        """Return which points (K, 2) have no obstacle cell within ``clearance`` [m]."""
        return self.clear_segments(uv, uv, clearance)

    def clear_segments(self, a: FloatArray, b: FloatArray, clearance: float) -> BoolArray:
        """Return which segments a -> b, both (K, 2), have no obstacle cell within ``clearance``.

        A segment is blocked if its distance to a closed obstacle cell is at most ``clearance``,
        exact to within ``TOUCH``.
        """
        clear = self._on_map(a, clearance) & self._on_map(b, clearance)
        inside = np.flatnonzero(clear)
        a, b = a[inside] / self._resolution, b[inside] / self._resolution
        count = np.maximum(np.ceil(np.hypot(*(b - a).T) / PIECE), 1.0).astype(np.int64)
        clear[inside] = ~self._blocked_at_points(a, b, count)
        some = np.flatnonzero(clear[inside])
        for part in np.array_split(some, int(count[some].sum()) // CHUNK + 1):
            segment, begin, end = _pieces(a[part], b[part], count[part])
            blocked = self._blocked(begin, end, clearance / self._resolution)
            clear[inside[part[segment[blocked]]]] = False
        return clear

    def _blocked_at_points(self, a: FloatArray, b: FloatArray, count: IndexArray) -> BoolArray:
        """Return which segments of more than ``POINTS`` pieces have one of as many points blocked.

        On rough ground that finds nearly all long segments that are blocked.
        """
        blocked, left = np.zeros(len(a), dtype=bool), np.flatnonzero(count > POINTS)
        for share in np.arange(1, POINTS) / POINTS if len(left) else ():
            column, row = self._cell(a[left] + share * (b[left] - a[left])).T
            blocked[left[self._obstacles[row, column]]] = True
            left = left[~blocked[left]]
        return blocked

    def _on_map(self, uv: FloatArray, clearance: float) -> BoolArray:
        """Return which points (K, 2) lie on the map, if asked with the clearance from its edge."""
        margin = TOUCH * self._resolution + (clearance if self.clear_of_edge else 0.0)
        return np.asarray(((uv > margin) & (uv < np.array(self._size) - margin)).all(axis=1))

    def _blocked(self, a: FloatArray, b: FloatArray, reach: float) -> BoolArray:
        """Return which segments meet an obstacle cell or come within ``reach`` of one [cells]."""
        low = self._cell(np.minimum(a, b) - reach - TOUCH)
        high = self._cell(np.maximum(a, b) + reach + TOUCH)
        middle = self._cell((a + b) / 2)
        blocked = self._obstacles[middle[:, 1], middle[:, 0]]  # finds most blocked ones cheaply
        columns, rows = zip(low.T // self._block, high.T // self._block + 1, strict=True)
        near = np.flatnonzero(~blocked & (self._counts.within(rows, columns) > 0))
        blocked[near] = self._hits(a[near], b[near], low[near], high[near], reach)
        return blocked

    def _cell(self, uv: FloatArray) -> IndexArray:
        rows, columns = self._obstacles.shape
        return np.clip(np.floor(uv), 0, (columns - 1, rows - 1)).astype(np.int64)

    def _hits(self, a: FloatArray, b: FloatArray, low: IndexArray, high: IndexArray,
              reach: float) -> BoolArray:
        """Test each segment against every obstacle cell of its box, in chunks."""
        hit = np.zeros(len(a), dtype=bool)
        sizes = np.prod(high - low + 1, axis=1)
        step = max(CHUNK // int(sizes.max(initial=1)), 1)
        for start in range(0, len(a), step):
            part = slice(start, start + step)
            segment, place = members(sizes[part])
            width = (high - low + 1)[part, 0][segment]
            column = low[part, 0][segment] + place % width
            row = low[part, 1][segment] + place // width
            blocked = self._obstacles[row, column]
            segment, cell = segment[blocked], np.stack((column[blocked], row[blocked]), axis=1)
            hit[start + segment[_touch(a[part][segment], b[part][segment], cell, reach)]] = True
        return hit


def _pieces(a: FloatArray, b: FloatArray,
            count: IndexArray) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Cut segments (K, 2) into ``count`` (K,) pieces: (segment, from, to) of each."""
    segment, place = members(count)
    step = ((b - a) / count[:, None])[segment]
    start = a[segment] + step * place[:, None]
    return segment, start, start + step


def _touch(a: FloatArray, b: FloatArray, cell: IndexArray, reach: float) -> BoolArray:
    """Return which segments come within ``reach`` of their closed cell [cells]."""
    centre = cell + 0.5
    hit = _cross(a - centre, b - centre)
    if reach > 0.0:
        far = np.flatnonzero(~hit)
        gap = _distance(a[far] - centre[far], b[far] - centre[far])
        hit[far[gap <= reach + TOUCH]] = True
    return hit


def _cross(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return which segments meet the closed unit square around 0, by separating axes."""
    middle, half = (a + b) / 2, np.abs(b - a) / 2
    apart = (np.abs(middle) > 0.5 + half + TOUCH).any(axis=1)
    across = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    span = 0.5 * half.sum(axis=1) + TOUCH * (np.hypot(*half.T) + TOUCH)
    meets: BoolArray = ~apart & (across <= span)
    return meets


def _distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance from segments a -> b to the unit square around 0, which they do not meet."""
    ends = np.stack((a, b))
    best = np.hypot(*np.maximum(np.abs(ends) - 0.5, 0.0).T).min(axis=1)
    for corner in np.array([(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)]):
        best = np.minimum(best, np.hypot(*(nearest_on_segments(corner, a, b) - corner).T))
    return best


def nearest_on_segments(point: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the nearest point (K, 2) of each segment a -> b to one (2,) or its own (K, 2)."""
    along = b - a
    squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(((point - a) * along).sum(axis=1) / squared, 0.0, 1.0)
    return np.asarray(a + share[:, None] * along)


def nearest_free_cell(risk_map: RiskMap, xy: tuple[float, float], tolerance: float,
                      clearance: float, clear_of_edge: bool = True) -> tuple[float, float]:
    """Return ``xy`` if it is clear, else the centre of the nearest clear cell [m].

    Returns ``xy`` unchanged if no clear cell lies within ``tolerance`` [m], or if it is off the
    map.
    """
    if tolerance == 0.0:
        return xy
    uv = risk_map.to_map_axes(xy)
    field = ObstacleField(risk_map, clear_of_edge)
    if not risk_map.contains(uv) or field.clear_points(uv[None], clearance)[0]:
        return xy
    centres = _cell_centres(risk_map, uv, tolerance)
    distance = np.hypot(*(centres - uv).T)
    near = np.argsort(distance, kind='stable')[: int((distance <= tolerance).sum())]
    free = near[field.clear_points(centres[near], clearance)]
    if len(free) == 0:
        return xy
    x, y = risk_map.to_world(centres[free[0]]).tolist()
    return x, y


def _cell_centres(risk_map: RiskMap, uv: FloatArray, reach: float) -> FloatArray:
    """Centres (K, 2) in map axes of the free cells in the square within ``reach`` of ``uv``."""
    size = risk_map.size
    low_row, low_column = risk_map.cells(np.clip(uv - reach, 0.0, size))
    high_row, high_column = risk_map.cells(np.clip(uv + reach, 0.0, size))
    part = risk_map.obstacles[low_row:high_row + 1, low_column:high_column + 1]
    rows, columns = np.nonzero(~part)
    cells = np.stack((columns + low_column, rows + low_row), axis=1)
    return (cells + 0.5) * risk_map.resolution
