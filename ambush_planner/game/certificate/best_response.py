# SPDX-License-Identifier: Apache-2.0
"""The convoy's best response to an ambusher's mixed strategy when each site hits a route once.

For site prices q_j alpha_j >= 0 and costs of edges >= 0, the least of

    sum over sites j that the route meets of q_j alpha_j + sum over its edges of their costs

over all routes bounds from below what any strategy can reach. It is found by label setting: a label
is a node, what the way there has cost, and which of q's sites it has met. At one node, label A
dominates label B if A costs no more than B even after paying for every site that only B has met:
whatever follows, A ends no worse. Many labels at a node may not dominate each other, so a search
keeps only a few of them. A further label replaces the one most similar to it, and counts as having
met that one's sites as well. This only lowers the cost further on, so the least cost remains a
lower bound. If the route that is found costs more than this bound, the next search keeps more
labels.
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

# For each search, the most labels that it keeps at a node, and the comparisons of labels after
# which it stops: a second or two each. The cost reached by then is still a lower bound.
SEARCHES = tuple((9.0**k, 3_000_000) for k in (0, 1, 2, math.inf))
# The same if curves have proved a bound: on large networks, labels then hardly add to it.
SEARCHES_AFTER_CURVES = tuple((kept, 300_000) for kept, _ in SEARCHES)
Searches = Sequence[tuple[float, int]]


def best_response(game: Game, q: FloatArray, weights: FloatArray, deadline: float = math.inf,
                  target: float = math.inf, searches: Searches = SEARCHES) -> float:
    """A lower bound of what any route costs: site prices, and ``weights`` (M,) of its edges.

    Each site counts once. It is as great as the searches prove until ``deadline``
    (``time.monotonic``), or ``target``.
    """
    network = Subnetwork(game, game.entering)
    return network.least_cost(weights, (game.loss * q)[game.sites], searches, deadline, target)[0]


class Subnetwork:
    """The playable edges of a game, and the sites that they meet, as ``hits`` (S, M).

    ``edge`` (m,) are sorted by tail and head; ``tail`` and ``head`` (m,) number these nodes only.
    """

    def __init__(self, game: Game, hits: csr_matrix) -> None:
        network, edge = game.network, np.flatnonzero(game.playable)
        self.edge = edge[np.lexsort((network.heads[edge], network.tails[edge]))]
        nodes, numbers = np.unique(network.edges[self.edge], return_inverse=True)
        self.tail, self.head = numbers.reshape(-1, 2).T
        self.count, self._key = len(nodes), self.tail * len(nodes) + self.head
        self.source, self.target = np.searchsorted(nodes, (network.source, network.target)).tolist()
        self.out = np.searchsorted(self.tail, np.arange(self.count + 1))
        self.hits, self.entering = hits, csr_matrix(hits[:, self.edge])
        by_edge = hits.tocsc()
        self._met_by = by_edge.indices, by_edge.indptr.tolist()
        self.no_reentry = game.no_reentry

    def met(self, route: IndexArray) -> IndexArray:
        """The sites (K,) that a route, given by its edges (L,), meets."""
        sites, first = self._met_by
        return np.unique(np.concatenate([sites[first[edge] : first[edge + 1]]
                                         for edge in route.tolist()]))

    def cost(self, route: IndexArray, base: FloatArray, site_prices: FloatArray) -> float:
        """The cost of a route, each site counted once."""
        return float(base[route].sum() + site_prices[self.met(route)].sum())

    def shortest(self, base: FloatArray, site_prices: FloatArray) -> IndexArray:
        """The edges (K,) of the way of least cost if every entry is counted."""
        weights = base[self.edge] + site_prices @ self.entering
        # The rounding of sums, added for each edge: of equal ways, that with fewest edges is taken.
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
        """A lower bound of the least base cost (M,) plus site prices (S,), and a route near it.

        A bound of ``target`` ends the searches. The route is None if all were cut short, the last
        one at ``deadline``.
        """
        if self.no_reentry:
            shortest = self.shortest(base, site_prices)
            return self.cost(shortest, base, site_prices), shortest
        labels, least, best = _Labels(self, base, site_prices), 0.0, math.inf
        edges: IndexArray | None = None
        for kept, comparisons in searches:
            bound, route = labels.search(kept, comparisons, deadline)
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
        """The least base cost (n,) from each node to the target."""
        graph = csr_matrix((base[self.edge], (self.head, self.tail)), (self.count, self.count))
        return np.asarray(dijkstra(graph, indices=self.target))


class _Labels:
    """A* over (cost, node, sites met), with the least base cost to the target as potential."""

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

    def search(self, kept: float, comparisons: int,
               deadline: float) -> tuple[float, IndexArray | None]:
        """A lower bound of the least cost, and a route as edges.

        The route is None after ``comparisons``, or at ``deadline``. The search keeps at most
        ``kept`` labels at each node.
        """
        to_target = self._to_target
        labels: list[tuple[int, int]] = [(-1, -1)]  # (label before, edge)
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
            here = settled.setdefault(node, [])
            comparisons -= len(here)
            if self._dominated(here, cost, met):
                continue
            if len(here) >= kept:
                lost = [self._with_prices(0.0, theirs & ~met) for _, theirs in here]
                met |= here.pop(lost.index(min(lost)))[1]
            here.append((cost, met))
            for k in range(self._first[node], self._first[node + 1]):
                head, new = self._head[k], self._met[k] & ~met
                total = cost + self._base[k] + self._with_prices(0.0, new)
                both, there = met | new, settled.get(head, ())
                comparisons -= len(there) + 1
                if self._dominated(there, total, both):
                    continue
                labels.append((number, k))
                heapq.heappush(queue, (total + to_target[head], total, len(labels) - 1, head, both))
        return np.inf, None

    def _dominated(self, others: Sequence[tuple[float, int]], cost: float, met: int) -> bool:
        """Return whether another label, paying for the sites that it lacks, costs no more."""
        for least, theirs in others:
            if least <= cost and self._with_prices(least, met & ~theirs, cost) <= cost:
                return True
        return False

    def _with_prices(self, cost: float, sites: int, most: float = np.inf) -> float:
        """The cost with the site prices of ``sites``, added until it exceeds ``most``."""
        while sites and cost <= most:
            lowest = sites & -sites
            cost += self._prices[lowest.bit_length() - 1]
            sites ^= lowest
        return cost
