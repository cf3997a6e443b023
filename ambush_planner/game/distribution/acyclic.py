# SPDX-License-Identifier: Apache-2.0
"""Acyclic subnetworks: a topological order of nodes, and the edges that go forward in it.

On an acyclic subnetwork every strategy's p and x are probabilities, and every drawn route is
simple. The order follows the *harmonic potential*: the voltage if each edge is a resistor in
proportion to its length, the source is at 0 and the target at 1. The potential of every other node
lies between those of its neighbours, so on a two-way network every node on a route keeps a forward
edge in and out, and each road keeps one direction. If a given strategy has to remain possible, its
edges go forward, and the potential only orders the nodes that these leave free.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ...arrays import ROUNDING, FloatArray, IndexArray
from ...network.network import Network
from ...network.shortest_paths import edge_matrix
from ..game import Game


def order_potential(game: Game) -> FloatArray:
    """Voltages (N,) of the nodes of playable edges, 0 at source and 1 at target; inf elsewhere."""
    network, edges = game.network, game.network.edges[game.playable]
    driven = np.unique(edges)
    lengths = network.lengths[game.playable]
    conductance = 1.0 / np.maximum(lengths, ROUNDING * float(lengths.mean()) or 1.0)
    place = np.full(game.node_count, -1)
    place[driven] = np.arange(len(driven))
    tail, head = place[edges].T
    shape = (len(driven), len(driven))
    one_way = coo_matrix((conductance, (tail, head)), shape=shape).tocsr()
    joined = one_way + one_way.T
    laplacian = diags(np.asarray(joined.sum(axis=1)).ravel()) - joined
    potential = np.full(game.node_count, np.inf)
    potential[network.source], potential[network.target] = 0.0, 1.0
    inner = driven[(driven != network.source) & (driven != network.target)]
    if len(inner):
        rows = laplacian.tocsr()[place[inner]]
        pull = -rows[:, [place[network.target]]].toarray().ravel()
        system = rows[:, place[inner]].tocsc()
        # The system is positive definite: diagonal pivots keep the order with the least fill-in.
        factor = splu(system, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0, relax=1,
                      options={'SymmetricMode': True})
        potential[inner] = factor.solve(pull)
    return potential


def positions_by(potential: FloatArray) -> IndexArray:
    """Position (N,) of each node in the order of the potential."""
    position = np.empty(len(potential), dtype=np.int64)
    position[np.argsort(potential, kind='stable')] = np.arange(len(potential))
    return position


def topological_order(game: Game, p: FloatArray, potential: FloatArray) -> IndexArray:
    """Position (N,) of each node in a topological order for an acyclic p (M,).

    The next node is that of least potential whose predecessors under p all have a position. The
    source is first, the target last.
    """
    network, n = game.network, game.node_count
    potential = potential.copy()
    potential[network.source] = -np.inf
    # Nodes are numbered in the order of the potential, so the heap holds integers.
    number = positions_by(potential)
    tail, head = number[network.edges[p > 0.0]].T
    order = np.argsort(tail, kind='stable')
    first = np.searchsorted(tail[order], np.arange(n + 1)).tolist()
    heads = head[order].tolist()
    pending = np.bincount(head, minlength=n)  # predecessors without a position
    pending[number[network.target]] += 1  # so it comes last
    free = np.flatnonzero(pending == 0).tolist()  # sorted, so a heap
    pending = pending.tolist()
    position = np.full(n, n, dtype=np.int64)
    place = 0
    while free:
        node = heapq.heappop(free)
        position[node] = place
        place += 1
        for follower in heads[first[node] : first[node + 1]]:
            pending[follower] -= 1
            if pending[follower] == 0:
                heapq.heappush(free, follower)
    return position[number]


def acyclic_subnetwork(game: Game, position: IndexArray) -> Game | None:
    """Return the game on edges along which ``position`` (N,) rises; None if it has no route."""
    return game.restricted_to(position[game.network.tails] < position[game.network.heads])


def without_cycles(network: Network, p: FloatArray) -> FloatArray:
    """Cancel the flow of p (M,) around cycles; no node is visited more often."""
    component, used = _strong_components(network, p), np.flatnonzero(p > 0.0)
    tails, heads = network.edges[used].T
    cyclic, acyclic_p = used[component[tails] == component[heads]], p.copy()
    tails, heads = network.edges[cyclic].T
    for cycle, flow in simple_cycles(tails, heads, p[cyclic]):
        acyclic_p[cyclic[cycle]] -= flow
    return acyclic_p


def simple_cycles(tail: IndexArray, head: IndexArray,
                  flow: FloatArray) -> Iterator[tuple[IndexArray, float]]:
    """Decompose a flow (K,) on arcs into simple cycles, and yield the arcs and flow of each.

    Nodes are numbers >= 0. Flow that is not balanced is dropped.
    """
    order = np.argsort(tail, kind='stable')
    heads, remaining = head[order].tolist(), flow[order].tolist()
    nodes = int(max(tail.max(initial=0), head.max(initial=0))) + 1
    first = np.searchsorted(tail[order], np.arange(nodes + 1)).tolist()
    next_arc, ends = first[:-1], first[1:]
    for start in np.unique(tail).tolist():
        walk: list[int] = []
        node, place = start, {start: 0}
        while True:
            while next_arc[node] < ends[node] and remaining[next_arc[node]] <= 0.0:
                next_arc[node] += 1
            if next_arc[node] == ends[node]:  # a dead end
                if not walk:
                    break
                remaining[walk.pop()] = 0.0
                del place[node]
                node = heads[walk[-1]] if walk else start
                continue
            walk.append(next_arc[node])
            node = heads[walk[-1]]
            if node in place:
                cycle = walk[place[node] :]
                least = min(remaining[arc] for arc in cycle)
                yield order[cycle], least
                for arc in cycle:
                    remaining[arc] -= least
                    del place[heads[arc]]
                del walk[len(walk) - len(cycle) :]
            place[node] = len(walk)


def is_acyclic(network: Network, p: FloatArray) -> bool:
    """Return whether the edges with p > 0 form no cycle."""
    return order_along(network, p) is not None


def order_along(network: Network, p: FloatArray) -> IndexArray | None:
    """Numbers (N,) of nodes that rise along the edges with p > 0; None if these form a cycle."""
    number = -_strong_components(network, p)
    tails, heads = network.edges[p > 0.0].T
    return number if (number[tails] < number[heads]).all() else None


def _strong_components(network: Network, p: FloatArray) -> IndexArray:
    """Strong component (N,) of each node by the edges with p > 0; numbers fall along the edges.

    scipy finds them by Tarjan's method, from the sinks up.
    """
    edges = network.edges[p > 0.0]
    graph = edge_matrix(edges, np.ones(len(edges)), len(network.points))
    _, component = connected_components(graph, directed=True, connection='strong')
    return np.asarray(component, dtype=np.int64)
