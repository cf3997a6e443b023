"""Stage 1: the least value, and optimal strategies of both sides.

Without a reach and without a binding budget, a cut gives them. Otherwise HiGHS' interior point
method solves a linear program (``flow_program``) on a part of the network. While the certificate
finds better routes outside that part, their edges are added.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, sums
from ..errors import BudgetInfeasible, SolverFailed, TimeLimit
from .acyclic import conserved_strategy, forward_part, order_potential, rank_around, rank_by
from .budget import Budget
from .cut import CutSolution, solve_by_min_cut, uniform_ambusher
from .entries import best_prices, entry_bound, entry_value, priced_edges
from .flow_program import FlowProgram, capped_at_places
from .game import Game
from .hits import hits_can_differ, worst_loss
from .route_sampler import shortest_route_strategy
from .several_sites import share_sites
from .two_routes import strategy_within_budgets

# Sites with a loss of this many times the value are avoided if possible: a strategy could use them
# only so little that rounding would break the limit.
EXCESSIVE_LOSS = 1e7
# Largest number of edges added in one round: this share of the program's, or this many.
GROWTH, LEAST_GROWTH = 0.3, 1000
# Smaller flows are rounding of the interior point method.
NEGLIGIBLE = 1e-8
# Widths of the first part that are tried: how far a route may exceed the best one, in margins of a
# budget. A part is wide enough if its maximum flow is over a budget by this share of the margin.
FAR_OVER_BUDGET, EXCEEDED = (2.0, 3.0, 4.5), 0.4
# The program is built again, at most this many times, if the unit of loss is off the value by more
# than this factor; a smaller flow, in these units, is rounding.
MAX_UNITS, MOST_RESCALED, LEAST_SIZE = 6, 1e3, 1e-9
# Most programs on growing parts.
MAX_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class LeastRisk:
    """An acyclic optimal strategy p (M,) and the ambusher's q (N,), with value and bound.

    ``level`` (S,) is the largest mean loss allowed at each site; ``prices`` are those of the
    budgets, in loss per unit of cost.
    """

    value: float
    bound: float
    p: FloatArray
    q: FloatArray
    prices: tuple[float, ...]
    level: FloatArray


def least_value(game: Game, budgets: tuple[Budget, ...], closed: float, deadline: float) -> float:
    """The least value within the budgets, too low by at most the share ``closed``.

    If a route can come back into a site's reach, it is the value of the strategy that is best when
    every entry counts. At the deadline it is the value without budgets, or 0 if no cut gives that.
    Raises BudgetInfeasible if no strategy fits all budgets.
    """
    game = without_forbidden_edges(game, budgets)
    loose = least_risk_by_cut(game, budgets)
    if loose and all(budget.keeps(loose.p) for budget in budgets):
        if loose.value <= loose.bound * (1.0 + closed):
            return loose.bound
    try:
        found = least_risk(game, budgets, order_potential(game), closed, deadline)
        return worst_loss(game, found.p) if hits_can_differ(game) else found.bound
    except (TimeLimit, SolverFailed):
        return loose.bound if loose else 0.0


def least_risk_by_cut(game: Game, budgets: tuple[Budget, ...] = ()) -> LeastRisk | None:
    """The least value without budgets, by routes that avoid all sites or by a minimum cut.

    If the value is 0, the strategy is within the budgets if possible. None with a reach. On a trip,
    the cut of the costliest leg is a lower bound, attained if the other legs avoid its sites.
    """
    safe, k = game.avoiding_all_sites(), game.ambushers
    if safe is not None:
        try:
            p = strategy_within_budgets(safe, budgets)
        except BudgetInfeasible:
            p = None
        p = shortest_route_strategy(safe) if p is None else p
        nothing = np.zeros(len(game.sites))
        return LeastRisk(0.0, 0.0, p, uniform_ambusher(game), (0.0, 0.0), nothing)
    if game.reach > 0.0:
        return None
    cut = solve_by_min_cut(game.with_one_ambusher())
    first = game.network.representatives[game.network.places]
    q = k * sums(first, cut.q, game.node_count)
    if q.max() > 1.0:
        return _least_risk_by_cuts(game)
    lean, p = without_excessive_sites(game, cut.value), cut.p
    if lean is not game:
        p = solve_by_min_cut(lean.with_one_ambusher()).p
    level = np.full(len(game.sites), cut.value)
    return LeastRisk(entry_value(game, p), k * cut.value, p, q, (0.0, 0.0), level)


def _least_risk_by_cuts(game: Game) -> LeastRisk | None:
    """The least value against several ambushers who hold some sites for certain."""
    sites, first = game.sites, game.network.representatives[game.network.places]
    loss, exposed = game.loss[sites], np.flatnonzero(game.loss > 0.0)
    site_of = np.zeros(game.node_count, dtype=np.int64)
    site_of[sites] = np.arange(len(sites))

    def cut(played: Game, costs: FloatArray) -> CutSolution:
        priced = np.zeros(game.node_count)
        priced[exposed] = 1.0 / costs[site_of[first[exposed]]]
        return solve_by_min_cut(replace(played.with_one_ambusher(), loss=priced))

    found = share_sites(loss, game.ambushers, lambda costs: np.unique(
        site_of[first[np.flatnonzero(cut(game, costs).q)]]))
    if found is None:
        return None
    q = np.zeros(game.node_count)
    q[sites] = found.q
    q = capped_at_places(game, q)
    p = cut(without_excessive_sites(game, found.value), found.level / loss).p
    return LeastRisk(entry_value(game, p), found.value, p, q, (0.0, 0.0), found.level)


def without_forbidden_edges(game: Game, budgets: tuple[Budget, ...]) -> Game:
    """The game on the edges that cost nothing, if a budget is 0: rounding would exceed it.

    Raises BudgetInfeasible if no strategy there fits all budgets.
    """
    free = np.ones(len(game.playable), dtype=bool)
    for budget in budgets:
        free &= (budget.limit > 0.0) | (budget.cost == 0.0)
    part = game if free[game.playable].all() else game.restricted_to(free)
    if part is None:
        raise BudgetInfeasible('no route fits both budgets of 0; raise max_detour or max_exposure')
    strategy_within_budgets(part, budgets)
    return part


def without_excessive_sites(game: Game, value: float, p: FloatArray | None = None) -> Game:
    """The game without edges past excessively costly sites, if a route remains; keeps p's edges."""
    barred = game.loss[game.sites] > EXCESSIVE_LOSS * value
    if not barred.any():
        return game
    open_edges = np.asarray(game.hits[barred].getnnz(axis=0) == 0)
    if p is not None:
        open_edges |= p > 0.0
    return game.restricted_to(open_edges) or game


def _initial_part(game: Game, budgets: tuple[Budget, ...], potential: FloatArray,
                  good: FloatArray | None) -> Game:
    """The part that the program begins with: forward in an order around a good strategy (M,).

    If none is known, the order is the potential's. Without a reach it is then around the maximum
    flow, and the part is wide enough for that flow to exceed a budget, if any width is: the best
    strategies mix long routes with short ones.
    """
    over = [game.through(b.excess) / b.margin for b in budgets if b.binds]
    farthest = np.where(game.playable, np.max(over, axis=0, initial=0.0), 0.0)
    if good is not None:
        part = game.restricted_to((farthest <= 1.0) | (good > 0.0)) or game
        return forward_part(part, rank_around(part, good, potential)) or part
    for far in FAR_OVER_BUDGET:
        near = farthest <= far
        part = game.restricted_to(near) or game
        if game.reach > 0.0:
            return forward_part(part, rank_by(potential)) or part
        flow = solve_by_min_cut(part.with_one_ambusher()).p
        if near.all() or any(b.overrun(flow) > EXCEEDED * b.margin for b in budgets if b.binds):
            break
    return forward_part(part, rank_around(part, flow, potential)) or part


def least_risk(game: Game, budgets: tuple[Budget, ...], potential: FloatArray, closed: float,
               deadline: float, good: FloatArray | None = None) -> LeastRisk:
    """Solve the linear program on a growing part until the relative gap is ``closed``.

    ``potential`` (N,) orders the nodes of the first part, around a ``good`` acyclic strategy (M,)
    if one is known. Raises BudgetInfeasible if no strategy fits all budgets, and TimeLimit if the
    deadline passed before the first solution.
    """
    first = strategy_within_budgets(game, budgets)
    first = shortest_route_strategy(game) if first is None else first
    chosen = _initial_part(game, budgets, potential, good).playable | (first > 0.0)
    unit = entry_value(game, first) or 1.0
    best: LeastRisk | None = None
    solver = 'interior_point'
    for _ in range(MAX_ROUNDS):
        restricted = game.restricted_to(chosen)
        assert restricted is not None  # it contains the previous strategy's routes
        try:
            found, unit = _solve(game, restricted, budgets, unit, solver, closed, deadline)
        except (SolverFailed, TimeLimit) as failure:
            if isinstance(failure, SolverFailed) and chosen.sum() < game.playable.sum():
                chosen = game.playable
                continue
            if best is None:
                raise
            return best
        # The program's own prices decide which edges join, better ones prove more.
        prices, bound = best_prices(game, found.q, budgets, found.prices, found.value,
                                    found.value * (1.0 - closed))
        best = _best_of_both(best, replace(found, prices=prices, bound=bound))
        if best.bound >= best.value * (1.0 - closed):
            return best
        weights, paid = priced_edges(game, found.q, budgets, found.prices)
        through = game.through(weights) - paid
        added = _edges_to_add(chosen, through, found.value * (1.0 - closed / 2.0))
        if not added.any():
            if solver == 'simplex':
                return best
            solver = 'simplex'  # only precision is missing
        chosen = chosen | added
        if time.monotonic() > deadline:
            return best
    return best  # type: ignore[return-value]


def _best_of_both(best: LeastRisk | None, found: LeastRisk) -> LeastRisk:
    """The strategy of least value together with the ambusher of greatest bound."""
    if best is None:
        return found
    lower = found if found.bound >= best.bound else best
    upper = found if found.value <= best.value else best
    return replace(upper, q=lower.q, prices=lower.prices, bound=lower.bound)


def _edges_to_add(chosen: BoolArray, through: FloatArray, limit: float) -> BoolArray:
    """Edges (M,) outside the program on the best routes that cost less than ``limit``."""
    outside = np.where(chosen, np.inf, through)
    most = max(int(GROWTH * chosen.sum()), LEAST_GROWTH)
    if len(outside) > most:
        limit = min(limit, float(np.partition(outside, most)[most]))
    missing: BoolArray = outside <= limit
    return missing


def _solve(game: Game, part: Game, budgets: tuple[Budget, ...], unit: float, solver: str,
           closed: float, deadline: float) -> tuple[LeastRisk, float]:
    """Solve on the edges of ``part``; also returns the unit of loss, adjusted to the value."""
    for _ in range(MAX_UNITS):
        program = FlowProgram(part, budgets, unit)
        size, f, duals = program.solve(solver, closed, deadline)
        if 1.0 / MOST_RESCALED < size < MOST_RESCALED:
            break
        unit /= max(size, LEAST_SIZE)
    q, prices = program.ambusher(duals, closed)
    p = conserved_strategy(part, f / size, NEGLIGIBLE)
    if p is None:
        raise SolverFailed("the program's flow contains no route")
    # Each site may cause as much loss as the k-th worst site, or its own if that is more.
    losses = game.site_losses(p)
    level = np.maximum(losses, np.sort(losses)[-min(game.ambushers, len(losses))])
    value, bound = entry_value(game, p), entry_bound(game, q, budgets, prices)
    return LeastRisk(value, bound, p, q, prices, level), unit
