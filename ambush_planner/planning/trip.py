# SPDX-License-Identifier: Apache-2.0
"""Plans of trips: one strategy over all legs, with stops in the given, the best or a random order.

An ambush hits a trip once, on whichever legs it passes the site, so legs cannot be solved one by
one: the network has a layer for each leg, and one game covers all (``Network.legs``).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, permutations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import ROUNDING, FloatArray, IndexArray
from ..errors import InvalidNetwork, InvalidOption, InvalidRiskMap, NoRoute, TimeLimit, warn
from ..game.ambusher import capped_at_one
from ..game.certificate.best_response import Subnetwork
from ..game.game import Game, make_game
from ..game.search import Search
from ..game.slack import ceiling
from ..game.strategy import Strategy
from ..game.value.cut import solve_by_min_cut
from ..game.value.routes import LEG_SEARCH, Progress, no_progress
from ..maps.risk_map import RiskMap
from ..network.construction import build_trip_graph
from ..network.network import Network
from ..network.shortest_paths import distances_from
from ..network.trip_graph import TripGraph
from .concerns import concerns
from .few_routes import few_routes
from .options import PlanningOptions, grading, is_graded, solved_game
from .path_mixtures import check_judged
from .plan import Plan, PlanRequest, make_plan, risk_map_and_goal
from .refinement import Round, refine
from .solving import WarmStart, find_value_on, finish_on, solve_on_network

ORDERS = ('given', 'best', 'random')
# Largest number of stops for which all orders (5040) are compared, and for a random order (24).
MAX_COMPARED, MAX_RANDOM_STOPS = 7, 4
# Share of the time limit for the best order, if its network is then refined; and share of the time
# left that a round of refinement may take.
ORDERED, ROUND = 0.6, 0.6
# Share of the time limit for a plan whose routes then become a mixture of a few.
PLANNED = 0.7

Position = tuple[float, float]


def plan_trip(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
              options: PlanningOptions | None = None, *, stops: Iterable[npt.ArrayLike] = (),
              order: str = 'given', warm: WarmStart | None = None, routes: int | None = None,
              equal: bool = False, rng: np.random.Generator | int | None = None,
              progress: Progress = no_progress) -> Plan:
    """Plan a trip from start to goal through stops.

    One strategy covers all legs: value, certificate and ``max_detour`` are those of the whole trip.
    Nobody can wait at start, goal or a stop, nor within ``secured_radius`` of them.

    Parameters
    ----------
    risk_map
        The losses and obstacles.
    start_xy, goal_xy
        World positions [m]; a goal at the start's position makes a round trip.
    options
        Network, game, strategy and how routes become paths.
    stops
        World positions [m].
    order
        'given', or 'best': the order of least value within the budget of ``max_detour`` times the
        shortest way in any order. For up to ``MAX_COMPARED`` stops, no other order is better by
        more than the risk slack, with hits counted once (``Plan.order_found`` is 'best'). With
        more stops, or if the time limit passes, the order is a short one or the best so far
        ('heuristic'). Or 'random', for up to ``MAX_RANDOM_STOPS`` stops: the order is drawn with
        the route, so its value is at most that of the best order within the same budget.
    warm
        A similar strategy to start the search from, for the given order only.
    routes, equal, rng
        Departures draw from the best mixture found of at most so many routes, or of as many with
        ``equal`` shares: ``Plan.few``. ``rng`` draws the candidates, or is a seed. The strategy
        then gets ``PLANNED`` of the time limit.
    progress
        Is called with the value and the lower bound so far; the value is ``inf`` before the first
        strategy.

    Returns
    -------
    Plan
        With ``value``, ``lower_bound``, ``strategy`` and ``order``; it draws ``paths(n)``.

    Raises
    ------
    InvalidRiskMap, InvalidOption
        An argument is of the wrong kind or out of range.
    StartBlocked, StopBlocked, GoalBlocked
        A position is off the map or within the clearance of an obstacle.
    NoRoute, BudgetInfeasible
        No route leads from start to goal, or none within the budgets.
    TimeLimit
        The time limit passed before the gap was at most ``max_gap``, or before a mixture of few
        routes was found; it has the best ``strategy``.

    Warns
    -----
    AmbushPlannerWarning
        What limits the value: the gap of value and lower bound is larger than the risk slack, the
        value is 0, or a single place hits every route. The texts are the command's.

    Examples
    --------
    >>> import numpy as np
    >>> from ambush_planner import GameOptions, NetworkOptions, PlanningOptions, RiskMap, plan_trip
    >>> risk_map = RiskMap(np.ones((12, 24)), np.zeros((12, 24), bool), resolution=1.0)
    >>> options = PlanningOptions(network=NetworkOptions(spacing=2.0),
    ...                           game=GameOptions(ambush_radius=1.0))
    >>> plan = plan_trip(risk_map, (2.0, 6.0), (22.0, 6.0), options)
    >>> plan.lower_bound <= plan.value <= 1.0101 * plan.lower_bound
    True
    >>> path = plan.paths(1)[0]  # x, y [m] and yaw [rad], drawn by the operating system's entropy
    >>> path[0, :2].tolist(), path[-1, :2].tolist()
    ([2.0, 6.0], [22.0, 6.0])
    """
    options = options or PlanningOptions()
    if routes is not None:
        check_judged(options.game)
    begin, limit, quick = time.monotonic(), options.strategy.time_limit, options
    if routes is not None:
        quick = with_time(options, begin + PLANNED * limit)
    made = plan_quietly(risk_map, start_xy, goal_xy, quick, list(stops), order, warm, progress)
    if routes is not None:
        few = few_routes(made, routes, equal, np.random.default_rng(rng), begin + limit)
        made = replace(made, options=options, few=few)
    for text in concerns(made):
        warn(text)
    return made


def plan_quietly(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                 options: PlanningOptions, asked: Sequence[npt.ArrayLike] = (),
                 order: str = 'given', warm: WarmStart | None = None,
                 progress: Progress = no_progress) -> Plan:
    """``plan_trip`` without its warnings."""
    if order not in ORDERS:
        raise InvalidOption(f'order must be one of {", ".join(ORDERS)}, got {order!r}')
    if not isinstance(risk_map, RiskMap):
        raise InvalidRiskMap(f'plan_trip needs a RiskMap, got a {type(risk_map).__name__}; '
                             'read_risk_map reads one from a file')
    if not issubclass(type(options), PlanningOptions):
        kind = type(options).__name__
        field = kind.removesuffix('Options').lower()
        raise InvalidOption(f'options must be PlanningOptions, got {kind}; write '
                            f'PlanningOptions({field}={kind}(...))')
    if options.game.loads and order != 'given':
        raise InvalidOption(f"loads belong to legs, so order must be 'given', got {order!r}")
    begin = time.monotonic()
    place = _sorted_places(asked) if order == 'best' else list(range(len(asked)))
    trip = _Trip(risk_map, start_xy, goal_xy, [asked[k] for k in place], order, options, progress)
    strategy, chosen, found, done = trip.solve(warm, begin)
    made = make_plan(risk_map, strategy, options, begin)
    return replace(made, order=tuple(place[k] for k in chosen), order_found=found, refinement=done)


class _Planned(NamedTuple):
    """A strategy, the order of its stops, how that was found, and the rounds of refinement."""

    strategy: Strategy
    order: tuple[int, ...]
    order_found: str
    rounds: tuple[Round, ...] = ()


@dataclass(frozen=True)
class _Trip:
    """A trip on a map with its stops."""

    risk_map: RiskMap
    start_xy: npt.ArrayLike
    goal_xy: npt.ArrayLike
    stops: list[npt.ArrayLike]
    order: str
    options: PlanningOptions
    progress: Progress

    def solve(self, warm: WarmStart | None, begin: float) -> _Planned:
        """The strategy on a network that is refined if it is graded."""
        first = warm.refined if warm else np.empty((0, 3))
        chosen, found, options = tuple(range(len(self.stops))), self.order, self.options
        end, best = begin + options.strategy.time_limit, None
        if self.order == 'best' and len(self.stops) > 1:
            ordered = ORDERED if is_graded(options) else 1.0
            rest = with_time(options, begin + ordered * options.strategy.time_limit)
            search = _StopOrderSearch(self.risk_map, self.graph(first), rest, self.progress)
            best = search.run()
            if not is_graded(options):
                return best
            chosen, found = best.order, best.order_found
            warm, options = WarmStart.of(best.strategy), search.within_budget(chosen)
        if not is_graded(options):
            network = self.network(self.graph(first), chosen)
            strategy = solve_on_network(self.risk_map, network, with_time(options, end), warm,
                                        self.progress)
            return _Planned(strategy, chosen, found)

        def value_on(similar: WarmStart | None) -> Search:
            graph = self.graph(similar.refined if similar else first)
            rest = with_time(options, time.monotonic() + ROUND * (end - time.monotonic()))
            return find_value_on(self.risk_map, self.network(graph, chosen), rest, similar,
                                 self.progress)

        try:
            refined, rounds = refine(value_on, self.risk_map, options, warm)
            strategy = finish_on(refined, options, end)
        except TimeLimit:
            if best is None:
                raise
            return best
        if best and best.strategy.value <= strategy.value:
            return best
        return _Planned(strategy, chosen, found, rounds)

    def graph(self, refined: FloatArray) -> TripGraph:
        """The graph of drivable places with ``Network.refined`` (K, 3)."""
        return build_trip_graph(self.risk_map, self.start_xy, self.goal_xy, self.options.network,
                                self.stops, grading(self.risk_map, self.options, refined))

    def network(self, graph: TripGraph, chosen: Sequence[int]) -> Network:
        """The network with the stops in an order (K,), or in any if it is random."""
        return _in_any_order(graph) if self.order == 'random' else _in_order(graph, chosen)


def with_time(options: PlanningOptions, end: float) -> PlanningOptions:
    """The options with the time limit at ``end`` (``time.monotonic``), or next to nothing."""
    left = max(end - time.monotonic(), 1e-6)
    return replace(options, strategy=replace(options.strategy, time_limit=left))


def plan_from_request(request: PlanRequest) -> Plan:
    """Convert the map, move a blocked goal within its tolerance, and plan.

    Raises InvalidRiskMap if the map is malformed, and the errors of ``plan_trip``.
    """
    risk_map, goal_xy = risk_map_and_goal(request)
    made = plan_quietly(risk_map, request.start_xy, goal_xy, request.options, request.stops_xy,
                        request.order, request.warm)
    return replace(made, risk_map=None)  # too large to send to another process


def trip_network(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                 options: PlanningOptions, visited: Sequence[npt.ArrayLike], order: str,
                 refined: FloatArray) -> Network:
    """The network of a plan with its stops as in ``Plan.stops_xy`` and ``Network.refined``."""
    places = _sorted_places(visited) if order == 'best' else list(range(len(visited)))
    trip = _Trip(risk_map, start_xy, goal_xy, [visited[k] for k in places], order, options,
                 no_progress)
    return trip.network(trip.graph(refined), np.argsort(places).tolist())


def _in_order(graph: TripGraph, order: Sequence[int] | IndexArray) -> Network:
    """The network with the stops in an order (K,)."""
    nodes = graph.visits
    return graph.network([nodes[0], *(nodes[1 + k] for k in order), nodes[-1]])


def _in_any_order(graph: TripGraph) -> Network:
    source, *stops, target = graph.visits
    if len(stops) > MAX_RANDOM_STOPS:
        raise InvalidOption(f"order 'random' takes at most {MAX_RANDOM_STOPS} stops, got "
                            f'{len(stops)}')
    if len({source, target, *stops}) < len({source, target}) + len(stops):
        raise InvalidNetwork("with order 'random', no stop may be at the position of another one, "
                             'of the start or of the goal')
    return graph.network_in_any_order()


def _sorted_places(stops: Sequence[npt.ArrayLike]) -> list[int]:
    """Indices of the stops by coordinates, so that the best order is independent of the given."""
    return sorted(range(len(stops)), key=lambda k: np.ravel(stops[k]).tolist())


class _StopOrderSearch:
    """Search for the order of least value by lower bounds, with hits counted once.

    Split the ambusher's strategy into one share for each leg. A trip costs at least the sum of what
    its legs cost against their shares, whichever share belongs to which leg. So the shares found
    for one order, with its price of length, bound all orders. The first bounds come from minimum
    cuts between pairs of ends: every trip drives from one end to all later ones.
    """

    def __init__(self, risk_map: RiskMap, graph: TripGraph, options: PlanningOptions,
                 progress: Progress) -> None:
        self._map, self._graph, self._options = risk_map, graph, options
        self._progress = progress
        self._game = solved_game(risk_map, options)
        self._deadline = time.monotonic() + options.strategy.time_limit
        self._ends = sorted(set(graph.visits))
        at = {node: k for k, node in enumerate(self._ends)}
        self._visits = np.array([at[node] for node in graph.visits])
        steps = graph.seconds
        if steps is None:
            tails, heads = graph.points[graph.edges[:, 0]], graph.points[graph.edges[:, 1]]
            steps = np.hypot(*(heads - tails).T)
        self._lengths = self._end_distances(graph.edges, steps, len(graph.points))

    def run(self) -> _Planned:
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
            return _Planned(strategy, tuple(orders[0].tolist()), 'heuristic')
        return self._best_order(orders, legs, lengths)

    def _best_order(self, orders: IndexArray, legs: IndexArray, lengths: FloatArray) -> _Planned:
        """Solve the most promising order until no other can be better."""
        slack, bounds = self._options.strategy.slack, self._cut_bounds(orders, legs)
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
                return _Planned(*best, 'heuristic')
        assert best is not None  # the shortest order fits its budget
        return _Planned(*best, 'best')

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
        return solve_on_network(self._map, _in_order(self._graph, order), options,
                                progress=self._progress)

    def _cut_bounds(self, orders: IndexArray, legs: IndexArray) -> FloatArray:
        """Bounds (K,) from the minimum cuts between pairs of ends; 0 with a reach."""
        costs, bounds = np.zeros(self._lengths.shape), np.zeros(len(orders))
        if self._game.reach > 0.0:
            return bounds
        game, k = make_game(_in_order(self._graph, orders[0]), self._game), self._game.ambushers
        options = replace(self._game, ambushers=1)
        for pair in permutations(range(len(self._ends)), 2):
            try:
                between = self._graph.network([self._ends[end] for end in pair])
                cut = solve_by_min_cut(make_game(between, options))
            except NoRoute:  # one-way roads
                continue
            q = np.zeros(game.node_count)
            q[: len(cut.q)] = capped_at_one(k * cut.q, k)
            costs[pair] = self._leg_costs(game, game.at_sites(q)[None], 0.0, {pair})[0][pair]
        visits = np.column_stack((legs[0], legs[1, :, -1]))
        for i, j in combinations(range(visits.shape[1]), 2):
            bounds = np.maximum(bounds, costs[visits[:, i], visits[:, j]])
        return bounds

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
        drivable = Subnetwork(edges, once, game.hits, game.reach == 0.0)
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
