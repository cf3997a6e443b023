# SPDX-License-Identifier: Apache-2.0
"""Plans of trips: a strategy for each leg, drawn independently, against one ambusher.

Planning is anytime: the plan of the first network is finished first, and that of a refined network
replaces it only when it is finished as well and has a lower value.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .. import plan_methods
from ..arrays import FloatArray, single_thread
from ..errors import AmbushPlannerError, InvalidOption, InvalidRiskMap, TimeLimit, warn
from ..game.revaluation import open_gap
from ..game.search import Progress, Search, no_progress
from ..game.strategy import TripStrategy
from ..maps.obstacles import nearest_free_cell
from ..maps.risk_map import RiskMap
from ..network.construction import build_trip_graph
from ..network.network import Network
from .concerns import concerns
from .options import PlanningOptions, grading, is_graded
from .plan import Plan, PlanRequest, gap_is_wide, make_plan
from .refinement import Round, refine
from .solving import Ground, WarmStart

# Share of the time limit after which no round of refinement begins, and share of the time left that
# a round may take.
REFINED_BY, ROUND = 0.4, 0.6
# Share of the time limit reserved for the corridors of the first plan. For those of another plan, a
# multiple of the time that these took is reserved, and at least a time [s].
RESERVE, RESERVED, MIN_RESERVE = 0.1, 2.0, 0.1
# Share of the time limit for a plan from which few routes are then chosen.
PLANNED = 0.7
# Stands for an infinite time limit [s], so that shares of it can be taken.
LONGEST = 1e9

Position = tuple[float, float]
# Called with each finished plan.
Finished = Callable[[Plan], None]


def ignore_plan(plan: Plan) -> None:
    """Ignore a finished plan."""


def plan_trip(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
              options: PlanningOptions | None = None, *, stops: Iterable[npt.ArrayLike] = (),
              warm: WarmStart | None = None, routes: int | None = None,
              rng: np.random.Generator | int | None = None,
              progress: Progress = no_progress) -> Plan:
    """Plan a trip from start to goal through stops.

    The route of each leg is drawn independently, within ``max_detour`` times the leg's shortest
    way. One ambusher waits at one place for the whole trip, and hits every leg that passes: the
    value is the largest mean loss at a place, summed over the legs. Nobody can wait at start, goal
    or a stop, nor within ``secured_radius`` of them.

    Parameters
    ----------
    risk_map
        The losses and obstacles.
    start_xy, goal_xy
        World positions [m]; a goal at the start's position makes a round trip.
    options
        Options of the network, the game, the strategy and the driven path.
    stops
        World positions [m], in the order in which they are visited.
    warm
        A similar strategy to start the search from.
    routes, rng
        Departures are drawn from a mixture of at most this number of routes a leg (``Plan.few``).
        ``rng``, a generator or a seed, draws the candidates. The strategy then gets ``PLANNED`` of
        the time.
    progress
        Called with the phase in words, and the value of the finished plan, ``inf`` if there is
        none.

    Returns
    -------
    Plan
        With ``value``, ``lower_bound`` and a strategy for each of the ``legs``; ``paths(n)`` draws
        routes.

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
        The gap is larger than the risk slack, the value is 0, or a single place hits every route.
        The command prints the same sentences.

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
    stops = list(stops)
    if routes is not None:
        plan_methods.check_few_routes(options)
    end = time.monotonic() + options.strategy.time_limit
    share = PLANNED if routes is not None else 1.0
    made = plan_quietly(risk_map, start_xy, goal_xy, options, stops, warm, progress, share)
    if routes is not None:
        progress('choosing a few routes', made.value)
        made = replace(made, few=plan_methods.few_routes(made, routes, rng, end))
    for text in concerns(made):
        warn(text)
    return made


def plan_quietly(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                 options: PlanningOptions, stops: Sequence[npt.ArrayLike] = (),
                 warm: WarmStart | None = None, progress: Progress = no_progress,
                 share: float = 1.0, finished: Finished = ignore_plan) -> Plan:
    """Plan as ``plan_trip``, without its warnings, in a ``share`` of the time limit.

    ``finished`` is called with each finished plan; values fall.
    """
    if not isinstance(risk_map, RiskMap):
        raise InvalidRiskMap(f'plan_trip needs a RiskMap, got a {type(risk_map).__name__}; '
                             'read_risk_map reads one from a file')
    if not issubclass(type(options), PlanningOptions):
        kind = type(options).__name__
        field = kind.removesuffix('Options').lower()
        raise InvalidOption(f'options must be PlanningOptions, got {kind}; write '
                            f'PlanningOptions({field}={kind}(...))')
    begin = time.monotonic()
    trip = Trip(risk_map, start_xy, goal_xy, stops, options)
    with single_thread():
        return _plan_in_time(trip, warm, progress, begin,
                             begin + share * min(options.strategy.time_limit, LONGEST), finished)


def _plan_in_time(trip: Trip, warm: WarmStart | None, progress: Progress, begin: float, end: float,
                  finished: Finished) -> Plan:
    """Find the best plan that is finished by ``end`` (``time.monotonic``)."""
    options, reserve = trip.options, RESERVE * (end - begin) if end < np.inf else 0.0
    ground = Ground.of(trip.risk_map, options)
    progress('solving the game', np.inf)
    strategy = ground.solve(trip.networks(None), end - reserve, warm)
    solved = time.monotonic()
    best = make_plan(trip.risk_map, strategy, options, begin)
    reserve = max(RESERVED * (time.monotonic() - solved), MIN_RESERVE)
    finished(best)
    if not is_graded(options) or time.monotonic() + reserve > end:
        return _within_max_gap(best)

    def find_value(similar: WarmStart | None) -> Search:
        assert similar is not None
        now = time.monotonic()
        return ground.find_value(trip.networks(similar.refined),
                                 now + ROUND * (end - reserve - now), similar)

    known = warm.refined if warm and warm.refined is not None else np.empty((0, 3))
    latest = begin + REFINED_BY * (end - begin)
    search, rounds = refine(find_value, ground, WarmStart.of(strategy, known), latest,
                            end - reserve, progress, best.value)
    rounds = (Round(len(best.network.points), best.value, best.seconds), *rounds)
    if search is not None and search.program.value < best.value:
        progress('drawing the routes of the refined network', best.value)
        reserve *= max(search.legs.games[0].node_count / best.trip.game.node_count, 1.0)
        with contextlib.suppress(AmbushPlannerError):  # then the best plan is the first one
            refined = ground.finish(search, end - reserve)
            # However wide a gap the caller accepts, a certified plan is not given up for one.
            usual = replace(options, max_gap=min(options.max_gap, PlanningOptions.max_gap))
            if refined.value < best.value and not _gap_is_open(refined, usual):
                best = make_plan(trip.risk_map, refined, options, begin)
                finished(best)
    return _within_max_gap(replace(best, refinement=rounds))


def _within_max_gap(plan: Plan) -> Plan:
    """Return the plan; raise TimeLimit if the time limit left a gap over ``max_gap``."""
    if not _gap_is_open(plan.trip, plan.options):
        return plan
    gap = open_gap(plan.trip, plan.options.strategy)
    raise TimeLimit(f'after {plan.options.strategy.time_limit:.3g} s the strategy may be '
                    f'{gap / plan.trip.value:.2g} of its value from the best, more than max_gap '
                    f'{plan.options.max_gap:g}; allow more time, or choose a larger spacing',
                    plan.legs[0])


def _gap_is_open(trip: TripStrategy, options: PlanningOptions) -> bool:
    """Return whether the time limit left a gap over ``max_gap``."""
    return trip.reason == 'time' and gap_is_wide(trip, options)


@dataclass(frozen=True)
class Trip:
    """A trip on a map, for which networks can be built."""

    risk_map: RiskMap
    start_xy: npt.ArrayLike
    goal_xy: npt.ArrayLike
    stops: Sequence[npt.ArrayLike]
    options: PlanningOptions

    def networks(self, refined: FloatArray | None) -> tuple[Network, ...]:
        """Build the networks of the legs with ``Network.refined`` (K, 3); None: the first ones."""
        return build_trip_graph(self.risk_map, self.start_xy, self.goal_xy, self.options.network,
                                self.stops, grading(self.risk_map, self.options, refined)
                                ).networks()


def plan_from_request(request: PlanRequest, finished: Finished = ignore_plan) -> Plan:
    """Convert the map, move a blocked goal within its tolerance, and plan.

    ``finished`` is called with the first plan, if the request wants one. Raises InvalidRiskMap if
    the map is malformed, and the errors of ``plan_trip``.
    """
    risk_map, network = request.grid.risk_map(request.occupancy), request.options.network
    goal_xy = nearest_free_cell(risk_map, request.goal_xy, request.goal_tolerance,
                                network.clearance, network.clear_of_edge)
    warm = request.warm
    for options in (request.first, request.options):
        if options is None:
            continue
        made = plan_quietly(risk_map, request.start_xy, goal_xy, options, request.stops_xy, warm)
        made = replace(made, risk_map=None)  # too large to send to another process
        if options is request.first:
            finished(made)
            warm = WarmStart.of(made.trip)
    return made
