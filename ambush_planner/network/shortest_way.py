# SPDX-License-Identifier: Apache-2.0
"""The length of the shortest way over the ground, which does not depend on the mesh.

It is the length of a taut string around the obstacles, times the typical ratio of the shortest
route on a lattice to such a string. So ``max_detour`` leaves the same room on every network.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..maps.obstacles import ObstacleField
from .shortest_paths import shortest_path

# Length of the shortest route on a lattice over that of the taut string: the median of 24 maps and
# directions, in which it is 1.025 to 1.09.
LATTICE_RATIO = 1.05
# Points on the string, the most rounds of pulling, and the relative gain below which they end.
POINTS, ROUNDS, MIN_GAIN = 120, 12, 2e-4


class GroundLengths:
    """Lengths over the ground [m] between nodes ``uv`` (N, 2) that edges (E, 2) join.

    Nodes are numbered -1, -2, ... from the last one.
    """

    def __init__(self, field: ObstacleField, clearance: float, uv: FloatArray,
                 edges: IndexArray) -> None:
        self._field, self._clearance, self._uv, self._edges = field, clearance, uv, edges
        self._known: dict[tuple[int, int], float] = {}

    def between(self, one: int, other: int) -> float:
        """Length of the shortest way from one node to another; inf if there is none."""
        pair = min(one, other), max(one, other)
        if one == other:
            return 0.0
        if pair not in self._known:
            nodes = self.way(*pair)
            self._known[pair] = LATTICE_RATIO * taut_length(
                self._field, self._uv[nodes], self._clearance) if len(nodes) else math.inf
        return self._known[pair]

    def way(self, one: int, other: int) -> IndexArray:
        """Nodes (K,), from 0 on, of the shortest way on the edges; none if there is none."""
        lengths = np.hypot(*(self._uv[self._edges[:, 1]] - self._uv[self._edges[:, 0]]).T)
        count = len(self._uv)
        return shortest_path(self._edges, lengths, count, one % count, other % count)


def taut_length(field: ObstacleField, way: FloatArray, clearance: float) -> float:
    """Length [m] of a clear way (K, 2) in map axes after it is pulled taut around the obstacles.

    In each round, about ``POINTS`` points are spread evenly over the way, between its corners; the
    shortest chain of clear straight pieces between points is the next way.
    """
    length = _length(way)
    for _ in range(ROUNDS):
        travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
        places = np.union1d(travelled, np.linspace(0.0, travelled[-1], POINTS))
        points = np.stack([np.interp(places, travelled, way[:, k]) for k in (0, 1)], axis=1)
        way = _shortest_chain(field, points, clearance)
        previous, length = length, min(_length(way), length)
        if length > previous * (1.0 - MIN_GAIN):
            break
    return length


def _shortest_chain(field: ObstacleField, points: FloatArray, clearance: float) -> FloatArray:
    """Shortest chain (L, 2) of clear straight pieces between points (K, 2) of a way."""
    count = len(points)
    tail, head = np.triu_indices(count, 1)
    clear = field.clear_segments(points[tail], points[head], clearance) | (head == tail + 1)
    tail, head = tail[clear], head[clear]
    cost = np.hypot(*(points[head] - points[tail]).T)
    first = np.searchsorted(tail, np.arange(count + 1))
    cost_to_goal, following = np.zeros(count), np.zeros(count, dtype=np.int64)
    for k in range(count - 2, -1, -1):
        leaving = slice(first[k], first[k + 1])
        ways = cost[leaving] + cost_to_goal[head[leaving]]
        best = int(ways.argmin())
        cost_to_goal[k], following[k] = ways[best], head[leaving][best]
    chain = [0]
    while chain[-1] < count - 1:
        chain.append(int(following[chain[-1]]))
    return points[chain]


def _length(way: FloatArray) -> float:
    return float(np.hypot(*np.diff(way, axis=0).T).sum())
