"""Taking the cycles out of a flow, and the order of what is left."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from .network import IndexArray, Network
from .paths import edge_matrix
from .risk_map import FloatArray


def without_cycles(network: Network, p: FloatArray) -> FloatArray:
    """Return p less the flow that goes round in cycles: same trips, no node visited more often."""
    p = p.copy()
    while True:
        circling = _circling_edges(network, p)
        if len(circling) == 0:
            return p
        _cancel_cycles(network.edges, p, circling)


def is_acyclic(network: Network, p: FloatArray) -> bool:
    """Tell whether the edges with p > 0 form no cycle."""
    return len(_circling_edges(network, p)) == 0


def _circling_edges(network: Network, p: FloatArray) -> IndexArray:
    """Edges with p > 0 that lie on a cycle of such edges: both ends in one strong component."""
    used = np.flatnonzero(p > 0.0)
    edges = network.edges[used]
    graph = edge_matrix(edges, np.ones(len(used)), len(network.points))
    _, component = connected_components(graph, directed=True, connection="strong")
    same: IndexArray = used[component[edges[:, 0]] == component[edges[:, 1]]]
    return same


def _cancel_cycles(edges: IndexArray, p: FloatArray, circling: IndexArray) -> None:
    """Walk the circling edges; on meeting a node again, take the least p off that cycle."""
    leaving: dict[int, list[int]] = {}
    for k in circling.tolist():
        leaving.setdefault(int(edges[k, 0]), []).append(k)
    while leaving:
        node = next(iter(leaving))
        position, walk = {node: 0}, []
        while leaving.get(node):
            k = leaving[node][-1]
            walk.append(k)
            node = int(edges[k, 1])
            if node in position:
                walk = _cancel(edges, p, walk, position, leaving)
                break
            position[node] = len(walk)
        else:
            # A dead end: what led here lies on no cycle any more.
            leaving.pop(node, None)
            if walk:
                leaving[int(edges[walk[-1], 0])].pop()


def _cancel(
    edges: IndexArray,
    p: FloatArray,
    walk: list[int],
    position: dict[int, int],
    leaving: dict[int, list[int]],
) -> list[int]:
    cycle = walk[position[int(edges[walk[-1], 1])] :]
    p[cycle] -= p[cycle].min()
    for k in cycle:
        if p[k] <= 0.0:
            leaving[int(edges[k, 0])].remove(k)
    return []
