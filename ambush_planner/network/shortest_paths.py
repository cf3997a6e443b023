# SPDX-License-Identifier: Apache-2.0
"""Shortest paths and reachability on edge arrays, by scipy's graph routines."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, dijkstra

from ..arrays import BoolArray, FloatArray, IndexArray


def edge_matrix(edges: IndexArray, weights: FloatArray, count: int) -> csr_matrix:
    """Matrix (count, count) with ``weights[k]`` at (tail, head) of edge k; zeros stay stored."""
    return csr_matrix((weights, (edges[:, 0], edges[:, 1])), shape=(count, count))


def reachable_from(edges: IndexArray, count: int, node: int) -> BoolArray:
    """Mark the nodes (count,) that can be reached from ``node``."""
    found = breadth_first_order(edge_matrix(edges, np.ones(len(edges)), count), node,
                                return_predecessors=False)
    reached = np.zeros(count, dtype=bool)
    reached[found] = True
    return reached


def on_some_route(edges: IndexArray, count: int, source: int, target: int) -> BoolArray:
    """Mark the nodes (count,) on some path from ``source`` to ``target``."""
    return reachable_from(edges, count, source) & reachable_from(edges[:, ::-1], count, target)


def distances_from(edges: IndexArray, weights: FloatArray, count: int, node: int) -> FloatArray:
    """Least weight of a path from ``node`` to each node (count,); inf if there is none."""
    distance: FloatArray = dijkstra(edge_matrix(edges, weights, count), indices=node)
    return distance


def shortest_path(edges: IndexArray, weights: FloatArray, count: int, source: int,
                  target: int) -> IndexArray:
    """Nodes (K,) of a path of least weight >= 0 from source to target; empty if there is none."""
    distance, predecessor = dijkstra(edge_matrix(edges, weights, count), indices=source,
                                     return_predecessors=True)
    if not np.isfinite(distance[target]):
        return np.empty(0, dtype=np.int64)
    nodes = [target]
    while nodes[-1] != source:
        nodes.append(int(predecessor[nodes[-1]]))
    return np.array(nodes[::-1], dtype=np.int64)
