# SPDX-License-Identifier: Apache-2.0
"""Solve the game: value, sites, distribution, certificate.

1. *Value.* A program finds the least value within the length budgets, strategies that attain it,
   and an ambusher who proves it: a maximum flow without a reach and a budget, face potentials on
   planar networks whose links cost the same both ways, whole routes otherwise (``value``).
2. *Sites.* With a reach, the places of the map that cost these strategies most join the program,
   which goes on from where it is (constraint generation).
3. *Distribution.* On acyclic networks around the strategies, the law of greatest entropy within the
   tolerance of the bound: one Markov chain for each leg (``distribution``). Sites that cost it more
   join. Where no chain is within the tolerance, whole routes are drawn.
4. *Certificate.* Value and bound are computed again, from the strategies and the ambusher alone
   (``certificate``).

The paper's linear programs are another choice.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import NEGLIGIBLE, FloatArray, IndexArray
from ..errors import InvalidNetwork, InvalidOption, TimeLimit, warn
from ..maps.risk_map import MAX_LOSS, MIN_LOSS
from ..network.network import Network
from .ambusher import Ambush, Ambusher
from .budget import length_budget
from .certificate.certificate import lower_bounds
from .distribution.acyclic import acyclic_subnetwork, order_potential, topological_order
from .distribution.chain import MarkovChain, RouteMixture, chain_of_legs
from .distribution.gibbs import acyclic_network, in_series
from .distribution.route_distribution import DISTRIBUTION, RouteDistribution
from .faces import Faces, make_faces
from .game import Game, GameOptions, make_games
from .hits import Law, largest_product
from .legs import Legs
from .search import Incumbent, Search, SearchProblem, SiteSearch
from .strategy import Strategy, StrategyOptions, TripStrategy, make_strategies
from .tolerance import CERTIFICATE_TOLERANCE, MIN_TOLERANCE, ROUNDS, Reason, ceiling, within
from .value.cut import solve_by_min_cut
from .value.linear_program import linear_program_strategy
from .value.potential import Potential
from .value.routes import ROUTES, Routes

# Least share of the routes that is every route, up to rounding.
ALL_ROUTES = 1.0 - NEGLIGIBLE


class Stages(NamedTuple):
    """The constants of the stages."""

    # Optimality gaps of a program in potentials, and of one over routes [tolerances].
    potential_gap: float = 0.1
    routes_gap: float = 0.3
    # The gap of one in potentials that only says where a network is to be refined [tolerances].
    rough_gap: float = 0.5
    # Share of the tolerance that a program's strategies may use; a distribution may use the rest.
    flow_tolerance: float = 0.5
    # How often sites join before the distribution is sought; more often while the value is 0. In
    # the last of these rounds and later, sites may be as near to each other as the program allows.
    sweeps: int = 3
    joining: float = 0.8  # share of the tolerance beyond which sites join a distribution
    # Least relative growth of the entropy for another round: what a rough one may miss.
    growth: float = DISTRIBUTION.early_accuracy.missing
    # Share of the time until the deadline after which the flow is improved, if no distribution is
    # within the tolerance by then.
    rounds: float = 0.8
    lines: int = 64  # level lines of each leg with which whole routes begin
    # A search ends before its time limit by this share of it, or by this time [s] if that is less;
    # proofs end as much after that.
    reserve: tuple[float, float] = (0.05, 1.0)


STAGES = Stages()


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
    options = options or StrategyOptions()
    found = _in_time(solve_legs(make_games((network,), game or GameOptions()), options), options)
    (strategy,) = found.legs
    certain = certain_sites(strategy)
    if not strategy.value > 0.0:
        warn('the value is 0: some routes pass no ambush that causes a loss; check alpha and the '
             'secured area (secured_radius)')
    elif strategy.reason == 'complete' and len(certain):
        warn(f'an ambush at node {certain[0]} hits every route: it always succeeds and '
             f'costs {strategy.value:.4g}')
    return strategy


def certain_sites(strategy: Strategy) -> IndexArray:
    """The nodes (K,) where the ambusher waits and every route is hit."""
    game = strategy.game
    rows = np.flatnonzero(strategy.ambush_probability[game.sites] > 0.0)
    hits = strategy.law.meets(game.entering[rows])
    return np.asarray(game.sites[rows[hits >= ALL_ROUTES]])


def solve_legs(games: tuple[Game, ...], options: StrategyOptions,
               site_search: SiteSearch | None = None) -> TripStrategy:
    """Find the optimal strategies of a trip's legs against an ambusher at their sites.

    Also at those of ``site_search``. At the time limit, the best so far is returned, with the
    reason 'time'. Raises the errors of ``solve`` but TimeLimit, unless there is nothing to return.
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
    """The problem of 'max_entropy', from now to its time limit; raises the errors of ``solve``.

    The search for the value begins at ``first_value``, if that is known to be near.
    """
    _check_losses(games[0].network)
    budgets = tuple(length_budget(game, options.max_detour) for game in games)
    ends = search_ends(time.monotonic() + options.time_limit, options.time_limit)
    return SearchProblem(Legs(games, budgets), options.risk_slack, ends[0], site_search, ends[1],
                         first_value)


def search_ends(end: float, time_limit: float) -> tuple[float, float]:
    """Return the deadline of a search and its proofs that leaves the rest time until ``end``."""
    reserve = min(STAGES.reserve[0] * time_limit, STAGES.reserve[1])
    return end - 2.0 * reserve, end - reserve


def solve_problem(problem: SearchProblem) -> TripStrategy:
    """Find value and distribution, by a maximum flow if that keeps the length budget."""
    return _by_max_flow(problem) or finish(find_value(problem))


def finish(search: Search) -> TripStrategy:
    """The strategies of a search whose value has been found."""
    return certify(search, find_distribution(search))


def finish_flow(search: Search) -> TripStrategy:
    """Strategies of least value, not those of the greatest entropy among them."""
    tighten(search)
    find_sites(search, ROUNDS)
    law = program_law(search)
    return certify(search, Incumbent(law, largest_product(search.loss, search.entering, law)[0]))


def _by_max_flow(problem: SearchProblem) -> TripStrategy | None:
    """The solution without a reach, if the flow that attains the value keeps the budget."""
    legs = problem.legs
    if not legs.no_reentry or len(legs.games) > 1:
        return None
    (game,), (budget,) = legs.games, legs.budgets
    cut = solve_by_min_cut(game)
    if not budget.keeps(cut.p):
        return None
    ambush = Ambush(cut.q[game.sites], np.zeros(1))
    search = Search(problem, Solved(cut.value, cut.p, ambush), _tolerance(problem))
    found = finish(search)
    return found if found.reason == 'complete' else None


class Solved(NamedTuple):
    """A value, strategies (M,) that attain it, and the ambusher: nothing is left to solve."""

    bound: float
    flow: FloatArray
    ambush: Ambush
    apart: float = 0.0

    @property
    def value(self) -> float:
        """The cost of the strategies."""
        return self.bound

    def solve(self, deadline: float) -> None:
        """Do nothing: it is solved."""

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Do nothing: all sites are nodes of the network."""


def _tolerance(problem: SearchProblem) -> float:
    return max(problem.tolerance, MIN_TOLERANCE)


def find_value(problem: SearchProblem, rough: bool = False) -> Search:
    """Find the least value within the budgets, and an ambusher who nearly proves it.

    A ``rough`` search is less precise, until it is finished (``tighten``).
    """
    tolerance, legs = _tolerance(problem), problem.legs
    faces, gap = planar_faces(legs), STAGES.rough_gap if rough else STAGES.potential_gap
    program = (Potential(legs, faces, gap * tolerance, problem.first_value)
               if faces else Routes(legs, STAGES.routes_gap * tolerance))
    search = Search(problem, program, tolerance)
    find_sites(search)
    return search


def tighten(search: Search) -> None:
    """Find the value of a rough search precisely."""
    if isinstance(search.program, Potential):
        search.program.tighten(STAGES.potential_gap * search.tolerance)
        search.solve_program()


def planar_faces(legs: Legs) -> list[Faces]:
    """The faces of all legs; empty if a network is not planar, or costs differ by direction."""
    found = []
    for game, budget in zip(legs.games, legs.budgets, strict=True):
        faces = make_faces(game)
        if faces is None or not faces.same_both_ways(budget.cost):
            return []
        found.append(faces)
    return found


def find_sites(search: Search, sweeps: int = STAGES.sweeps) -> None:
    """Constraint generation: solve the program, add the most violated sites, repeat."""
    for sweep in range(ROUNDS):
        search.solve_program()
        if search.problem.out_of_time or (sweep >= sweeps and search.program.bound > 0.0):
            break
        apart = ROUTES.apart if sweep < sweeps - 1 else 0.0
        threshold = ceiling(search.program.bound, search.tolerance)
        if search.add_violated_sites(program_law(search), threshold, apart) is None:
            break


def program_law(search: Search) -> Law:
    """Return the law by which the program's strategies are drawn."""
    if isinstance(search.program, Routes):
        return search.program.mixture
    return _flow_law(search)


def _flow_law(search: Search) -> MarkovChain:
    networks = [game.network for game in search.legs.games]
    return chain_of_legs(networks, search.program.flow, search.legs.first)


def find_distribution(search: Search) -> Incumbent:
    """Find the law of greatest entropy within the tolerance, or of least value if none is.

    One chain for each leg is within the tolerance without a reach, and mostly with one. Whole
    routes may cost less, as they remember which sites they met.
    """
    best = find_chain(search)
    if best is None:
        law = _flow_law(search)
        best = Incumbent(law, largest_product(search.loss, search.entering, law)[0])
    if best.good or search.legs.no_reentry or search.problem.out_of_time:
        return best
    mixture = find_mixture(search)
    return mixture if mixture.value < best.value else best


def find_chain(search: Search) -> Incumbent | None:
    """The chains of most entropy within the tolerance, else of least value; None if none is.

    They are found in rounds around the program's flow; each strategy on the way counts. Rounds can
    lead to chains from which no distribution keeps the limits of sites that joined: then they begin
    again.
    """
    program, distribution, before = search.program, _around_flow(search), 0.0
    best: Incumbent | None = None
    end, begin = search.deadline, time.monotonic()
    latest = begin + STAGES.rounds * (end - begin)
    if search.problem.site_search is None:  # otherwise other sites may cost the flow more
        best = search.better(best, distribution)
    for _ in range(ROUNDS):
        distribution.deadline = end if best and best.good else latest
        if time.monotonic() > distribution.deadline:
            search.reason = 'time'
            break
        found, feasible = None, distribution.round()
        search.evaluations += distribution.evaluations
        if not feasible and not distribution.rounds:
            break
        if feasible:
            threshold = ceiling(program.bound, STAGES.joining * search.tolerance)
            found = search.add_violated_sites(distribution.chain, threshold, ROUTES.apart)
        if found:
            distribution.add_sites(found.entering, found.alpha)
            search.solve_program()
        if not feasible or (found and program.bound == 0.0):
            # The flow keeps to the caps of all sites: begin again there, and if the bound is 0,
            # without edges that they hit.
            distribution = _around_flow(search)
            continue
        distribution.measure(_cap(search))
        best = search.better(best, distribution)
        grew = distribution.entropy > before * (1.0 + STAGES.growth)
        before = distribution.entropy
        kept = best is not None and best.good  # one that was over a budget is not
        if distribution.good and (distribution.exact or kept and not grew):
            break
    if best and not best.good:
        find_sites(search, ROUNDS)
        best = search.better(best, _around_flow(search))
    return best


def _cap(search: Search) -> float:
    """The mean loss that each site may cause, without the tolerance."""
    program = search.program
    if isinstance(program, Routes):
        least = ceiling(program.value, STAGES.flow_tolerance * search.tolerance)
        return max(program.bound, least / ceiling(1.0, search.tolerance))
    return program.bound


def _around_flow(search: Search) -> RouteDistribution:
    """The program's flow as the first strategy of rounds."""
    legs, bound = search.legs, search.program.bound
    flow = search.program.flow
    safe = legs.avoiding(search.entering) if bound == 0.0 else None
    parts = []
    for k, (game, p) in enumerate(zip(legs.games, legs.split(flow), strict=True)):
        game = _within_margin(game, legs.budgets[k].used_margin, p)
        if safe and not p[~safe.games[k].playable].any():  # no route is hit at all
            game = safe.games[k]
        position = topological_order(game, p, order_potential(game))
        part = acyclic_subnetwork(game, position)
        assert part is not None  # it contains the flow
        parts.append(acyclic_network(game.network, np.flatnonzero(part.playable), position))
    network = in_series(parts, legs.first)
    distribution = RouteDistribution(network, flow[network.edge], legs, search.tolerance,
                                     search.deadline)
    distribution.add_sites(search.entering, search.loss)
    distribution.measure(_cap(search))
    return distribution


def _within_margin(game: Game, used_margin: FloatArray, p: FloatArray) -> Game:
    """The game without edges that the budget leaves to less than ``NEGLIGIBLE`` of the routes.

    So all best routes for a budget that allows no others are in one order of the nodes.
    """
    used = game.least_weights(used_margin) <= 1.0 / NEGLIGIBLE
    return game.restricted_to(used | (p > 0.0)) or game


def find_mixture(search: Search) -> Incumbent:
    """Mixtures of whole routes of least value, at the sites that matter for them."""
    if isinstance(search.program, Potential):
        potential = search.program
        search.earlier.append(potential.ambush)
        routes = Routes(search.legs, STAGES.routes_gap * search.tolerance)
        known = len(routes.loss)
        routes.add_sites(csr_matrix(search.entering[known:]), search.loss[known:])
        routes.bound = potential.bound
        for leg, lines in enumerate(potential.level_lines(STAGES.lines)):
            for line in lines:
                routes.add_route(leg, line)
        search.program = routes
    find_sites(search, ROUNDS)
    program = search.program
    assert isinstance(program, Routes)
    good = within(program.value, program.bound, search.tolerance)
    return Incumbent(program.mixture, program.value, rating=(good, -program.value))


def certify(search: Search, best: Incumbent) -> TripStrategy:
    """The strategies of an incumbent, with their value at any place and a bound that is proved.

    In games with the sites that matter for it or for its bound.
    """
    if isinstance(best.law, MarkovChain):
        best = replace(best, law=best.law.without_rare())
    best = search.at_any_site(best)
    legs, count = search.legs, len(search.loss)
    own, ambushes = np.arange(count) < len(legs.loss), [*search.earlier, search.program.ambush]
    kept = own.copy()
    for each in ambushes:
        kept[np.flatnonzero(each.q)] = True
        for circulation in each.circulations:
            kept[circulation.site] = True
    if best.worst >= 0:
        kept[best.worst] = True
    added = np.flatnonzero(kept & ~own)
    legs = legs.with_sites(search.points[added], search.loss[added],
                           csr_matrix(search.entering[added]))
    ambusher, bounds = _best_proof(search, legs, best, [each.ambusher(legs.games[0], kept)
                                                        for each in ambushes])
    law, mixtures = best.law, list[RouteMixture | None]([None] * len(legs.games))
    if isinstance(law, RouteMixture):
        mixtures = [law.of_leg(k, int(first)) for k, first in enumerate(legs.first[:-1])]
    found = make_strategies(legs, law.uses(legs.edge_count), mixtures, ambusher, bounds,
                            iterations=search.evaluations)
    reason: Reason = 'complete'
    if not within(found.value, found.lower_bound, search.problem.tolerance + CERTIFICATE_TOLERANCE):
        reason = 'time' if search.problem.out_of_time else search.reason
    alone = best.entropy_bound if len(legs.games) == 1 else np.nan
    strategies = tuple(replace(leg, reason=reason, entropy_bound=alone) for leg in found.legs)
    return replace(found, legs=strategies, reason=reason, entropy_bound=best.entropy_bound)


def _best_proof(search: Search, legs: Legs, best: Incumbent,
                ambushers: list[Ambusher]) -> tuple[Ambusher, FloatArray]:
    """The ambusher who proves most, and the legs' bounds; those within the tolerance will do."""
    target, proved = best.value / ceiling(1.0, search.tolerance), []
    for ambusher in ambushers:
        bounds = np.zeros(len(legs.games))
        if search.program.bound > 0.0:  # else a search for what is proved can take minutes
            targets = _leg_targets(legs, best.law, ambusher, target)
            bounds = lower_bounds(legs, ambusher, search.problem.certificate_deadline, targets)
        proved.append((ambusher, bounds))
        if bounds.sum() >= target:
            break
    return max(proved, key=lambda each: float(each[1].sum()))


def _leg_targets(legs: Legs, law: Law, ambusher: Ambusher, target: float) -> FloatArray:
    """The bound to prove of each leg (legs,): they add up to ``target`` if that is possible.

    What the leg's own strategy costs against the ambusher, less its share of what need not be
    proved.
    """
    if len(legs.games) == 1:
        return np.array([target])
    game = legs.games[0]
    site_prices = (game.loss * ambusher.q)[game.sites]
    rows = np.flatnonzero(site_prices)
    uses, entering = legs.split(law.uses(legs.edge_count)), csr_matrix(legs.entering[rows])
    edge = np.arange(legs.edge_count)
    hits = [float(site_prices[rows] @ law.meets(csr_matrix(entering.multiply(
        (edge >= begin) & (edge < end))))) for begin, end in pairwise(legs.first.tolist())]
    paid = [price * (float(p[p > 0.0] @ budget.reduced_cost[p > 0.0]) - budget.margin)
            if price > 0.0 else 0.0
            for price, budget, p in zip(ambusher.prices, legs.budgets, uses, strict=True)]
    costs, shares = np.add(hits, paid), np.array(hits)
    spare = max(float(costs.sum()) - target, 0.0)
    return np.asarray(costs - spare * shares / max(float(shares.sum()), np.finfo(float).tiny))


def _in_time(strategy: TripStrategy, options: StrategyOptions) -> TripStrategy:
    """The strategy; raises TimeLimit if the time passed before it was within the slack."""
    if strategy.reason != 'time':
        return strategy
    raise TimeLimit(
        f'after {options.time_limit:g} s the value {strategy.value:.6g} is not within '
        f'{options.risk_slack:g} of its bound {strategy.lower_bound:.6g}; allow more time',
        strategy.legs[0])


def _check_losses(network: Network) -> None:
    """Raise InvalidNetwork if a loss is out of range."""
    odd = (network.alpha > MAX_LOSS) | ((network.alpha > 0.0) & (network.alpha < MIN_LOSS))
    if odd.any():
        node = int(np.argmax(odd))
        raise InvalidNetwork(f'alpha must be 0 or in {MIN_LOSS:g}..{MAX_LOSS:g}, got '
                             f'{network.alpha[node]:g} at node {node}; scale the losses, or '
                             'set the smallest to 0')
