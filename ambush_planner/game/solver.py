# SPDX-License-Identifier: Apache-2.0
"""Solve the game: the least value within the budget, then the most unpredictable routes.

One of three linear programs (LPs) finds the least value (``value``): a cut without a reach if its
flow keeps the budget, or nearly; face potentials on a planar network whose links cost the same
both ways; whole routes otherwise. A search makes a strategy of it: a chain (``chain_search``), or
one on a layered graph (``trip_search``) on a trip, or if a chain costs more than whole routes. The
paper's linear programs are another choice.
"""

from __future__ import annotations

import time

import numpy as np

from ..errors import InvalidNetwork, TimeLimit, warn
from ..maps.risk_map import MAX_LOSS, MIN_LOSS
from ..network.network import Network
from .budget import Budget
from .chain_search import find_chain, find_flow
from .faces import make_faces
from .game import Game, GameOptions, make_game
from .search import Search, SearchProblem, SiteSearch
from .slack import MIN_SLACK
from .strategy import Strategy, StrategyOptions
from .trip_search import find_legs, find_mixture, find_trip
from .value.cut import Cut
from .value.linear_program import linear_program_strategy
from .value.potential import Potential
from .value.routes import Progress, Routes, no_progress

# Optimality gaps of an LP in potentials, and of one over routes [slacks].
POTENTIAL_GAP, ROUTES_GAP = 0.1, 0.3
# Largest share by which the flow of a cut exceeds the budget if a distribution is sought around it,
# which then keeps it in nearly all games, without a loss of entropy.
MAX_OVERRUN = 0.07
# Cap at which an LP in potentials begins, as a multiple of the value without a budget.
FIRST_CAP = 2.0
# A search ends before its time limit by a share of it or by a time [s], whichever is less. Its
# judge, which takes seconds on a trip, ends by half of the first share or time after the limit,
# whichever is greater.
RESERVE, RESERVE_ON_TRIPS = (0.05, 1.0), (0.15, 30.0)
# Share of the routes from which an ambush that hits them hits all, up to the slack.
ALL_ROUTES = 1.0 - StrategyOptions.risk_slack


def solve(network: Network, game: GameOptions | None = None,
          options: StrategyOptions | None = None) -> Strategy:
    """Find the convoy's optimal mixed strategy on a network; its value is at the network's nodes.

    ``plan_trip`` also considers ambushers between the nodes, the driven paths and the secured area.

    Parameters
    ----------
    network
        As ``build_network`` makes it, or any other.
    game
        What the ambusher can do.
    options
        The budget, the solver, the time limit.

    Returns
    -------
    Strategy
        With its value, its lower bound and the ambusher who proves it.

    Raises
    ------
    InvalidNetwork
        A loss is too large or too small to compute with.
    NoRoute
        No route leads from the source to the target.
    BudgetInfeasible
        Every playable route is longer than the budget.
    TimeLimit
        The time limit passed before the value was within the slack of its bound; the error's
        ``strategy`` is the best so far.

    Examples
    --------
    Two ways, past losses of 1 and 3: the ambusher gains most if both cost the same.

    >>> from ambush_planner import Network, StrategyOptions, solve
    >>> network = Network(points=[(0, 0), (1, 1), (1, -1), (2, 0)], alpha=[0, 1, 3, 0],
    ...                   edges=[(0, 1), (0, 2), (1, 3), (2, 3)], source=0, target=3)
    >>> strategy = solve(network, options=StrategyOptions(risk_slack=0.0))
    >>> round(strategy.value, 3), strategy.edge_probability.round(2).tolist()
    (0.75, [0.75, 0.25, 0.75, 0.25])
    """
    if not isinstance(network, Network):
        raise InvalidNetwork(f'solve needs a Network, got a {type(network).__name__}; '
                             'build_network makes one of a RiskMap, and plan_trip does it all')
    found = solve_game(make_game(network, game or GameOptions()), options or StrategyOptions())
    loss = found.game.loss
    certain = (found.ambush_probability > 0.0) & (ALL_ROUTES * loss <= found.value) & (loss > 0.0)
    if not found.value > 0.0:
        warn('the value is 0: some routes pass no ambush that causes a loss; check alpha and the '
             'secured area (secured_radius)')
    elif found.reason == 'complete' and certain.any():
        warn(f'an ambush at node {int(certain.argmax())} hits every route: it always succeeds and '
             f'costs {found.value:.4g}')
    return found


def solve_game(game: Game, options: StrategyOptions, site_search: SiteSearch | None = None,
               progress: Progress = no_progress) -> Strategy:
    """Find the optimal strategy against an ambusher at a game's sites and those of ``site_search``.

    Raises the errors of ``solve``.
    """
    if options.solver != 'max_entropy':
        _check_losses(game.network)
        deadline = time.monotonic() + options.time_limit
        return linear_program_strategy(game, options, Budget.length(game, options.max_detour),
                                       deadline)
    problem = make_problem(game, options, site_search, progress)
    return _in_time(_most_unpredictable(problem), options)


def make_problem(game: Game, options: StrategyOptions, site_search: SiteSearch | None = None,
                 progress: Progress = no_progress) -> SearchProblem:
    """What 'max_entropy' searches, from now to its time limit; raises the errors of ``solve``."""
    _check_losses(game.network)
    deadline, judged = _search_ends(time.monotonic() + options.time_limit, options,
                                    game.network)
    return SearchProblem(game, Budget.length(game, options.max_detour), options.risk_slack,
                         deadline, site_search, progress, judged)


def finish(search: Search, options: StrategyOptions, end: float) -> Strategy:
    """The strategy of a search whose value has been found, by ``end``; raises TimeLimit."""
    search.go_on_until(*_search_ends(end, options, search.problem.game.network))
    return _in_time(_find_distribution(search), options)


def find_value(problem: SearchProblem, overrun: float = 0.0) -> Search:
    """Find the least value within the budget, and an ambusher who nearly proves it.

    A cut's flow may exceed the budget by the share ``overrun``: its value is then a lower bound.
    """
    slack = max(problem.slack, MIN_SLACK)
    if problem.game.network.legs > 1:
        routes = _routes(problem, slack, _potential(problem, slack))
        search = Search(problem, routes, slack)
        (find_legs if routes.planar else find_mixture)(search, routes)
        return search
    cut = Cut(problem.game, problem.budget) if problem.game.entries_are_hits else None
    if cut and cut.overrun <= overrun:
        return Search(problem, cut, slack)
    first = FIRST_CAP * cut.bound if cut else np.inf
    search = Search(problem, _potential(problem, slack, first)
                    or _routes(problem, slack, None), slack)
    find_flow(search)
    return search


def _most_unpredictable(problem: SearchProblem) -> Strategy:
    """Find value and route distribution; at the deadline, the best strategy so far is returned.

    Raises BudgetInfeasible if no strategy is within the budget.
    """
    search = find_value(problem, MAX_OVERRUN)
    if not isinstance(search.lp, Cut):
        return _find_distribution(search)
    chain, found = find_chain(search), None
    if chain or problem.budget.keeps(search.lp.flow):
        found = search.strategy(chain)
        if found.reason == 'complete' or problem.late:
            return found
    # All distributions near the cut's flow exceed the budget, or cost more.
    other = _find_distribution(find_value(problem, -np.inf))
    return found if found and found.value <= other.value and other.reason != 'complete' else other


def _find_distribution(search: Search) -> Strategy:
    """Find the route distribution of a search whose value has been found.

    It is one chain if that is within the slack of the bound: always without a reach, mostly with
    one, but seldom on a trip. Whole routes may cost less, as they remember which sites they met.
    """
    best, lp = None, search.lp
    if search.game.network.legs == 1:
        best = find_chain(search)
        good = search.game.entries_are_hits or lp.bound == 0.0 or (best and best.good)
        if good or search.problem.late:
            return search.strategy(best)
    if isinstance(lp, Potential):
        search.lp = lp = _routes(search.problem, search.slack, lp)
    assert isinstance(lp, Routes)  # a cut's entries are hits
    if lp.planar:
        find_mixture(search, lp)
    best = find_trip(search, lp, best and search.worst_of(best))
    if best is None:
        find_flow(search)
        best = find_chain(search)
    return search.strategy(best)


def _search_ends(end: float, options: StrategyOptions, network: Network) -> tuple[float, float]:
    """When a search and its judge end if the time limit passes at ``end``."""
    share, most = RESERVE_ON_TRIPS if network.legs > 1 else RESERVE
    later = max(RESERVE[0] * options.time_limit, RESERVE[1]) / 2.0
    return end - min(share * options.time_limit, most), end + later


def _in_time(strategy: Strategy, options: StrategyOptions) -> Strategy:
    """The strategy; raises TimeLimit if the time passed before it was within the slack."""
    if strategy.reason != 'time':
        return strategy
    raise TimeLimit(
        f'after {options.time_limit:g} s the value {strategy.value:.6g} is not within '
        f'{options.risk_slack:g} of its bound {strategy.lower_bound:.6g}; allow more time', strategy
    )


def _potential(problem: SearchProblem, slack: float, first: float = np.inf) -> Potential | None:
    """The LP in potentials if the network is planar."""
    game, budget = problem.game, problem.budget
    faces = make_faces(game)
    if faces is None or not faces.same_both_ways(budget.cost):
        return None
    return Potential(faces, budget, POTENTIAL_GAP * slack, problem.deadline, first)


def _routes(problem: SearchProblem, slack: float, planar: Potential | None) -> Routes:
    """The LP over whole routes; its bound comes from potentials if there are any."""
    return Routes(problem.game, problem.budget, ROUTES_GAP * slack, problem.deadline,
                  problem.progress, planar)


def _check_losses(network: Network) -> None:
    """Raise InvalidNetwork if a loss is out of range."""
    odd = (network.alpha > MAX_LOSS) | ((network.alpha > 0.0) & (network.alpha < MIN_LOSS))
    if odd.any():
        node = int(np.argmax(odd))
        raise InvalidNetwork(f'alpha must be 0 or in {MIN_LOSS:g}..{MAX_LOSS:g}, got '
                             f'{network.alpha[node]:g} at node {node}; scale the losses, or '
                             'set the smallest to 0')
