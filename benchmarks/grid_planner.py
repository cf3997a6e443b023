"""The peer of ``routes.py``: A* on the map's cells with any-angle post-processing."""

from __future__ import annotations

import heapq

import numpy as np
from scenarios import Scenario

from ambush_planner.arrays import FloatArray
from ambush_planner.maps.obstacles import ObstacleField

STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)]


def shortest_line(scenario: Scenario) -> FloatArray:
    """Corners (K, 2) [m] of the path that a grid planner finds from start to goal."""
    risk_map = scenario.risk_map
    start, goal = (tuple(int(c) for c in np.ravel(risk_map.cells(np.array(end))))
                   for end in (scenario.start, scenario.goal))
    cells = a_star(~risk_map.obstacles, start, goal)
    line = (np.array(cells)[:, ::-1] + 0.5) * risk_map.resolution
    line[0], line[-1] = scenario.start, scenario.goal
    field = ObstacleField(risk_map)
    while True:
        shorter = _pulled(field, _pulled(field, line)[::-1])[::-1]
        if _length(shorter) > _length(line) * (1.0 - 1e-6):
            return shorter
        line = _split(shorter, risk_map.resolution)


def a_star(
    free: np.ndarray, start: tuple[int, int], goal: tuple[int, int]
) -> list[tuple[int, int]]:
    """Cells of a shortest 8-connected path that cuts no corners (octile lengths)."""
    rows, columns = free.shape

    def lower_bound(cell: tuple[int, int]) -> float:
        down, right = abs(cell[0] - goal[0]), abs(cell[1] - goal[1])
        return max(down, right) + (2**0.5 - 1) * min(down, right)

    queue, gone, before = [(lower_bound(start), 0.0, start)], {start: 0.0}, {start: start}
    while queue:
        _, length, (row, column) = heapq.heappop(queue)
        if (row, column) == goal:
            break
        if length > gone[row, column]:
            continue
        for down, right in STEPS:
            r, c = row + down, column + right
            if not (0 <= r < rows and 0 <= c < columns and free[r, c]):
                continue
            if not (free[row, c] and free[r, column]):
                continue
            new = length + (2**0.5 if down and right else 1.0)
            if new < gone.get((r, c), np.inf):
                gone[r, c], before[r, c] = new, (row, column)
                heapq.heappush(queue, (new + lower_bound((r, c)), new, (r, c)))
    cells = [goal]
    while cells[-1] != start:
        cells.append(before[cells[-1]])
    return cells[::-1]


def _pulled(field: ObstacleField, line: FloatArray) -> FloatArray:
    """Skip the corners between two with a clear line between them, the furthest first."""
    kept, at = [0], 0
    while at < len(line) - 1:
        ahead = np.arange(at + 1, len(line))
        sees = field.clear_segments(np.repeat(line[at : at + 1], len(ahead), 0), line[ahead], 0.0)
        at = int(ahead[sees].max(initial=at + 1))
        kept.append(at)
    return line[kept]


def _split(line: FloatArray, step: float) -> FloatArray:
    """Add points at most ``step`` apart along a line, so that corners can move."""
    parts = []
    for a, b in zip(line[:-1], line[1:], strict=True):
        count = max(int(np.ceil(np.hypot(*(b - a)) / step)), 1)
        parts.append(a + (b - a) * np.arange(count)[:, None] / count)
    return np.concatenate([*parts, line[-1:]])


def _length(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())
