# SPDX-License-Identifier: Apache-2.0
"""Plans of trips: one strategy over all legs, with stops in the given, the best or a random order.

An ambush hits a trip once, on whichever legs it passes the site, so legs cannot be solved one by
one: the network has a layer for each leg, and one game covers all (``Network.legs``).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..errors import InvalidNetwork, InvalidOption, InvalidRiskMap, TimeLimit, warn
from ..game.search import Search
from ..game.value.routes import Progress, no_progress
from ..maps.obstacles import nearest_free_cell
from ..maps.risk_map import RiskMap
from ..network.construction import build_trip_graph
from ..network.network import Network
from ..network.trip_graph import TripGraph
from .concerns import concerns
from .few_routes import few_routes
from .options import PlanningOptions, grading, is_graded
from .path_mixtures import check_judged
from .plan import Plan, PlanRequest, make_plan
from .refinement import refine
from .solving import WarmStart, find_value_on, finish_on, solve_on_network, with_time
from .stop_order import Planned, StopOrderSearch, in_order

ORDERS = ('given', 'best', 'random')
# Largest number of stops for a random order: 24 orders.
MAX_RANDOM_STOPS = 4
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
    if not isinstance(options, PlanningOptions):
        raise InvalidOption(f'options must be PlanningOptions, got {type(options).__name__}; write '
                            'PlanningOptions(game=GameOptions(...))')
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
    begin = time.monotonic()
    place = _sorted_places(asked) if order == 'best' else list(range(len(asked)))
    trip = _Trip(risk_map, start_xy, goal_xy, [asked[k] for k in place], order, options, progress)
    strategy, chosen, found, done = trip.solve(warm, begin)
    made = make_plan(risk_map, strategy, options)
    return replace(made, seconds=time.monotonic() - begin,
                   order=tuple(place[k] for k in chosen), order_found=found, refinement=done)


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

    def solve(self, warm: WarmStart | None, begin: float) -> Planned:
        """The strategy on a network that is refined if it is graded."""
        first = warm.refined if warm else np.empty((0, 3))
        chosen, found, options = tuple(range(len(self.stops))), self.order, self.options
        end, best = begin + options.strategy.time_limit, None
        if self.order == 'best' and len(self.stops) > 1:
            ordered = ORDERED if is_graded(options) else 1.0
            rest = with_time(options, begin + ordered * options.strategy.time_limit)
            search = StopOrderSearch(self.risk_map, self.graph(first), rest, self.progress)
            best = search.run()
            if not is_graded(options):
                return best
            chosen, found = best.order, best.order_found
            warm, options = WarmStart.of(best.strategy), search.within_budget(chosen)
        if not is_graded(options):
            network = self.network(self.graph(first), chosen)
            strategy = solve_on_network(self.risk_map, network, with_time(options, end), warm,
                                        self.progress)
            return Planned(strategy, chosen, found)

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
        return Planned(strategy, chosen, found, rounds)

    def graph(self, refined: FloatArray) -> TripGraph:
        """The graph of drivable places with ``Network.refined`` (K, 3)."""
        return build_trip_graph(self.risk_map, self.start_xy, self.goal_xy, self.options.network,
                                self.stops, grading(self.risk_map, self.options, refined))

    def network(self, graph: TripGraph, chosen: Sequence[int]) -> Network:
        """The network with the stops in an order (K,), or in any if it is random."""
        return _in_any_order(graph) if self.order == 'random' else in_order(graph, chosen)


def plan_from_request(request: PlanRequest) -> Plan:
    """Convert the map, move a blocked goal within its tolerance, and plan.

    Raises InvalidRiskMap if the map is malformed, and the errors of ``plan_trip``.
    """
    risk_map, network = request.grid.risk_map(request.occupancy), request.options.network
    goal_xy = nearest_free_cell(risk_map, request.goal_xy, request.goal_tolerance,
                                network.clearance, network.clear_of_edge)
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
