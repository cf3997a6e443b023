# SPDX-License-Identifier: Apache-2.0
"""The convoy's best response to an ambusher's mixed strategy when each site hits a route once.

For q >= 0 and a price of the length, the least of

    sum over sites j that the route meets of q_j alpha_j + price * reduced cost

over all routes, less price * budget slack, bounds from below what any strategy within the budget
can reach. A label is a node, what the way there has cost, and which of q's sites it has met. At one
node, label A dominates label B if A costs no more than B even after paying for every site that only
B has met: whatever follows, A ends no worse. Many labels at a node may not dominate each other, so
a search keeps only a few of them. A further label replaces the one most similar to it, and counts
as having met that one's sites as well. This only lowers the cost further on, so the least cost
remains a lower bound. If the route that is found costs more than this bound, the next search keeps
more labels.

A trip that is hit at j pays at least q_jl alpha_j for each l-th leg that meets j, if the q_jl add
up to q_j. So what its legs cost at least, each on its own, is a bound, too (docs/theory.md,
Proposition 13.1); of trips in any order, that of the order whose legs cost least.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ...arrays import NEGLIGIBLE, ROUNDING, BoolArray, FloatArray, IndexArray
from ..ambusher import Ambusher
from ..budget import Budget
from ..game import Game

# For each search, the most labels that it keeps at a node, and the comparisons of labels after
# which it stops: a second or two each. The cost reached by then is still a lower bound.
SEARCHES = tuple((9.0**k, 3_000_000) for k in (0, 1, 2, math.inf))
Searches = Sequence[tuple[float, int]]


def best_response(game: Game, ambusher: Ambusher, budget: Budget,
                  deadline: float = math.inf, enough: float = math.inf) -> float:
    """A lower bound of what any strategy costs against an ambusher with each site counted once.

    It is as great as the searches prove until ``deadline`` (``time.monotonic``), or ``enough``.
    """
    base, worth = ambusher.paid(game, budget)
    waits = ambusher.q[None] if ambusher.by_leg is None else ambusher.by_leg
    dual_weights = game.loss[game.sites] * [game.at_sites(each) for each in waits]
    least, _ = TripNetworks(game, game.entering).least_cost(base, dual_weights, SEARCHES, deadline,
                                                        enough + worth)
    return max(least - worth, 0.0)


class Leg(NamedTuple):
    """What can be one leg of a trip: the ``number``-th, from a stop to another one.

    ``begin`` and ``end`` number the stops, each once for every set of stops visited before; 0 is
    the source, the largest number the target.
    """

    number: int
    begin: int
    end: int
    network: Subnetwork


class TripNetworks:
    """The subnetwork of each leg of a trip and that of the whole trip, with sites' rows (S, M).

    ``legs`` are in an order in which trips drive them; without a choice of the order, each once.
    """

    def __init__(self, game: Game, hits: csr_matrix) -> None:
        network = game.network
        leg, used = network.leg, network.edges[game.playable]
        one, exact = network.legs == 1, game.reach == 0.0
        first, last = np.array([network.source]), np.array([network.target])
        whole = Subnetwork(network.edges, game.playable, hits, exact and one)
        self.whole = whole.between(first, last)
        if one:
            self._stop = {network.source: 0, network.target: 1}
            self.legs = [Leg(0, 0, 1, self.whole)]
            return
        nodes = np.unique(used[leg[used[:, 1]] > leg[used[:, 0]], 1])
        at = leg[nodes] * network.place_count + network.places[nodes]  # layers begin together
        begins = [first, *(nodes[at == k] for k in np.unique(at)), last]
        self._stop = {node: k for k, own in enumerate(begins) for node in own.tolist()}
        self.legs = []
        for layer, number in enumerate(network.stops_before.tolist()):  # one for stops visited
            inside = game.playable & (leg[network.tails] == layer)
            own_edges, heads = Subnetwork(network.edges, inside, hits, exact), network.heads[inside]
            ends = [k for k, own in enumerate(begins) if np.isin(own, heads[
                (leg[heads] > layer) | (heads == network.target)]).any()]
            self.legs += [Leg(number, begin, end, own_edges.between(own, begins[end]))
                          for begin, own in enumerate(begins[:-1]) if leg[own[0]] == layer
                          for end in ends]

    def least_cost(self, base: FloatArray, dual_weights: FloatArray, searches: Searches,
                   deadline: float = math.inf,
                   enough: float = math.inf) -> tuple[float, IndexArray | None]:
        """A lower bound of the least base cost (M,) plus dual weights (stops + 1, S); a route near.

        If the ambusher waits for several legs, the bound and the route are those of the legs, else
        a bound of ``enough`` ends the searches.
        """
        if np.count_nonzero(dual_weights.any(axis=1)) < 2:
            return self.whole.least_cost(base, dual_weights.sum(axis=0), searches, deadline,
                                         enough)
        ways: dict[int, IndexArray | None] = {}

        def cost(k: int) -> float:
            number, _, _, network = self.legs[k]
            least, ways[k] = network.least_cost(base, dual_weights[number], searches, deadline)
            return least

        least, trip = self.least_trip(cost)
        found = [way for way in map(ways.get, trip) if way is not None]
        return least, np.concatenate(found) if len(found) == len(trip) else None

    def trip(self, ends: Sequence[tuple[int, int]]) -> list[int]:
        """The legs between nodes where legs begin and end."""
        number = {(leg.begin, leg.end): k for k, leg in enumerate(self.legs)}
        return [number[self._stop[begin], self._stop[end]] for begin, end in ends]

    def least_trip(self, cost: Callable[[int], float]) -> tuple[float, list[int]]:
        """The least cost of a trip, and its legs; asks the ``cost`` of those that may matter."""
        known: dict[int, float] = {}
        while True:
            least, before = {0: 0.0}, {}
            for k, leg in enumerate(self.legs):
                total = least.get(leg.begin, math.inf) + known.get(k, 0.0)
                if total < least.get(leg.end, math.inf):
                    least[leg.end], before[leg.end] = total, k
            trip, end = [], self.legs[-1].end
            while end:
                trip.append(before[end])
                end = self.legs[trip[-1]].begin
            new = [k for k in trip[::-1] if k not in known]
            if not new:
                return least[self.legs[-1].end], trip[::-1]
            known.update((k, cost(k)) for k in new)


class Subnetwork:
    """The ``used`` ones of some edges (M, 2), and the sites that they meet, as ``hits`` (S, M).

    ``edge`` (m,) are sorted by tail and head; ``tail`` and ``head`` (m,) number these nodes only.
    ``exact``: no way can meet a site more than once.
    """

    def __init__(self, ends: IndexArray, used: BoolArray, hits: csr_matrix, exact: bool) -> None:
        edge = np.flatnonzero(used)
        self.edge = edge[np.lexsort((ends[edge, 1], ends[edge, 0]))]
        self._nodes, numbers = np.unique(ends[self.edge], return_inverse=True)
        self.tail, self.head = numbers.reshape(-1, 2).T
        self.count, self._key = len(self._nodes), self.tail * len(self._nodes) + self.head
        self.out = np.searchsorted(self.tail, np.arange(self.count + 1))
        self.hits, self.entering = hits, csr_matrix(hits[:, self.edge])
        by_edge = hits.tocsc()
        self._met_by = by_edge.indices, by_edge.indptr.tolist()
        self.exact = exact
        self.first = self.last = np.arange(0)

    def between(self, first: IndexArray, last: IndexArray) -> Subnetwork:
        """The same edges, for ways from some nodes to others."""
        other = copy(self)
        other.first, other.last = (np.flatnonzero(np.isin(self._nodes, each))
                                   for each in (first, last))
        return other

    def met(self, route: IndexArray) -> BoolArray:
        """The sites (S,) that a route, given by its edges (K,), meets."""
        met, (sites, first) = np.zeros(self.hits.shape[0], dtype=bool), self._met_by
        for edge in route.tolist():
            met[sites[first[edge] : first[edge + 1]]] = True
        return met

    def cost(self, route: IndexArray, base: FloatArray, dual_weights: FloatArray) -> float:
        """What a route costs, each site counted once."""
        return float(base[route].sum() + dual_weights @ self.met(route))

    def shortest(self, base: FloatArray, dual_weights: FloatArray) -> IndexArray:
        """The edges (K,) of the way of least cost if every entry is counted."""
        weights = base[self.edge] + dual_weights @ self.entering
        # The rounding of sums, added for each edge: of equal ways, that with fewest edges is taken.
        weights += self.count * np.finfo(float).eps * (float(weights.max()) or 1.0)
        graph = csr_matrix((weights, self.head, self.out), (self.count, self.count))
        distance, before, _ = dijkstra(graph, indices=self.first, return_predecessors=True,
                                       min_only=True)
        nodes = [int(self.last[np.argmin(distance[self.last])])]
        while before[nodes[-1]] >= 0:
            nodes.append(int(before[nodes[-1]]))
        step = np.array(nodes[:0:-1]) * self.count + nodes[-2::-1]
        return np.asarray(self.edge[np.searchsorted(self._key, step)])

    def least_cost(self, base: FloatArray, dual_weights: FloatArray, searches: Searches,
                   deadline: float = math.inf,
                   enough: float = math.inf) -> tuple[float, IndexArray | None]:
        """A lower bound of the least base cost (M,) plus dual weights (S,), and a route near it.

        A bound of ``enough`` ends the searches. The route is None if all were cut short, the last
        one at ``deadline``.
        """
        if self.exact:
            shortest = self.shortest(base, dual_weights)
            return self.cost(shortest, base, dual_weights), shortest
        labels, least, best = _Labels(self, base, dual_weights), 0.0, math.inf
        edges: IndexArray | None = None
        for kept, comparisons in searches:
            bound, route = labels.search(kept, comparisons, deadline)
            least = max(least, bound)
            if least >= enough or time.monotonic() > deadline:
                break
            if route is None:
                continue
            cost = self.cost(route, base, dual_weights)
            if cost < best:
                best, edges = cost, route
            if best <= least * (1.0 + ROUNDING):
                break
        return least, edges

    def behind(self, base: FloatArray) -> FloatArray:
        """The least base cost (n,) from each node to the last ones."""
        graph = csr_matrix((base[self.edge], (self.head, self.tail)), (self.count, self.count))
        return np.asarray(dijkstra(graph, indices=self.last, min_only=True))


class _Labels:
    """A* over (cost, node, sites met), with the distance over the base costs as potential."""

    def __init__(self, network: Subnetwork, base: FloatArray, dual_weights: FloatArray) -> None:
        rows = np.argsort(-dual_weights, kind='stable')
        rows = rows[dual_weights[rows] > NEGLIGIBLE * dual_weights.max(initial=0.0)]
        self._met, hit = [0] * len(network.edge), network.entering[rows].tocoo()
        for row, k in zip(hit.row.tolist(), hit.col.tolist(), strict=True):
            self._met[k] |= 1 << row
        self._edge, self._behind = network.edge, network.behind(base).tolist()
        self._first, self._head = network.out.tolist(), network.head.tolist()
        self._base, self._dual_weights = base[network.edge].tolist(), dual_weights[rows].tolist()
        self._sources, self._targets = network.first.tolist(), set(network.last.tolist())

    def search(self, kept: float, comparisons: int,
               deadline: float) -> tuple[float, IndexArray | None]:
        """A lower bound of the least cost, and a route as edges.

        The route is None after ``comparisons``, or at ``deadline``. The search keeps at most
        ``kept`` labels at each node.
        """
        behind = self._behind
        labels: list[tuple[int, int]] = [(-1, -1)]  # (label before, edge)
        settled: dict[int, list[tuple[float, int]]] = {}
        queue = [(behind[node], 0.0, 0, node, 0) for node in self._sources]
        heapq.heapify(queue)
        while queue:
            least, cost, number, node, met = heapq.heappop(queue)
            if node in self._targets:
                return cost, self._route(labels, number)
            if comparisons < 0 or time.monotonic() > deadline:
                return least, None
            here = settled.setdefault(node, [])
            comparisons -= len(here)
            if self._dominated(here, cost, met):
                continue
            if len(here) >= kept:
                lost = [self._with_dual_weights(0.0, theirs & ~met) for _, theirs in here]
                met |= here.pop(lost.index(min(lost)))[1]
            here.append((cost, met))
            for k in range(self._first[node], self._first[node + 1]):
                head, new = self._head[k], self._met[k] & ~met
                after = cost + self._base[k] + self._with_dual_weights(0.0, new)
                both, there = met | new, settled.get(head, ())
                comparisons -= len(there) + 1
                if self._dominated(there, after, both):
                    continue
                labels.append((number, k))
                heapq.heappush(queue, (after + behind[head], after, len(labels) - 1, head, both))
        return np.inf, None

    def _dominated(self, others: Sequence[tuple[float, int]], cost: float, met: int) -> bool:
        """Whether another label costs no more even if it pays for the sites that it lacks."""
        for least, theirs in others:
            if least <= cost and self._with_dual_weights(least, met & ~theirs, cost) <= cost:
                return True
        return False

    def _with_dual_weights(self, cost: float, sites: int, most: float = np.inf) -> float:
        """The cost with the dual weights of ``sites``, added until it exceeds ``most``."""
        while sites and cost <= most:
            lowest = sites & -sites
            cost += self._dual_weights[lowest.bit_length() - 1]
            sites ^= lowest
        return cost

    def _route(self, labels: list[tuple[int, int]], number: int) -> IndexArray:
        route = []
        while number > 0:
            number, k = labels[number]
            route.append(self._edge[k])
        return np.array(route[::-1], dtype=np.int64)
