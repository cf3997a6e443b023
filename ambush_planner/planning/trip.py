# SPDX-License-Identifier: Apache-2.0
"""Plans of trips: one strategy over all legs.

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
from ..errors import InvalidOption, InvalidRiskMap, warn
from ..game.search import Search
from ..game.strategy import Strategy
from ..game.value.routes import Progress, no_progress
from ..maps.obstacles import nearest_free_cell
from ..maps.risk_map import RiskMap
from ..network.construction import build_trip_graph
from ..network.network import Network
from .concerns import concerns
from .few_routes import few_routes
from .options import PlanningOptions, grading, is_graded
from .path_mixtures import check_judged
from .plan import Plan, PlanRequest, make_plan
from .refinement import Round, refine
from .solving import WarmStart, find_value_on, finish_on, solve_on_network, with_time

# Share of the time left that a round of refinement may take.
ROUND = 0.6
# Share of the time limit for a plan whose routes then become a mixture of a few.
PLANNED = 0.7

Position = tuple[float, float]


def plan_trip(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
              options: PlanningOptions | None = None, *, stops: Iterable[npt.ArrayLike] = (),
              warm: WarmStart | None = None, routes: int | None = None,
              rng: np.random.Generator | int | None = None,
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
        World positions [m], in the order in which they are visited.
    warm
        A similar strategy to start the search from.
    routes, rng
        Departures draw from the best mixture found of at most so many routes: ``Plan.few``. ``rng``
        draws the candidates, or is a seed. The strategy then gets ``PLANNED`` of the time limit.
    progress
        Is called with the value and the lower bound so far; the value is ``inf`` before the first
        strategy.

    Returns
    -------
    Plan
        With ``value``, ``lower_bound`` and ``strategy``; it draws ``paths(n)``.

    Raises
    ------
    InvalidRiskMap, InvalidOption
        An argument is of the wrong kind or out of range.
    StartBlocked, StopBlocked, GoalBlocked
        A position is off the map or within the clearance of an obstacle.
    NoRoute, BudgetInfeasible
        No route leads from start to goal, or none within the budget.
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
    made = plan_quietly(risk_map, start_xy, goal_xy, quick, list(stops), warm, progress)
    if routes is not None:
        few = few_routes(made, routes, np.random.default_rng(rng), begin + limit)
        made = replace(made, options=options, few=few)
    for text in concerns(made):
        warn(text)
    return made


def plan_quietly(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                 options: PlanningOptions, stops: Sequence[npt.ArrayLike] = (),
                 warm: WarmStart | None = None,
                 progress: Progress = no_progress) -> Plan:
    """``plan_trip`` without its warnings."""
    if not isinstance(risk_map, RiskMap):
        raise InvalidRiskMap(f'plan_trip needs a RiskMap, got a {type(risk_map).__name__}; '
                             'read_risk_map reads one from a file')
    if not issubclass(type(options), PlanningOptions):
        kind = type(options).__name__
        field = kind.removesuffix('Options').lower()
        raise InvalidOption(f'options must be PlanningOptions, got {kind}; write '
                            f'PlanningOptions({field}={kind}(...))')
    begin = time.monotonic()
    trip = _Trip(risk_map, start_xy, goal_xy, stops, options, progress)
    strategy, rounds = trip.solve(warm, begin)
    made = make_plan(risk_map, strategy, options)
    return replace(made, seconds=time.monotonic() - begin, refinement=rounds)


@dataclass(frozen=True)
class _Trip:
    """A trip on a map with its stops."""

    risk_map: RiskMap
    start_xy: npt.ArrayLike
    goal_xy: npt.ArrayLike
    stops: Sequence[npt.ArrayLike]
    options: PlanningOptions
    progress: Progress

    def solve(self, warm: WarmStart | None, begin: float) -> tuple[Strategy, tuple[Round, ...]]:
        """The strategy, and the rounds in which its network was refined, if it is graded."""
        first, options = warm.refined if warm else np.empty((0, 3)), self.options
        end = begin + options.strategy.time_limit
        if not is_graded(options):
            strategy = solve_on_network(self.risk_map, self.network(first),
                                        with_time(options, end), warm, self.progress)
            return strategy, ()

        def value_on(similar: WarmStart | None) -> Search:
            network = self.network(similar.refined if similar else first)
            rest = with_time(options, time.monotonic() + ROUND * (end - time.monotonic()))
            return find_value_on(self.risk_map, network, rest, similar, self.progress)

        refined, rounds = refine(value_on, self.risk_map, options, warm)
        return finish_on(refined, options, end), rounds

    def network(self, refined: FloatArray) -> Network:
        """The network with ``Network.refined`` (K, 3)."""
        graph = build_trip_graph(self.risk_map, self.start_xy, self.goal_xy, self.options.network,
                                 self.stops, grading(self.risk_map, self.options, refined))
        return graph.network(graph.visits)


def plan_from_request(request: PlanRequest) -> Plan:
    """Convert the map, move a blocked goal within its tolerance, and plan.

    Raises InvalidRiskMap if the map is malformed, and the errors of ``plan_trip``.
    """
    risk_map, network = request.grid.risk_map(request.occupancy), request.options.network
    goal_xy = nearest_free_cell(risk_map, request.goal_xy, request.goal_tolerance,
                                network.clearance, network.clear_of_edge)
    made = plan_quietly(risk_map, request.start_xy, goal_xy, request.options, request.stops_xy,
                        request.warm)
    return replace(made, risk_map=None)  # too large to send to another process


def trip_network(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                 options: PlanningOptions, stops: Sequence[npt.ArrayLike],
                 refined: FloatArray) -> Network:
    """The network of a plan with its stops as in ``Plan.stops_xy`` and ``Network.refined``."""
    return _Trip(risk_map, start_xy, goal_xy, stops, options, no_progress).network(refined)
