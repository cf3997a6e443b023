"""The convoy's best response to an ambusher's mixed strategy when each site hits a route once.

For q (N,) >= 0 and prices of the budgets, the least of

    sum over sites j that the route meets of q_j alpha_j  +  sum over budgets of price * excess

over all routes, less price * room, bounds from below what any strategy within the budgets can
reach. A label is a node, what the way there has cost, and which of q's sites it has met. At one
node, label A dominates label B if A costs no more than B even after paying for every site that only
B has met: whatever follows, A ends no worse. Many labels at a node may not dominate each other, so
a search keeps only a few of them. A further label replaces the one most similar to it, and counts
as having met that one's sites as well. This only lowers the cost further on, so the least cost
remains a lower bound. If the route that is found costs more than this bound, the next search keeps
more labels.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IndexArray
from ..budget import Budget
from ..game import Game

# For each search, the most labels that it keeps at a node, and the comparisons of labels after
# which it stops: about 10, 3 and 0.2 s. The cost reached by then is still a lower bound.
SEARCHES = ((1, 20_000_000), (2, 5_000_000), (math.inf, 300_000))
# Relative rounding of a route's cost.
_ROUNDING = 1e-12
# Sites that the ambusher uses less than this, as a share of the costliest, are not counted.
_NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class BestResponse:
    """``bound`` on the value; the ``edges`` (K,) of a route that comes near it.

    ``edges`` is None if the search was cut short.
    """

    bound: float
    edges: IndexArray | None


def best_response(game: Game, q: FloatArray, budgets: tuple[Budget, ...],
                  prices: tuple[float, ...]) -> BestResponse:
    """Find the route that costs least against q (N,) with each site counted once."""
    base, paid = np.zeros(len(game.network.edges)), 0.0
    for budget, price in zip(budgets, prices, strict=True):
        if price > 0.0:
            base = base + price * budget.excess
            paid += price * budget.margin
    charge = game.loss[game.sites] * game.at_sites(q)
    least, edges = _least_cost(game, base, charge)
    if game.network.legs > 1:
        least = max(least, _least_cost_of_legs(game, base, q))
    return BestResponse(max(least - paid, 0.0), edges)


def _least_cost_of_legs(game: Game, base: FloatArray, q: FloatArray) -> float:
    """A lower bound of a trip's cost: each site is paid only on the leg for which it waits.

    That is the leg of the node at which q (N,) has it.
    """
    network, total = game.network, 0.0
    for number, leg in enumerate(game.legs()):
        own = game.at_places(np.where(network.leg == number, q, 0.0))
        costs = base[network.leg[network.tails] == number]
        charge = (leg.loss * own)[leg.sites]
        if leg.reach > 0.0:
            total += _least_cost(leg, costs, charge)[0]
        else:
            costs = costs + leg.mean_loss_on_edges(own)
            total += float(leg.distances_ahead(costs)[leg.network.target])
    return total


def _least_cost(game: Game, base: FloatArray,
                charge: FloatArray) -> tuple[float, IndexArray | None]:
    """A lower bound of the least base cost plus charges (S,) of a route, and a route near it."""
    rows = np.argsort(-charge, kind='stable')
    rows = rows[charge[rows] > _NEGLIGIBLE * charge.max(initial=0.0)]
    labels = _Labels(game, base, rows, charge[rows])
    least, best, edges = 0.0, math.inf, None
    for kept, comparisons in SEARCHES:
        bound, route = labels.search(kept, comparisons)
        least = max(least, bound)
        if route is None:
            break
        met = game.hits[rows][:, route].getnnz(axis=1) > 0
        cost = float(base[route].sum() + charge[rows][met].sum())
        if cost < best:
            best, edges = cost, route
        if best <= least * (1.0 + _ROUNDING):
            break
    return least, edges


class _Labels:
    """A* over (cost, node, sites met), with the distance over the base weights as potential."""

    def __init__(self, game: Game, base: FloatArray, rows: IndexArray, charge: FloatArray) -> None:
        network = game.network
        behind = game.distances_behind(base)
        usable = game.playable & np.isfinite(behind[network.heads])
        edge = np.flatnonzero(usable)
        edge = edge[np.argsort(network.tails[edge], kind='stable')]
        self._edge = edge
        self._first = np.searchsorted(network.tails[edge], np.arange(game.node_count + 1)).tolist()
        self._head, self._base = network.heads[edge].tolist(), base[edge].tolist()
        self._behind = behind.tolist()
        self._charge = charge.tolist()
        self._met = [0] * len(edge)
        hit = game.hits[rows][:, edge].tocoo()
        for row, k in zip(hit.row.tolist(), hit.col.tolist(), strict=True):
            self._met[k] |= 1 << row
        self._source, self._target = network.source, network.target

    def search(self, kept: float, comparisons: int) -> tuple[float, IndexArray | None]:
        """A lower bound of the least cost, and a route as edges; None after ``comparisons``.

        It keeps at most ``kept`` labels at each node.
        """
        behind = self._behind
        labels: list[tuple[int, int]] = [(-1, -1)]  # (label before, edge)
        settled: dict[int, list[tuple[float, int]]] = {}
        queue = [(behind[self._source], 0.0, 0, self._source, 0)]
        while queue:
            least, cost, number, node, met = heapq.heappop(queue)
            if node == self._target:
                return cost, self._route(labels, number)
            if comparisons < 0:
                return least, None
            here = settled.setdefault(node, [])
            comparisons -= len(here)
            if self._dominated(here, cost, met):
                continue
            if len(here) >= kept:
                lost = [self._charged(0.0, theirs & ~met) for _, theirs in here]
                met |= here.pop(lost.index(min(lost)))[1]
            here.append((cost, met))
            for k in range(self._first[node], self._first[node + 1]):
                head, new = self._head[k], self._met[k] & ~met
                after = self._charged(cost + self._base[k], new)
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
            if least <= cost and self._charged(least, met & ~theirs, cost) <= cost:
                return True
        return False

    def _charged(self, cost: float, sites: int, most: float = np.inf) -> float:
        """The cost with the charges of ``sites``, added until it exceeds ``most``."""
        while sites and cost <= most:
            lowest = sites & -sites
            cost += self._charge[lowest.bit_length() - 1]
            sites ^= lowest
        return cost

    def _route(self, labels: list[tuple[int, int]], number: int) -> IndexArray:
        route = []
        while number > 0:
            number, k = labels[number]
            route.append(self._edge[k])
        return np.array(route[::-1], dtype=np.int64)
