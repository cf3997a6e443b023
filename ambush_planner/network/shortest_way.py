# SPDX-License-Identifier: Apache-2.0
"""The length of the shortest way over the ground, whatever mesh its routes are on.

It is that of a taut string around the obstacles, times what the shortest routes on a lattice are
longer than such a string: so ``max_detour`` leaves the same room on every network.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from .shortest_paths import shortest_path

# Lengths of shortest routes on a lattice, as multiples of taut strings: 1.05 in the median of 24
# maps and directions, 1.025 to 1.09 in all.
ON_LATTICE = 1.05
# Points on the string, rounds of pulling at most, and the relative gain of one that ends them.
POINTS, ROUNDS, GAIN = 120, 12, 2e-4


class GroundLengths:
    """Lengths [m] of the shortest ways between nodes ``uv`` (N, 2), joined by edges (E, 2)."""

    def __init__(self, field: ObstacleField, clearance: float, uv: FloatArray,
                 edges: IndexArray) -> None:
        self._field, self._clearance, self._uv, self._edges = field, clearance, uv, edges
        self._known: dict[tuple[int, int], float] = {}

    def between(self, one: int, other: int) -> float:
        """Length of the way from one node to another; inf if there is none."""
        pair = min(one, other), max(one, other)
        if one == other:
            return 0.0
        if pair not in self._known:
            lengths = np.hypot(*(self._uv[self._edges[:, 1]] - self._uv[self._edges[:, 0]]).T)
            nodes = shortest_path(self._edges, lengths, len(self._uv), *pair)
            self._known[pair] = ON_LATTICE * taut_length(
                self._field, self._uv[nodes], self._clearance) if len(nodes) else math.inf
        return self._known[pair]


def taut_length(field: ObstacleField, way: FloatArray, clearance: float) -> float:
    """Length [m] of a clear way (K, 2) in map axes, pulled taut around the obstacles.

    In each round, points are spread evenly over the way; the shortest chain of clear straight
    pieces from point to point is the next way.
    """
    length = _length(way)
    for _ in range(ROUNDS):
        way = _pulled(field, _spread(way), clearance)
        before, length = length, min(_length(way), length)
        if length > before * (1.0 - GAIN):
            break
    return length


def _spread(way: FloatArray) -> FloatArray:
    """The corners of a way and points between them, about ``POINTS`` in all."""
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
    places = np.union1d(travelled, np.linspace(0.0, travelled[-1], POINTS))
    return np.stack([np.interp(places, travelled, way[:, k]) for k in (0, 1)], axis=1)


def _pulled(field: ObstacleField, points: FloatArray, clearance: float) -> FloatArray:
    """The shortest chain of clear straight pieces between points of a way."""
    count = len(points)
    tail, head = np.triu_indices(count, 1)
    clear = field.clear_segments(points[tail], points[head], clearance) | (head == tail + 1)
    tail, head = tail[clear], head[clear]
    cost = np.hypot(*(points[head] - points[tail]).T)
    first = np.searchsorted(tail, np.arange(count + 1))
    cost_to_goal, following = np.zeros(count), np.zeros(count, dtype=np.int64)
    for k in range(count - 2, -1, -1):
        some = slice(first[k], first[k + 1])
        ways = cost[some] + cost_to_goal[head[some]]
        best = int(ways.argmin())
        cost_to_goal[k], following[k] = ways[best], head[some][best]
    chain = [0]
    while chain[-1] < count - 1:
        chain.append(int(following[chain[-1]]))
    return points[chain]


def _length(way: FloatArray) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum())
