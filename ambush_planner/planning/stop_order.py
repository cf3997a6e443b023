# SPDX-License-Identifier: Apache-2.0
"""The best order of a trip's stops."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise, permutations
from typing import NamedTuple

import numpy as np

from ..arrays import ROUNDING, FloatArray, IndexArray
from ..errors import InvalidNetwork, TimeLimit
from ..game.certificate.best_response import Subnetwork
from ..game.game import Game
from ..game.slack import ceiling
from ..game.strategy import Strategy
from ..game.value.routes import LEG_SEARCH, Progress
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..network.shortest_paths import distances_from
from ..network.trip_graph import TripGraph
from .options import PlanningOptions
from .refinement import Round
from .solving import solve_on_network, with_time

# Largest number of stops for which all orders (5040) are compared.
MAX_COMPARED = 7


class Planned(NamedTuple):
    """A strategy, the order of its stops, how that was found, and the rounds of refinement."""

    strategy: Strategy
    order: tuple[int, ...]
    order_found: str
    rounds: tuple[Round, ...] = ()


def in_order(graph: TripGraph, order: Sequence[int] | IndexArray) -> Network:
    """The network with the stops in an order (K,)."""
    nodes = graph.visits
    return graph.network([nodes[0], *(nodes[1 + k] for k in order), nodes[-1]])


class StopOrderSearch:
    """Search for the order of least value by lower bounds, with hits counted once.

    Split the ambusher's strategy into one share for each leg. A trip costs at least the sum of what
    its legs cost against their shares, whichever share belongs to which leg. So the shares found
    for one order, with its price of length, bound all orders.
    """

    def __init__(self, risk_map: RiskMap, graph: TripGraph, options: PlanningOptions,
                 progress: Progress) -> None:
        self._map, self._graph, self._options = risk_map, graph, options
        self._progress = progress
        self._deadline = time.monotonic() + options.strategy.time_limit
        self._ends = sorted(set(graph.visits))
        at = {node: k for k, node in enumerate(self._ends)}
        self._visits = np.array([at[node] for node in graph.visits])
        steps = graph.seconds
        if steps is None:
            tails, heads = graph.points[graph.edges[:, 0]], graph.points[graph.edges[:, 1]]
            steps = np.hypot(*(heads - tails).T)
        self._lengths = self._end_distances(graph.edges, steps, len(graph.points))

    def run(self) -> Planned:
        """Return the strategy, its order of stops, and 'best' or 'heuristic'."""
        count = len(self._visits) - 2
        few = count <= MAX_COMPARED
        orders = self._heuristic_order(count)[None]
        if few:
            orders = np.array(list(permutations(range(count))), dtype=np.int64)
        visits = self._visits[np.pad(orders + 1, ((0, 0), (1, 1)), constant_values=(0, count + 1))]
        legs = np.stack((visits[:, :-1], visits[:, 1:]))
        driven = (legs[0] != legs[1]).all(axis=1)
        if not driven.any():
            raise InvalidNetwork('two consecutive stops are at the same position')
        orders, legs = orders[driven], legs[:, driven]
        lengths = self._lengths[tuple(legs)].sum(axis=1)
        self._limit = self._options.strategy.max_detour * float(lengths.min())
        fits = lengths <= self._limit * (1.0 + ROUNDING)
        if np.isfinite(lengths).any():
            fits &= np.isfinite(lengths)
        orders, legs, lengths = orders[fits], legs[:, fits], lengths[fits]
        if not few:
            strategy = self._solve(orders[0])
            return Planned(strategy, tuple(orders[0].tolist()), 'heuristic')
        return self._best_order(orders, legs, lengths)

    def _best_order(self, orders: IndexArray, legs: IndexArray, lengths: FloatArray) -> Planned:
        """Solve the most promising order until no other can be better."""
        slack, bounds = self._options.strategy.slack, np.zeros(len(orders))
        left = np.ones(len(orders), dtype=bool)
        best: tuple[Strategy, tuple[int, ...]] | None = None
        while left.any():
            least = float(bounds[left].min())
            near = left & (bounds <= ceiling(least, slack))
            k = int(np.flatnonzero(near)[np.argmin(lengths[near])])
            left[k] = False
            try:
                strategy = self._solve(orders[k])
                if best is None or strategy.value < best[0].value * (1.0 - ROUNDING):
                    best = strategy, tuple(orders[k].tolist())
                enough = best[0].value * (1.0 - ROUNDING) / ceiling(1.0, slack)
                left &= bounds < enough
                bounds[left] = np.maximum(bounds[left],
                                          self._bounds(strategy, legs[:, left]))
                left &= bounds < enough
            except TimeLimit:
                if best is None:
                    raise
                return Planned(*best, 'heuristic')
        assert best is not None  # the shortest order fits its budget
        return Planned(*best, 'best')

    def within_budget(self, order: Sequence[int] | IndexArray) -> PlanningOptions:
        """The options with the detour of one order that is within the common budget."""
        visits = self._visits[[0, *(np.asarray(order, dtype=np.int64) + 1), -1]]
        detour = max(self._limit / float(self._lengths[visits[:-1], visits[1:]].sum()), 1.0)
        strategy = replace(self._options.strategy, max_detour=detour)
        return replace(self._options, strategy=strategy)

    def _solve(self, order: IndexArray) -> Strategy:
        """The strategy for one order, within the common budget."""
        if time.monotonic() > self._deadline:
            raise TimeLimit('the time limit passed before an order of the stops was solved')
        options = with_time(self.within_budget(order), self._deadline)
        return solve_on_network(self._map, in_order(self._graph, order), options,
                                progress=self._progress)

    def _bounds(self, strategy: Strategy, legs: IndexArray) -> FloatArray:
        """Bounds (K,) of orders with ``legs`` (2, K, L) by the ambusher against another one."""
        from scipy.optimize import linear_sum_assignment  # slow to load

        game, ambusher, price = strategy.game, strategy.ambusher, strategy.length_price
        waits = ambusher.q[None] if ambusher.by_leg is None else ambusher.by_leg
        q = np.array([game.at_sites(each) for each in waits])
        pairs = set(zip(*legs.reshape(2, -1).tolist(), strict=True))
        costs = self._leg_costs(game, q, price, pairs)
        by_order = np.moveaxis(costs[:, legs[0], legs[1]], 1, 0)
        best = [each[linear_sum_assignment(each, maximize=True)].sum() for each in by_order]
        return np.array(best) - (price * self._limit if price > 0.0 else 0.0)

    def _leg_costs(self, game: Game, q: FloatArray, price: float,
                   pairs: set[tuple[int, int]]) -> FloatArray:
        """Lower bounds (R, E, E) of what legs between pairs of ends cost by each share q (R, S).

        0 for other pairs. Raises TimeLimit.
        """
        network, costs = game.network, np.zeros((len(q), *self._lengths.shape))
        edges, once = network.places[network.edges], np.zeros(len(network.edges), dtype=bool)
        # Each place's edges cost the same in all layers, so one of them suffices.
        once[np.unique(edges @ (network.place_count, 1), return_index=True)[1]] = True
        drivable = Subnetwork(edges, once, game.entering, game.reach == 0.0)
        for begin, end in sorted(pairs):
            way = drivable.between(*(np.array([self._ends[k]]) for k in (begin, end)))
            for share, dual_weights in enumerate(q * game.loss[game.sites]):
                if time.monotonic() > self._deadline:
                    raise TimeLimit('the time limit passed before the orders were compared')
                costs[share, begin, end] = way.least_cost(
                    price * network.travel_costs, dual_weights, LEG_SEARCH)[0]
        return costs

    def _end_distances(self, edges: IndexArray, weights: FloatArray, count: int) -> FloatArray:
        """Lengths (E, E) between the ends: over the ground, if known, else on the network."""
        if self._graph.ground is not None:
            return np.array([[self._graph.ground.between(one, other) for other in self._ends]
                             for one in self._ends])
        rows = [distances_from(edges, weights, count, end)[self._ends] for end in self._ends]
        return np.asarray(rows)

    def _heuristic_order(self, count: int) -> IndexArray:
        """A short order of many stops: cheapest insertion, then 2-opt."""
        far = self._lengths[np.ix_(self._visits, self._visits)]
        tour = [0, count + 1]
        for stop in range(1, count + 1):
            added = [far[a, stop] + far[stop, b] - far[a, b] for a, b in pairwise(tour)]
            tour.insert(1 + int(np.argmin(added)), stop)
        shorter = True
        while shorter:
            shorter = False
            for i, j in combinations(range(1, count + 1), 2):
                other = [*tour[:i], *tour[i : j + 1][::-1], *tour[j + 1 :]]
                # On one-way roads, the reversed part has another length.
                if _tour_length(far, other) < _tour_length(far, tour) * (1.0 - ROUNDING):
                    tour, shorter = other, True
        return np.array(tour[1:-1]) - 1


def _tour_length(far: FloatArray, tour: list[int]) -> float:
    return float(far[tour[:-1], tour[1:]].sum())
