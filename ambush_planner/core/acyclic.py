"""An acyclic part of the network that keeps a given acyclic strategy.

Nodes are put in one order: along the edges that the strategy uses, and otherwise by *progress*
d(source, j) - d(j, target). Only edges that go forward in this order stay, so every strategy on
what is left is acyclic, and the given one, with its value and its length, is among them.
"""

from __future__ import annotations

import heapq

import numpy as np

from .game import BoolArray, Game
from .network import IndexArray
from .paths import distances_from, on_some_route
from .risk_map import FloatArray


def acyclic_edges(game: Game, p: FloatArray) -> BoolArray:
    """Edges (M,) that go forward in an order in which p's edges do, and lie on some route.

    ``p`` must be acyclic. The result is a directed acyclic graph on which every node lies on a
    route from the source to the target.
    """
    return forward_edges(game, forward_rank(game, p))


def forward_edges(game: Game, rank: FloatArray | IndexArray) -> BoolArray:
    """Playable edges (M,) along which ``rank`` (N,) rises and that lie on some such route."""
    network = game.network
    forward = game.playable & (rank[network.tails] < rank[network.heads])
    useful = on_some_route(
        network.edges[forward], game.node_count, network.source, network.target
    )
    kept: BoolArray = forward & useful[network.tails] & useful[network.heads]
    return kept


def progress(game: Game) -> FloatArray:
    """d(source, j) - d(j, target) over length [m] for each node (N,); inf off every route."""
    network = game.network
    edges, lengths = network.edges[game.playable], network.lengths[game.playable]
    ahead = distances_from(edges, lengths, game.node_count, network.source)
    behind = distances_from(edges[:, ::-1], lengths, game.node_count, network.target)
    off = ~(np.isfinite(ahead) & np.isfinite(behind))
    return np.where(off, np.inf, np.where(off, 0.0, ahead) - np.where(off, 0.0, behind))


def forward_rank(game: Game, p: FloatArray) -> IndexArray:
    """Position (N,) of each node: source first, target last, p's edges forward.

    Among the nodes whose predecessors under p are all placed, the one of least progress comes
    next.
    """
    network, n = game.network, game.node_count
    urgency = progress(game)
    urgency[network.source], urgency[network.target] = -np.inf, np.inf
    used = np.flatnonzero(p > 0.0)
    order = used[np.argsort(network.tails[used], kind="stable")]
    first = np.searchsorted(network.tails[order], np.arange(n + 1)).tolist()
    heads = network.heads[order].tolist()
    waiting = np.bincount(network.heads[used], minlength=n)
    waiting[network.target] += 1  # free only when everything else is placed
    free = [(urgency[j], j) for j in np.flatnonzero(waiting == 0).tolist()]
    heapq.heapify(free)
    pending, key = waiting.tolist(), urgency.tolist()
    rank = np.full(n, n, dtype=np.int64)
    place = 0
    while free:
        _, node = heapq.heappop(free)
        rank[node] = place
        place += 1
        for head in heads[first[node] : first[node + 1]]:
            pending[head] -= 1
            if pending[head] == 0:
                heapq.heappush(free, (key[head], head))
    return rank
