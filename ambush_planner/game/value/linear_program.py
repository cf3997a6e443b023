# SPDX-License-Identifier: Apache-2.0
"""The paper's linear program (its equation 6), by HiGHS through scipy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import spsolve

from ...arrays import NEGLIGIBLE, ROUNDING, FloatArray, IndexArray
from ...errors import BudgetInfeasible
from ..ambusher import Ambusher, at_nodes
from ..budget import BUDGET_TOLERANCE, Budget
from ..certificate.certificate import entry_bound, lower_bounds
from ..distribution.chain import NO_FLOW
from ..game import Game
from ..hits import entry_value
from ..legs import Legs
from ..route_sampler import shortest_route_strategy
from ..strategy import Strategy, StrategyOptions, make_strategies, within_tolerance
from ..tolerance import ROUNDS
from . import highs
from .cut import solve_by_min_cut

if TYPE_CHECKING:  # loading scipy.optimize is slow, see entropy_search
    from scipy.optimize import OptimizeResult

# Upper limit of a node's visits in units of z: rows of negligible losses are kept in range.
MAX_VISITS = 1.0 / NEGLIGIBLE
# Largest ratio, either way, of the value to the unit of loss in which the LP is solved.
ORDINARY = 1e2


@dataclass(frozen=True, eq=False)
class LinearProgram(highs.LP):
    """The paper's LP in v = (p, z'), with p on the playable edges ``edge`` (m,) and z' = z / unit.

    The rows of ``inequalities`` are ``sum p into j - z' unit / alpha_j <= 0`` for each site j and,
    with a budget, ``l' p <= budget``.
    """

    edge: IndexArray
    unit: float


def conservation(game: Game) -> tuple[csr_matrix, IndexArray]:
    """Return the rows of ``A`` over the playable edges, and the node of each.

    The target's row follows from the others and is omitted.
    """
    network = game.network
    tail, head = network.edges[game.playable].T
    column = np.arange(len(tail))
    entries = np.concatenate((np.ones(len(tail)), -np.ones(len(tail))))
    full = csr_matrix((entries, (np.concatenate((tail, head)), np.concatenate((column, column)))),
                      shape=(game.node_count, len(tail)))
    node = np.unique(tail)
    return full[node], node


def linear_program(game: Game, length_weight: float, budget: float, unit: float) -> LinearProgram:
    """Build the LP: minimise (1 - w) z + w l' p with D p <= z, A p = b and l' p <= budget.

    ``unit`` > 0 is a loss near the value, for numerical precision.
    """
    network = game.network
    edge = np.flatnonzero(game.playable)
    lengths = network.travel_costs[edge]
    cost = np.append(length_weight / unit * lengths, 1.0 - length_weight)
    per_loss = -np.minimum(unit / game.loss[game.sites], MAX_VISITS)
    inequalities = hstack((game.entering[:, edge], csr_matrix(per_loss[:, None])))
    limits = np.zeros(len(game.sites))
    if np.isfinite(budget):
        inequalities = vstack((inequalities, csr_matrix(np.append(lengths, 0.0))))
        limits = np.append(limits, budget)
    rows_of_a, node = conservation(game)
    equalities = hstack((rows_of_a, csr_matrix((len(node), 1)))).tocsr()
    rhs = np.where(node == network.source, 1.0, 0.0)
    return LinearProgram(cost, inequalities.tocsr(), limits, equalities, rhs, edge, unit)


def linear_program_strategy(game: Game, options: StrategyOptions, length: Budget,
                            deadline: float) -> Strategy:
    """Solve by 'interior_point' (no crossover: near the centre of the optima) or 'simplex'.

    The budget's row is added only if the solution without it is too long; otherwise the LP is the
    paper's own. With a length weight, the budget is the solution's own expected length. Raises
    BudgetInfeasible, TimeLimit or SolverFailed.
    """
    whole, solver, length_weight = game, options.solver, options.length_weight
    if length_weight == 0.0:
        # If a route within the budget avoids all sites, the value is exactly 0; on all edges,
        # rounding would decide.
        safe = game.avoiding(game.entering)
        game = safe if safe and length.keeps(shortest_route_strategy(safe)) else game
    # An interior point method's result depends on the unit of loss: 1 as in the paper, unless the
    # value is far from 1.
    value = solve_by_min_cut(game).value if game.reach == 0.0 else 0.0
    value = value or float(game.loss.max(initial=0.0)) or 1.0
    unit = 1.0 if 1.0 / ORDINARY < value < ORDINARY else value
    lp = linear_program(game, length_weight, np.inf, unit)
    result = _run(lp, solver, deadline)
    lengths = game.network.travel_costs
    row_added = lengths[lp.edge] @ result.x[:-1] > length.limit * (1.0 + BUDGET_TOLERANCE)
    if row_added:
        lp, result = _within_budget(game, solver, length, length_weight, deadline)
    p = np.zeros(len(lengths))
    p[lp.edge] = _conserve(lp, np.maximum(result.x[:-1], 0.0))
    price = length_weight / lp.unit - (result.ineqlin.marginals[-1] if row_added else 0.0)
    q, price = _ambusher(game, lp, result, price)
    if row_added and length_weight == 0.0 and length.allows_only_shortest:
        high = length.deterring_price(entry_value(game, shortest_route_strategy(game)))
        price = max((price, high), key=lambda each: entry_bound(game, length, q, each))
    own_length = replace(length, limit=float(p @ lengths))
    limited = length_weight == 0.0 and (price > 0.0 or length.keeps(p))
    legs, ambusher = Legs((whole,), (length if limited else own_length,)), Ambusher(q, (price,))
    (found,) = make_strategies(legs, p, [None], ambusher, lower_bounds(legs, ambusher),
                               iterations=int(result.nit)).legs
    if within_tolerance(found, options):
        return found
    return replace(found, reason='solver' if game.no_reentry else 'stalled')



def _within_budget(game: Game, solver: str, length: Budget, length_weight: float,
                   deadline: float) -> tuple[LinearProgram, OptimizeResult]:
    """Solve with the budget's row; lower the unit from the shortest route's loss to the value.

    Without a margin, only the edges of shortest routes remain.
    """
    unit = entry_value(game, shortest_route_strategy(game)) or 1.0
    if length_weight == 0.0 and length.allows_only_shortest:
        shortest = game.least_weights(length.reduced_cost) <= ROUNDING * length.limit
        game = game.restricted_to(shortest) or game
    for _ in range(ROUNDS):
        lp = linear_program(game, length_weight, length.limit, unit)
        result = _run(lp, solver, deadline)
        value = float(result.x[-1])
        if value > 1.0 / ORDINARY:
            break
        unit *= max(value, NEGLIGIBLE)
    return lp, result


def _conserve(lp: LinearProgram, p: FloatArray) -> FloatArray:
    """Make p satisfy ``A p = b`` up to rounding by small relative changes; HiGHS stops at 1e-8."""
    rows = lp.equalities[:, :-1]
    for _ in range(ROUNDS):
        missing = lp.rhs - rows @ p
        if np.abs(missing).max() < NO_FLOW:
            break
        weight = np.maximum(p, NO_FLOW)
        change = rows.T @ spsolve((rows @ diags(weight) @ rows.T).tocsc(), missing)
        p = p + weight * np.clip(change, -0.5, 0.5)
    return np.maximum(p, 0.0)


def _ambusher(game: Game, lp: LinearProgram, result: OptimizeResult,
              price: float) -> tuple[FloatArray, float]:
    """Scale the duals of the sites' rows to q (N,), and the price of length with them."""
    loss = game.loss[game.sites]
    duals = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)[: len(loss)]
    # The row of a loss far below the unit is never tight: its dual is rounding.
    duals = np.where(loss * MAX_VISITS > lp.unit, duals / loss, 0.0)
    total = float(duals.sum())
    return at_nodes(game, duals), max(price / total, 0.0) if total > 0.0 else 0.0



def _run(lp: LinearProgram, solver: str, deadline: float) -> OptimizeResult:
    result = highs.run_either(lp, solver, deadline)
    if result.status == highs.INFEASIBLE:
        raise BudgetInfeasible(f'{solver}: no strategy fits the length budget; raise max_detour')
    return result
