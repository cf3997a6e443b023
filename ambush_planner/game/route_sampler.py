# SPDX-License-Identifier: Apache-2.0
"""Sampling of routes from a strategy, and routes as edges or as strategies of their own."""

from __future__ import annotations

from bisect import bisect_right
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..network.network import Network
from ..network.shortest_paths import shortest_path
from .distribution.acyclic import is_acyclic
from .distribution.chain import RouteMixture
from .game import Game


class RouteSampler:
    """Sampler that draws the next edge at each node with probability p_ij / x_i.

    If p is acyclic, a drawn route uses each edge with exactly its probability p. If p has cycles,
    loops are erased as they close (loop-erased random walk), so routes are simple.
    """

    def __init__(self, network: Network, p: FloatArray) -> None:
        used = np.flatnonzero(p > 0.0)
        order = used[np.argsort(network.tails[used], kind='stable')]
        self._network, self._used = network, order
        self._source, self._target = network.source, network.target
        # A step reads few numbers, which is ten times faster from lists than from arrays.
        self._heads = network.heads[order].tolist()
        tails = network.tails[order]
        self._first = np.searchsorted(tails, np.arange(len(network.points) + 1)).tolist()
        weights = p[order].tolist()
        self._steps = [
            step for first, end in pairwise(self._first) for step in accumulate(weights[first:end])
        ]
        self.acyclic = is_acyclic(network, p)

    def draw(self, rng: np.random.Generator) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last, none twice."""
        route, position = [self._source], {self._source: 0}
        while route[-1] != self._target:
            first, last = self._first[route[-1]], self._first[route[-1] + 1] - 1
            step = bisect_right(self._steps, rng.random() * self._steps[last], first, last)
            node = self._heads[step]
            if node in position:
                for erased in route[position[node] + 1 :]:
                    del position[erased]
                del route[position[node] + 1 :]
            else:
                position[node] = len(route)
                route.append(node)
        return np.array(route, dtype=np.int64)

    def draw_many(self, n: int, rng: np.random.Generator) -> list[IndexArray]:
        """Draw ``n`` routes; if p is acyclic, all advance together."""
        if n == 0 or not self.acyclic:
            return [self.draw(rng) for _ in range(n)]
        route, edge = self.draw_steps(n, rng)
        nodes = np.concatenate((np.full(n, self._source), self._network.heads[edge]))
        order = np.argsort(np.concatenate((np.arange(n), route)), kind='stable')
        return np.split(nodes[order], np.cumsum(np.bincount(route, minlength=n) + 1)[:-1])

    def draw_steps(self, n: int, rng: np.random.Generator) -> tuple[IndexArray, IndexArray]:
        """Draw ``n`` routes from an acyclic p as steps (S,): the route 0..n - 1 and edge of each.

        The steps of a route are in driving order.
        """
        heads, first = self._network.heads, np.array(self._first)
        node, route = np.full(n, self._source), np.arange(n)
        routes, edges = [], []
        while len(node):
            step = np.searchsorted(self._ends, node + rng.random(len(node)), side='right')
            step = np.minimum(step, first[node + 1] - 1)  # the sum can be rounded up
            routes.append(route)
            edges.append(self._used[step])
            node = heads[edges[-1]]
            unfinished = node != self._target
            node, route = node[unfinished], route[unfinished]
        return np.concatenate(routes), np.concatenate(edges)

    @cached_property
    def _ends(self) -> FloatArray:
        """Upper end of each step's interval: its node's number plus its cumulative share there.

        One sorted array serves all nodes; with a million of them, shares are rounded to 1e-10.
        """
        first, steps = np.array(self._first), np.array(self._steps)
        tails = self._network.tails[self._used]
        return np.asarray(tails + steps / steps[first[tails + 1] - 1])


class MixtureSampler:
    """Sampler of whole routes of one leg from a mixture."""

    acyclic = True

    def __init__(self, network: Network, mixture: RouteMixture) -> None:
        self._nodes = [frozen_array(np.append(network.source, network.heads[route]), np.int64)
                       for route in mixture.routes]
        self._edges, self._ends = mixture.routes, np.cumsum(mixture.shares)

    def draw(self, rng: np.random.Generator) -> IndexArray:
        """Draw a route (K,): node indices, source first, target last."""
        return self.draw_many(1, rng)[0]

    def draw_many(self, n: int, rng: np.random.Generator) -> list[IndexArray]:
        """Draw ``n`` routes."""
        return [self._nodes[k] for k in self._drawn(n, rng)]

    def draw_steps(self, n: int, rng: np.random.Generator) -> tuple[IndexArray, IndexArray]:
        """Draw ``n`` routes as steps (S,): the route 0..n - 1 and the edge of each."""
        edges = [self._edges[k] for k in self._drawn(n, rng)]
        return np.repeat(np.arange(n), list(map(len, edges))), np.concatenate(edges)

    def _drawn(self, n: int, rng: np.random.Generator) -> list[int]:
        drawn = np.searchsorted(self._ends, rng.random(n) * self._ends[-1], side='right')
        return [int(k) for k in np.minimum(drawn, len(self._nodes) - 1)]


def route_edges(network: Network, route: IndexArray) -> IndexArray:
    """Return the edges (K - 1,) along a route (K,) of nodes; -1: there is none."""
    return network.edges_between(route[:-1], route[1:])


def shortest_route(network: Network, edge: IndexArray,
                   cost: FloatArray | None = None) -> IndexArray:
    """Return the nodes (K,) of the cheapest route on the edges ``edge`` (m,).

    ``cost`` (M,) is by default the travel cost.
    """
    cost = network.travel_costs if cost is None else cost
    return shortest_path(network.edges[edge], cost[edge], len(network.points),
                         network.source, network.target)


def route_strategy(network: Network, route: IndexArray) -> FloatArray:
    """Return the strategy p (M,) of always driving ``route`` (K,)."""
    p = np.zeros(len(network.edges))
    p[route_edges(network, route)] = 1.0
    return p


def shortest_route_strategy(game: Game, cost: FloatArray | None = None) -> FloatArray:
    """Return the strategy p (M,) of always driving the shortest playable route."""
    edge = np.flatnonzero(game.playable)
    return route_strategy(game.network, shortest_route(game.network, edge, cost))


def route_entropy(network: Network, p: FloatArray) -> float:
    """Return the entropy -sum p ln(p / x_tail) of a route drawn from p (M,) [nats]."""
    leaving = sums(network.tails, p, len(network.points))
    return entropy(p, leaving[network.tails])


def entropy(p: FloatArray, whole: FloatArray) -> float:
    """Return -sum p ln(p / whole), with 0 ln 0 = 0 [nats]."""
    used = p > 0.0
    return float(0.0 - (p[used] * np.log(p[used] / whole[used])).sum())  # never -0
