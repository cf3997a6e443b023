"""Trips by way of stops: one strategy over all legs, in the given order of stops or in the best.

An ambush hits every leg that passes its site, so the legs cannot be solved one by one: a layer of
the network for each leg, and one game over all (``Network.legs``, ``Game.hits``). Arcs that are
used twice count twice as in M. Salani, G. Duyckaerts and P. G. Swartz, *Ambush avoidance in vehicle
routing for valuable delivery*, Journal of Transport Literature 4, 2010.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, permutations

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..errors import InvalidNetwork, InvalidOption, TimeLimit
from ..game.cut import solve_by_cut
from ..game.flow_program import at_most_one
from ..game.game import Game, make_game
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, TripGraph, build_trip_graph
from ..network.network import Network
from ..network.shortest_paths import distances_from
from .plan import (
    Plan,
    PlanningOptions,
    PlanRequest,
    WarmStart,
    plan_of,
    reach,
    read_request,
    strategy_on,
    with_cover,
)

ORDERS = ('given', 'best')
# All orders of so many stops are looked at: 5040.
MOST_STOPS = 7
# Lengths and values this near to each other, relative, are the same but for rounding.
ROUNDING = 1e-9

Position = tuple[float, float]


def plan_trip(
    risk_map: RiskMap,
    start_xy: npt.ArrayLike,
    goal_xy: npt.ArrayLike,
    options: PlanningOptions | None = None,
    *,
    stops: Iterable[npt.ArrayLike] = (),
    order: str = 'given',
    warm: WarmStart | None = None,
) -> Plan:
    """Plan a trip from start to goal by way of stops, all world positions [m].

    There is one strategy over all legs: the losses of a site add up over the legs that it hits,
    ``max_detour`` holds for the whole trip's expected length, value and certificate are those of
    the whole trip. Nobody can wait at a stop, nor within ``secured_radius`` or the ambush's reach
    of it, as at start and goal. A goal at the start's place makes a round trip.

    With the order 'best' that order is taken whose value is the least within the same budget:
    ``max_detour`` times the shortest way in any order. For up to ``MOST_STOPS`` stops no other
    order has a value that is better by more than the risk slack (``Plan.order_found`` is 'best');
    with more, or where the time limit passes, the order may be a worse one ('heuristic'): with
    more stops it is a short one. ``Plan.order`` tells which stop comes when. A ``warm`` start is
    for the given order.

    Raises
    ------
    InvalidOption
        There is no such order.
    StopBlocked
        A stop is off the map, or within the clearance of an obstacle. All else as ``plan``.
    """
    if order not in ORDERS:
        raise InvalidOption(f'order must be one of {", ".join(ORDERS)}, got {order!r}')
    options, begin = options or PlanningOptions(), time.monotonic()
    asked = list(stops)
    place = _sorted_places(asked) if order == 'best' else list(range(len(asked)))
    roads = build_trip_graph(
        risk_map, start_xy, goal_xy, options.network, [asked[k] for k in place]
    )
    chosen = tuple(range(len(asked)))
    found = order
    if order == 'given' or len(asked) < 2:
        strategy = strategy_on(risk_map, roads.network(roads.visits), options, warm)
    else:
        search = _OrderSearch(risk_map, roads, options)
        strategy, chosen, found = search.run()
    made = plan_of(risk_map, strategy, options, begin)
    return replace(
        made, order=tuple(place[k] for k in chosen), order_found=found,
        seconds=time.monotonic() - begin,
    )


def plan_from_request(request: PlanRequest) -> Plan:
    """Read the map, move a blocked goal as far as it may be, and plan.

    Raises
    ------
    InvalidRiskMap
        The map is malformed. All else as ``plan_trip`` raises it.
    """
    risk_map, goal_xy = read_request(request)
    return plan_trip(
        risk_map, request.start_xy, goal_xy, request.options, stops=request.stops_xy,
        order=request.order, warm=request.warm,
    )


def trip_network(
    risk_map: RiskMap, start_xy: Position, goal_xy: Position, options: NetworkOptions,
    visited: Sequence[Position], order: str,
) -> Network:
    """The network of a plan for stops that were ``visited`` one after the other."""
    places = _sorted_places(visited) if order == 'best' else list(range(len(visited)))
    roads = build_trip_graph(risk_map, start_xy, goal_xy, options, [visited[k] for k in places])
    nodes = roads.visits
    return roads.network([nodes[0], *(nodes[1 + k] for k in np.argsort(places)), nodes[-1]])


def _sorted_places(stops: Sequence[npt.ArrayLike]) -> list[int]:
    """The stops by their coordinates: the best order must not depend on the given one."""
    return sorted(range(len(stops)), key=lambda k: np.ravel(stops[k]).tolist())


@dataclass(frozen=True, eq=False)
class _Ambusher:
    """What any order costs at least: by the sites' prices between ends (E, E), less ``paid``."""

    costs: FloatArray
    paid: float

    def bounds(self, legs: IndexArray) -> FloatArray:
        """A lower bound (K,) for each order, by the ends of its ``legs`` (2, K, L)."""
        return self.costs[tuple(legs)].sum(axis=1) - self.paid


class _OrderSearch:
    """The order of least value, by bounds.

    Any ambusher's strategy q, with any price of length, makes each leg cost at least the cheapest
    route between its ends, and the sum over the legs bounds the value of that order from below.
    Those of the pairs' own cuts are known before anything is solved; those of the orders that have
    been solved are added.
    """

    def __init__(self, risk_map: RiskMap, roads: TripGraph, options: PlanningOptions) -> None:
        self._map, self._roads, self._options = risk_map, roads, options
        self._game = replace(options.game, ambush_radius=reach(risk_map, options))
        self._deadline = time.monotonic() + options.strategy.time_limit
        self._ends = sorted(set(roads.visits))
        at = {node: k for k, node in enumerate(self._ends)}
        self._visits = np.array([at[node] for node in roads.visits])
        both = np.concatenate((roads.pairs, roads.pairs[:, ::-1]))
        steps = np.hypot(*(roads.points[both[:, 1]] - roads.points[both[:, 0]]).T)
        self._lengths = self._between(both, steps, len(roads.points))

    def run(self) -> tuple[Strategy, tuple[int, ...], str]:
        """The strategy, its order of stops, and how that was found."""
        count = len(self._visits) - 2
        few = count <= MOST_STOPS
        orders = self._short_order(count)[None]
        if few:
            orders = np.array(list(permutations(range(count))), dtype=np.int64)
        visits = self._visits[np.pad(orders + 1, ((0, 0), (1, 1)), constant_values=(0, count + 1))]
        legs = np.stack((visits[:, :-1], visits[:, 1:]))
        driven = (legs[0] != legs[1]).all(axis=1)
        if not driven.any():
            raise InvalidNetwork('two of the stops are the same position, with nothing between')
        orders, legs = orders[driven], legs[:, driven]
        lengths = self._lengths[tuple(legs)].sum(axis=1)
        limit = self._options.strategy.max_detour * float(lengths.min())
        fits = lengths <= limit * (1.0 + ROUNDING)
        orders, legs, lengths = orders[fits], legs[:, fits], lengths[fits]
        if not few:
            strategy = self._solve(orders[0], float(lengths[0]), limit)
            return strategy, tuple(orders[0].tolist()), 'heuristic'
        return self._least(orders, legs, lengths, limit)

    def _least(
        self, orders: IndexArray, legs: IndexArray, lengths: FloatArray, limit: float
    ) -> tuple[Strategy, tuple[int, ...], str]:
        """Solve the order that promises most, until none is left that could be better."""
        slack = self._options.strategy.risk_slack
        network = with_cover(self._network(orders[0]), self._map, self._options)
        first = make_game(network, self._game)
        bounds = np.zeros(len(orders))
        for known in self._of_pairs(first):
            bounds = np.maximum(bounds, known.bounds(legs))
        left = np.ones(len(orders), dtype=bool)
        best: tuple[Strategy, tuple[int, ...]] | None = None
        while left.any():
            least = float(bounds[left].min())
            if best and least * (1.0 + slack) >= best[0].value * (1.0 - ROUNDING):
                break
            near = left & (bounds <= least * (1.0 + slack) + ROUNDING)
            k = int(np.flatnonzero(near)[np.argmin(lengths[near])])
            left[k] = False
            try:
                strategy = self._solve(orders[k], float(lengths[k]), limit)
            except TimeLimit:
                if best is None:
                    raise
                return *best, 'heuristic'
            if best is None or strategy.value < best[0].value * (1.0 - ROUNDING):
                best = strategy, tuple(orders[k].tolist())
            known = self._ambusher(
                strategy.game, strategy.ambush_probability, strategy.length_price, limit
            )
            bounds = np.maximum(bounds, known.bounds(legs))
        assert best is not None  # the shortest order fits its budget
        return *best, 'best'

    def _network(self, order: IndexArray) -> Network:
        nodes = self._roads.visits
        return self._roads.network([nodes[0], *(nodes[1 + k] for k in order), nodes[-1]])

    def _solve(self, order: IndexArray, length: float, limit: float) -> Strategy:
        """The strategy for one order, within the budget of all."""
        left = self._deadline - time.monotonic()
        if left <= 0.0:
            raise TimeLimit('time is up before an order of the stops was solved')
        detour = max(limit / length, 1.0)
        options = replace(self._options.strategy, max_detour=detour, time_limit=left)
        return strategy_on(
            self._map, self._network(order), replace(self._options, strategy=options)
        )

    def _of_pairs(self, game: Game) -> Iterable[_Ambusher]:
        """The ambushers of the minimum cuts between two ends: with a reach, they are only tried."""
        k = game.ambushers
        options = replace(self._game, ambush_radius=0.0, ambushers=1)
        for pair in combinations(self._ends, 2):
            cut = solve_by_cut(make_game(self._roads.network(pair), options))
            q = np.zeros(game.node_count)
            q[: len(cut.q)] = at_most_one(k * cut.q, k)
            yield self._ambusher(game, q)

    def _ambusher(
        self, game: Game, q: FloatArray, price: float = 0.0, limit: float = 0.0
    ) -> _Ambusher:
        network = game.network
        edges = network.places[network.edges]
        # Each place's edges once, from whichever layer: in all of them they cost the same.
        _, once = np.unique(edges[:, 0] * network.place_count + edges[:, 1], return_index=True)
        weights = game.mean_loss_on_edges(q) + price * network.lengths
        costs = self._between(edges[once], weights[once], network.place_count)
        return _Ambusher(costs, price * limit if price > 0.0 else 0.0)

    def _between(self, edges: IndexArray, weights: FloatArray, count: int) -> FloatArray:
        rows = [distances_from(edges, weights, count, end)[self._ends] for end in self._ends]
        return np.array(rows)

    def _short_order(self, count: int) -> IndexArray:
        """A short order of many stops: each put where it adds least, then parts turned round."""
        far = self._lengths[np.ix_(self._visits, self._visits)]
        tour = [0, count + 1]
        for stop in range(1, count + 1):
            added = [far[a, stop] + far[stop, b] - far[a, b] for a, b in pairwise(tour)]
            tour.insert(1 + int(np.argmin(added)), stop)
        shorter = True
        while shorter:
            shorter = False
            for i, j in combinations(range(1, count + 1), 2):
                before = far[tour[i - 1], tour[i]] + far[tour[j], tour[j + 1]]
                after = far[tour[i - 1], tour[j]] + far[tour[i], tour[j + 1]]
                if after < before * (1.0 - ROUNDING):
                    tour[i : j + 1] = tour[i : j + 1][::-1]
                    shorter = True
        return np.array(tour[1:-1]) - 1
