# SPDX-License-Identifier: Apache-2.0
"""Solve the game in the four stages of ``game``, or by the paper's linear programs."""

from __future__ import annotations

import math
import time

import numpy as np

from ..arrays import NEGLIGIBLE, IndexArray
from ..errors import InvalidNetwork, InvalidOption, TimeLimit, warn
from ..maps.risk_map import MAX_LOSS, MIN_LOSS
from ..network.network import Network
from .budget import length_budget
from .distribution_search import find_chain, find_distribution
from .game import Game, GameOptions, make_games
from .hits import largest_product
from .legs import Legs
from .proof import certify
from .search import Incumbent, Search, SearchProblem, SiteSearch
from .strategy import Strategy, StrategyOptions, TripStrategy
from .tolerance import ROUNDS, within
from .value.linear_program import linear_program_strategy
from .value.potential import Potential
from .value_search import find_sites, find_value, find_value_by_max_flow, program_law, tighten

# Probability of a hit from which on an ambush hits every route, up to rounding.
ALL_ROUTES = 1.0 - NEGLIGIBLE
# Largest share of the tolerance by which the proved bound may be below the program's for another
# distribution: it has to leave room.
UNPROVED = 0.6
# Time kept after the search for proofs, and after proofs for the rest: a share of the time limit,
# and the most of it [s].
RESERVE = 0.05, 1.0


def solve(network: Network, game: GameOptions | None = None,
          options: StrategyOptions | None = None) -> Strategy:
    """Find the convoy's optimal mixed strategy on a network, against ambushes at its nodes.

    ``plan_trip`` also covers ambushes between the nodes, the driven path and the secured area.

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
        With its value, its lower bound, and the ambusher's strategy that certifies the bound.

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
    Two ways, past losses of 1 and 3: the optimal strategy makes both ambushes cost the same.

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
    options = options or StrategyOptions()
    (strategy,) = solve_legs(make_games((network,), game or GameOptions()), options).legs
    if strategy.reason == 'time':
        raise TimeLimit(
            f'after {options.time_limit:g} s the value {strategy.value:.6g} is not within '
            f'{options.risk_slack:g} of its bound {strategy.lower_bound:.6g}; allow more time',
            strategy)
    certain = certain_sites(strategy)
    if not strategy.value > 0.0:
        warn('the value is 0: some routes pass no ambush that causes a loss; check alpha and the '
             'secured area (secured_radius)')
    elif strategy.reason == 'complete' and len(certain):
        warn(f'an ambush at node {certain[0]} hits every route: it always succeeds and '
             f'costs {strategy.value:.4g}')
    return strategy


def certain_sites(strategy: Strategy) -> IndexArray:
    """Return the nodes (K,) at which the ambusher waits and hits every route."""
    game = strategy.game
    rows = np.flatnonzero(strategy.ambush_probability[game.sites] > 0.0)
    hits = strategy.law.meets(game.entering[rows])
    return np.asarray(game.sites[rows[hits >= ALL_ROUTES]])


def solve_legs(games: tuple[Game, ...], options: StrategyOptions,
               site_search: SiteSearch | None = None) -> TripStrategy:
    """Find the optimal strategies of a trip's legs against one ambusher at any site.

    Sites are those of the games and of ``site_search``. At the time limit, returns the incumbent
    with the reason 'time'; raises TimeLimit only if there is none, else the errors of ``solve``.
    """
    if options.solver == 'max_entropy':
        return solve_problem(make_problem(games, options, site_search))
    if len(games) > 1:
        raise InvalidOption(f'the solver {options.solver} takes no stops; use max_entropy')
    _check_losses(games[0].network)
    found = linear_program_strategy(games[0], options, length_budget(games[0], options.max_detour),
                                    time.monotonic() + options.time_limit)
    return TripStrategy((found,), found.certificate, reason=found.reason)


def make_problem(games: tuple[Game, ...], options: StrategyOptions,
                 site_search: SiteSearch | None = None,
                 first_value: float = math.inf) -> SearchProblem:
    """Pose the problem of 'max_entropy', whose time limit begins now; raises as ``solve``.

    ``first_value`` is where the search for the value begins: an estimate, or inf.
    """
    _check_losses(games[0].network)
    budgets = tuple(length_budget(game, options.max_detour) for game in games)
    ends = search_ends(time.monotonic() + options.time_limit, options.time_limit)
    return SearchProblem(Legs(games, budgets), options.risk_slack, ends[0], site_search, ends[1],
                         first_value)


def search_ends(end: float, time_limit: float) -> tuple[float, float]:
    """Deadlines of a search and of its proofs that leave a reserve before ``end``."""
    reserve = min(RESERVE[0] * time_limit, RESERVE[1])
    return end - 2.0 * reserve, end - reserve


def solve_problem(problem: SearchProblem) -> TripStrategy:
    """Run all stages, beginning with a maximum flow if that solves the program for the value."""
    search = find_value_by_max_flow(problem)
    if search and (found := finish(search)).reason == 'complete':
        return found
    return finish(find_value(problem))


def finish(search: Search) -> TripStrategy:
    """Run the last two stages: distribution and certificate.

    If curves prove slightly less than the potential's bound, so that the gap exceeds the tolerance,
    the distribution is brought within the tolerance of the bound that is proved.
    """
    found = certify(search, find_distribution(search))
    nearly = within(search.program.bound, found.lower_bound, UNPROVED * search.tolerance)
    if found.reason != 'stalled' or not nearly or not isinstance(search.program, Potential):
        return found
    search.proved = found.lower_bound
    search.earlier.append(search.program.ambush)
    best = find_chain(search)
    again = certify(search, best) if best and best.within_tolerance else found
    return again if again.reason == 'complete' else found


def finish_flow(search: Search) -> TripStrategy:
    """Certify the program's own strategies, of least value but not of greatest entropy."""
    tighten(search)
    find_sites(search, ROUNDS)
    law = program_law(search)
    return certify(search, Incumbent(law, largest_product(search.loss, search.entering, law)[0]))


def _check_losses(network: Network) -> None:
    """Raise InvalidNetwork if a loss is out of range."""
    odd = (network.alpha > MAX_LOSS) | ((network.alpha > 0.0) & (network.alpha < MIN_LOSS))
    if odd.any():
        node = int(np.argmax(odd))
        raise InvalidNetwork(f'alpha must be 0 or in {MIN_LOSS:g}..{MAX_LOSS:g}, got '
                             f'{network.alpha[node]:g} at node {node}; scale the losses, or '
                             'set the smallest to 0')
