# SPDX-License-Identifier: Apache-2.0
"""The default strategy: least value within the budgets, then the most unpredictable routes.

One of three linear programs (LPs) finds the least value (``value``): a cut without a reach while no
budget binds, face potentials on a planar network whose links cost the same both ways, whole routes
otherwise. A search makes a strategy of it: a chain (``chain_search``), or on a trip one on a
layered graph (``trip_search``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import SolverFailed, TimeLimit
from .budget import Budget
from .chain_search import find_chain, find_flow
from .faces import make_faces
from .game import Game
from .hits import hits_can_differ
from .search import Search, SearchProblem, Solution, ValueLP
from .slack import MIN_SLACK, within
from .trip_search import find_legs, find_mixture, find_trip
from .value.cut import Cut
from .value.potential import Potential
from .value.routes import Routes

# Relative optimality gaps of an LP in potentials, and of one over routes, in slacks.
POTENTIAL_GAP, ROUTES_GAP = 0.1, 0.3
# Largest share by which the flow of a cut exceeds a budget if a distribution is sought around it,
# which then keeps the budget in nearly all games, without a loss of entropy.
MAX_OVERRUN = 0.07
# Cap at which an LP in potentials begins, as a multiple of the value without budgets.
FIRST_CAP = 2.0


def most_unpredictable(problem: SearchProblem) -> Solution:
    """Find value and route distribution; at the deadline, the best strategy so far is returned.

    Raises BudgetInfeasible if no strategy is within all budgets.
    """
    if problem.game.network.legs > 1 or hits_can_differ(problem.game):
        return find_distribution(find_value(problem))
    slack, best = max(problem.slack, MIN_SLACK), None
    for lp in _value_lps(problem, slack):
        search = Search(problem, lp, slack)
        find_flow(search)
        chain = find_chain(search)
        if chain is None and not problem.keeps_budgets(lp.flow):
            continue  # a cut's flow is over a budget
        found = search.solution(chain)
        if best is None or found.value < best.value or within(found.value, found.bound, slack):
            best = found
        if within(best.value, best.bound, slack) or problem.late:
            break
    assert best is not None  # the flow of the last LP is within the budgets
    return best


def find_value(problem: SearchProblem) -> Search:
    """Find the least value within the budgets, and an ambusher who nearly proves it."""
    slack = max(problem.slack, MIN_SLACK)
    if problem.game.network.legs > 1:
        routes = _routes(problem, slack)
        search = Search(problem, routes, slack)
        (find_legs if routes.planar else find_mixture)(search, routes)
    else:
        search = Search(problem, _within_budgets(problem, slack, _cut_of(problem)), slack)
        find_flow(search)
    return search


def find_distribution(search: Search) -> Solution:
    """Find the route distribution of a search whose value has been found."""
    best, lp = None, search.lp
    if search.problem.game.network.legs > 1:
        assert isinstance(lp, Routes)  # see find_value
        if lp.planar:
            find_mixture(search, lp)
        best = find_trip(search, lp)
        if best is None:
            find_flow(search)
    return search.solution(best or find_chain(search))


def least_value(game: Game, budgets: tuple[Budget, Budget], gap: float,
                deadline: float) -> float | None:
    """A lower bound of the least value within the budgets, too low by at most the share ``gap``.

    On trips it is what separate legs prove. None if the deadline passes before.
    """
    problem = SearchProblem(game, budgets, gap, deadline)
    try:
        if game.network.legs > 1:
            routes = _routes(problem, gap)
            routes.prove_by_legs()
            return routes.bound
        cut = _cut_of(problem)
        if cut and cut.overrun == 0.0:
            return cut.bound
        lp = _within_budgets(problem, gap, cut)
        lp.solve()
    except (TimeLimit, SolverFailed):
        return None
    return lp.bound


def _value_lps(problem: SearchProblem, slack: float) -> Iterator[ValueLP]:
    """The LP without budgets if its flow nearly keeps them, then the one within them."""
    cut = _cut_of(problem)
    if cut and cut.overrun <= MAX_OVERRUN:
        yield cut
    yield _within_budgets(problem, slack, cut)


def _cut_of(problem: SearchProblem) -> Cut | None:
    """The value without budgets, if a cut finds it."""
    return None if hits_can_differ(problem.game) else Cut(problem.game, _binding(problem))


def _within_budgets(problem: SearchProblem, slack: float, cut: Cut | None) -> Potential | Routes:
    """The fastest LP that finds the value within budgets, perhaps from that without."""
    found = _potential(problem, slack, FIRST_CAP * cut.bound if cut else np.inf)
    return found or _routes(problem, slack)


def _potential(problem: SearchProblem, slack: float, first: float = np.inf) -> Potential | None:
    """The LP in potentials if the network is planar and at most one budget binds."""
    game, binding = problem.game, _binding(problem)
    if game.ambushers > 1 or len(binding) > 1 or game.options.loads:
        return None
    faces, budget = make_faces(game), (*binding, problem.budgets[0])[0]
    if faces is None or not faces.same_both_ways(budget.cost):
        return None
    return Potential(faces, budget, POTENTIAL_GAP * slack, problem.deadline, first)


def _routes(problem: SearchProblem, slack: float) -> Routes:
    """The LP over whole routes; on a trip, its bound comes from potentials if there can be any."""
    planar = _potential(problem, slack) if problem.game.network.legs > 1 else None
    return Routes(problem.game, _binding(problem), ROUTES_GAP * slack, problem.deadline,
                  problem.progress, planar)


def _binding(problem: SearchProblem) -> tuple[Budget, ...]:
    return tuple(b for b in problem.budgets if b.binds)
