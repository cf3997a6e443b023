# SPDX-License-Identifier: Apache-2.0
"""The convoy's best response to an ambusher, by label setting with each site paid once.

This is the pricing problem of column generation, and the proof of lower bounds: the least of

    sum of the site prices q_j alpha_j of the sites j that a route meets + sum of its edges' costs

over all routes. A label is a node, the cost of the way there, and the set of sites met so far. At
one node, label A dominates label B if A costs no more than B even after paying for every site that
only B has met: whatever follows, A ends no worse (docs/theory.md, Proposition 5.4).

Many labels at a node may not dominate each other, so a search keeps only a few. A further label
replaces the one most similar to it and takes over its sites as met. This only lowers later costs,
so the least cost remains a lower bound. If the route found costs more than the bound, the next
search keeps more labels.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ...arrays import NEGLIGIBLE, ROUNDING, FloatArray, IndexArray
from ..game import Game

# Successive searches: how many labels each keeps at a node, and after how many comparisons it stops
# (a second or two). The least cost in its queue is a lower bound even then.
SEARCHES = tuple((9.0**k, 3_000_000) for k in (0, 1, 2, math.inf))
# The same if curves have proved a bound: on large networks, labels then hardly add to it.
SEARCHES_AFTER_CURVES = tuple((kept, 300_000) for kept, _ in SEARCHES)
Searches = Sequence[tuple[float, int]]


def best_response(game: Game, q: FloatArray, weights: FloatArray, deadline: float = math.inf,
                  target: float = math.inf, searches: Searches = SEARCHES) -> float:
    """Return a lower bound of the cost of every route: site prices plus edge ``weights`` (M,).

    The searches go on until they prove ``target``, or until ``deadline`` (``time.monotonic``).
    """
    network = Subnetwork(game, game.entering)
    return network.least_cost(weights, (game.loss * q)[game.sites], searches, deadline, target)[0]


class Subnetwork:
    """The playable edges of a game, with rows of sites: the graph on which routes are priced.

    ``edge`` (m,) has their numbers in the network, sorted by tail and head; ``tail`` and ``head``
    (m,) number the nodes of these edges only.
    """

    def __init__(self, game: Game, rows: csr_matrix) -> None:
        """``rows`` (S, M) of 0 and 1: the edges by which a route enters each site's reach."""
        network, edge = game.network, np.flatnonzero(game.playable)
        self.edge = edge[np.lexsort((network.heads[edge], network.tails[edge]))]
        nodes, numbers = np.unique(network.edges[self.edge], return_inverse=True)
        self.tail, self.head = numbers.reshape(-1, 2).T
        self.count, self._key = len(nodes), self.tail * len(nodes) + self.head
        self.source, self.target = np.searchsorted(nodes, (network.source, network.target)).tolist()
        self.out = np.searchsorted(self.tail, np.arange(self.count + 1))
        self.rows, self.entering = rows, csr_matrix(rows[:, self.edge])
        by_edge = rows.tocsc()
        self._sites_of_edges = by_edge.indices, by_edge.indptr.tolist()
        self.no_reentry = game.no_reentry

    def met(self, route: IndexArray) -> IndexArray:
        """Sites (K,) that a route, given by its edges (L,), meets."""
        sites, first = self._sites_of_edges
        return np.unique(np.concatenate([sites[first[edge] : first[edge + 1]]
                                         for edge in route.tolist()]))

    def cost(self, route: IndexArray, base: FloatArray, site_prices: FloatArray) -> float:
        """Cost of a route: base costs (M,) of its edges, plus the price of each site it meets."""
        return float(base[route].sum() + site_prices[self.met(route)].sum())

    def shortest(self, base: FloatArray, site_prices: FloatArray) -> IndexArray:
        """Edges (K,) of the cheapest route if every entry pays the site's price."""
        weights = base[self.edge] + site_prices @ self.entering
        # Break ties for the route with fewest edges, by as much as sums are rounded.
        weights += self.count * np.finfo(float).eps * (float(weights.max()) or 1.0)
        graph = csr_matrix((weights, self.head, self.out), (self.count, self.count))
        predecessor = dijkstra(graph, indices=self.source, return_predecessors=True)[1]
        nodes = [self.target]
        while predecessor[nodes[-1]] >= 0:
            nodes.append(int(predecessor[nodes[-1]]))
        step = np.array(nodes[:0:-1]) * self.count + nodes[-2::-1]
        return np.asarray(self.edge[np.searchsorted(self._key, step)])

    def least_cost(self, base: FloatArray, site_prices: FloatArray, searches: Searches,
                   deadline: float = math.inf,
                   target: float = math.inf) -> tuple[float, IndexArray | None]:
        """Return a lower bound of the least ``cost`` of a route, and the best route found (K,).

        The searches end with a bound of ``target``, or at ``deadline``. The route is None if every
        search was cut short.
        """
        if self.no_reentry:
            shortest = self.shortest(base, site_prices)
            return self.cost(shortest, base, site_prices), shortest
        labels, least, best = _Labels(self, base, site_prices), 0.0, math.inf
        edges: IndexArray | None = None
        for max_labels, comparisons in searches:
            bound, route = labels.search(max_labels, comparisons, deadline)
            least = max(least, bound)
            if least >= target or time.monotonic() > deadline:
                break
            if route is None:
                continue
            cost = self.cost(route, base, site_prices)
            if cost < best:
                best, edges = cost, route
            if best <= least * (1.0 + ROUNDING):
                break
        return least, edges

    def costs_to_target(self, base: FloatArray) -> FloatArray:
        """Least base cost (n,) from each node to the target."""
        graph = csr_matrix((base[self.edge], (self.head, self.tail)), (self.count, self.count))
        return np.asarray(dijkstra(graph, indices=self.target))


class _Labels:
    """A* label setting; the heuristic is the least base cost to the target.

    Sets of sites are the bits of an integer; sites are numbered by falling price.
    """

    def __init__(self, network: Subnetwork, base: FloatArray, site_prices: FloatArray) -> None:
        rows = np.argsort(-site_prices, kind='stable')
        rows = rows[site_prices[rows] > NEGLIGIBLE * site_prices.max(initial=0.0)]
        self._met, hit = [0] * len(network.edge), network.entering[rows].tocoo()
        for row, k in zip(hit.row.tolist(), hit.col.tolist(), strict=True):
            self._met[k] |= 1 << row
        self._edge, self._to_target = network.edge, network.costs_to_target(base).tolist()
        self._first, self._head = network.out.tolist(), network.head.tolist()
        self._base, self._prices = base[network.edge].tolist(), site_prices[rows].tolist()
        self._source, self._target = network.source, network.target

    def search(self, max_labels: float, comparisons: int,
               deadline: float) -> tuple[float, IndexArray | None]:
        """Return a lower bound of the least cost, and a route as edges (K,).

        At most ``max_labels`` are kept at a node. The route is None if the search ends early:
        after a number of ``comparisons`` of labels, or at ``deadline``.
        """
        to_target = self._to_target
        labels: list[tuple[int, int]] = [(-1, -1)]  # (predecessor, edge)
        settled: dict[int, list[tuple[float, int]]] = {}
        queue = [(to_target[self._source], 0.0, 0, self._source, 0)]
        while queue:
            least, cost, number, node, met = heapq.heappop(queue)
            if node == self._target:
                route = []
                while number > 0:
                    number, k = labels[number]
                    route.append(self._edge[k])
                return cost, np.array(route[::-1], dtype=np.int64)
            if comparisons < 0 or time.monotonic() > deadline:
                return least, None
            at_node = settled.setdefault(node, [])
            comparisons -= len(at_node)
            if self._dominated(at_node, cost, met):
                continue
            if len(at_node) >= max_labels:
                lost = [self._add_prices(0.0, theirs & ~met) for _, theirs in at_node]
                met |= at_node.pop(lost.index(min(lost)))[1]
            at_node.append((cost, met))
            for k in range(self._first[node], self._first[node + 1]):
                head, new = self._head[k], self._met[k] & ~met
                total = cost + self._base[k] + self._add_prices(0.0, new)
                union, at_head = met | new, settled.get(head, ())
                comparisons -= len(at_head) + 1
                if self._dominated(at_head, total, union):
                    continue
                labels.append((number, k))
                heapq.heappush(queue,
                               (total + to_target[head], total, len(labels) - 1, head, union))
        return np.inf, None

    def _dominated(self, others: Sequence[tuple[float, int]], cost: float, met: int) -> bool:
        """Return whether another label costs no more after paying for the sites it has not met."""
        for least, theirs in others:
            if least <= cost and self._add_prices(least, met & ~theirs, cost) <= cost:
                return True
        return False

    def _add_prices(self, cost: float, sites: int, limit: float = np.inf) -> float:
        """Add the prices of ``sites`` to a cost, until it exceeds ``limit``."""
        while sites and cost <= limit:
            lowest = sites & -sites
            cost += self._prices[lowest.bit_length() - 1]
            sites ^= lowest
        return cost
