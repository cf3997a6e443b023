"""The paper's linear program (its equation 6), solved by HiGHS through scipy."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from scipy.optimize import OptimizeResult, OptimizeWarning, linprog
from scipy.sparse import csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import spsolve

from .errors import BudgetInfeasible, SolverFailed, TimeLimit
from .game import Game
from .game_value import indifferent_ambusher, solve_by_cut
from .network import IndexArray
from .outcome import Outcome
from .paths import distances_from, on_some_route
from .risk_map import FloatArray
from .routes import always, shortest_route

LIMIT_REACHED, INFEASIBLE, NUMERICAL_TROUBLE = 1, 2, 4
# ipm_optimality_tolerance, one after the other until HiGHS is content; its default is 1e-8.
OPTIMALITY = (1e-11, 1e-8, 1e-7)
# HiGHS' own tolerances, far below the certificate's.
TOLERANCE = 1e-9
# No node is visited this often; where a loss is so small, its row says this instead.
MOST_VISITS = 1e6
# A unit this near to the value or nearer serves; from far above it is lowered, so often at most.
NEAR_UNIT, MAX_UNITS = 1e-3, 8
# Values in this range need no unit of their own.
ORDINARY = (1e-2, 1e2)
# The rows A p = b are met to this, in so many attempts at the most.
CONSERVED, ATTEMPTS = 1e-13, 3


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """minimise cost' v, ``inequalities v <= limits``, ``equalities v = rhs``, v = (p, z') >= 0.

    p are the expected uses of the playable edges ``edge`` (m,), z' is the value in units of
    ``unit``. Rows of ``inequalities``: one a site, ``sum p into j - z' unit / alpha_j <= 0``, and
    last, where a budget is set, ``l' p <= budget``.
    """

    edge: IndexArray
    cost: FloatArray
    inequalities: csr_matrix
    limits: FloatArray
    equalities: csr_matrix
    rhs: FloatArray
    unit: float


def linear_program(
    game: Game, length_weight: float, budget: float, unit: float
) -> LinearProgram:
    """Build the program: (1 - w) z + w l' p under D p <= z, A p = b and l' p <= budget.

    ``unit`` > 0 is a loss near to the value, so that the digits of z count.
    """
    network = game.network
    edge = np.flatnonzero(game.playable)
    lengths = network.lengths[edge]
    cost = np.append(length_weight / unit * lengths, 1.0 - length_weight)
    per_loss = -np.minimum(unit / game.loss[game.sites], MOST_VISITS)
    inequalities = hstack((game.hits[:, edge], csr_matrix(per_loss[:, None])))
    limits = np.zeros(len(game.sites))
    if np.isfinite(budget):
        inequalities = vstack((inequalities, csr_matrix(np.append(lengths, 0.0))))
        limits = np.append(limits, budget)
    conservation, rhs = _conservation(game, edge)
    nothing = csr_matrix((conservation.shape[0], 1))
    return LinearProgram(
        edge,
        cost,
        inequalities.tocsr(),
        limits,
        hstack((conservation, nothing)).tocsr(),
        rhs,
        unit,
    )


def _conservation(game: Game, edge: IndexArray) -> tuple[csr_matrix, FloatArray]:
    """``A p = b`` without the target's row, which follows from the others."""
    network = game.network
    tail, head = network.edges[edge].T
    column = np.arange(len(edge))
    entries = np.concatenate((np.ones(len(edge)), -np.ones(len(edge))))
    full = csr_matrix(
        (entries, (np.concatenate((tail, head)), np.concatenate((column, column)))),
        shape=(game.node_count, len(edge)),
    )
    node = np.unique(tail)
    rhs = np.zeros(len(node))
    rhs[node == network.source] = 1.0
    return full[node], rhs


def linear_program_strategy(
    game: Game, solver: str, budget: float, length_weight: float, deadline: float
) -> Outcome:
    """Solve by 'interior_point' (no crossover: near the centre of the optima) or 'simplex'.

    The budget's row is added only when the solution without it is too long, so that where the
    budget does not bind the program is the paper's own.

    Raises
    ------
    BudgetInfeasible, TimeLimit, SolverFailed
        As the names say.
    """
    if length_weight == 0.0:
        game = _past_all_sites(game, budget) or game
    program = linear_program(game, length_weight, np.inf, _unit(game))
    result = _run(program, solver, deadline)
    row_added = float(game.network.lengths[program.edge] @ result.x[:-1]) > budget * (1 + 1e-9)
    if row_added:
        program, result = _within_budget(game, solver, budget, length_weight, deadline)
    p = np.zeros(len(game.network.edges))
    p[program.edge] = _conserved(program, np.maximum(result.x[:-1], 0.0))
    reference = budget if length_weight == 0.0 else float(p @ game.network.lengths)
    price = length_weight / program.unit - (result.ineqlin.marginals[-1] if row_added else 0.0)
    return _with_ambusher(game, program, p, result, price, reference)


def _past_all_sites(game: Game, budget: float) -> Game | None:
    """The game on the edges that no ambush hits, if a route within the budget is left; else None.

    Its value is 0 exactly; on all edges the solver's rounding would be all the loss there is.
    """
    untouched = game.playable & (game.hits.getnnz(axis=0) == 0)
    network, count = game.network, game.node_count
    edges = network.edges[untouched]
    length = distances_from(edges, network.lengths[untouched], count, network.source)
    if not np.isfinite(length[network.target]) or length[network.target] > budget * (1 + 1e-9):
        return None
    useful = on_some_route(edges, count, network.source, network.target)
    untouched &= useful[network.tails] & useful[network.heads]
    return replace(game, playable=untouched)


def _unit(game: Game) -> float:
    """A loss near to the value: 1, or where that is far off the value without a budget.

    The optimum that an interior point method stops at depends on the unit; 1 is the paper's.
    """
    value = solve_by_cut(game).value if game.ambush_radius == 0.0 else 0.0
    value = value or float(game.loss.max(initial=0.0)) or 1.0
    return 1.0 if ORDINARY[0] < value < ORDINARY[1] else value


def _within_budget(
    game: Game, solver: str, budget: float, length_weight: float, deadline: float
) -> tuple[LinearProgram, OptimizeResult]:
    """Solve with the budget's row; the unit falls from the shortest route's loss to the value."""
    unit = _shortest_route_loss(game) or 1.0
    for _ in range(MAX_UNITS):
        program = linear_program(game, length_weight, budget, unit)
        result = _run(program, solver, deadline, budget)
        value = float(result.x[-1])
        if value > NEAR_UNIT:
            break
        unit *= max(value, NEAR_UNIT**2)
    return program, result


def _shortest_route_loss(game: Game) -> float:
    """What the best ambush costs against always driving the shortest route."""
    route = shortest_route(game.network, np.flatnonzero(game.playable))
    return game.upper_bound(always(game.network, route))


def _conserved(program: LinearProgram, p: FloatArray) -> FloatArray:
    """Meet ``A p = b`` to rounding by small relative changes of p; HiGHS stops at about 1e-8."""
    rows = program.equalities[:, :-1]
    for _ in range(ATTEMPTS):
        missing = program.rhs - rows @ p
        if np.abs(missing).max() < CONSERVED:
            break
        weight = np.maximum(p, 1e-12)
        change = rows.T @ spsolve((rows @ diags(weight) @ rows.T).tocsc(), missing)
        p = p + weight * np.clip(change, -0.5, 0.5)
    return np.maximum(p, 0.0)


def _with_ambusher(
    game: Game, program: LinearProgram, p: FloatArray, result: OptimizeResult, price: float,
    budget: float,
) -> Outcome:
    """Read q off the duals of the sites' rows; q and ``price`` share their scale."""
    loss = game.loss[game.sites]
    duals = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)[: len(loss)]
    # The row of a loss far below the unit never binds: its dual is rounding, and large over alpha.
    q = np.zeros(game.node_count)
    q[game.sites] = np.where(loss * MOST_VISITS > program.unit, duals / loss, 0.0)
    total = q.sum()
    if total <= 0.0:
        return Outcome(p, indifferent_ambusher(game), budget, 0.0, int(result.nit))
    if price == 0.0:
        budget = max(budget, float(p @ game.network.lengths))
    return Outcome(p, q / total, budget, price / total, int(result.nit))


def _run(
    program: LinearProgram, solver: str, deadline: float, budget: float = np.inf
) -> OptimizeResult:
    options: dict[str, Any] = {
        "primal_feasibility_tolerance": TOLERANCE,
        "dual_feasibility_tolerance": TOLERANCE,
    }
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit(f"{solver}: time is up before the first iteration")
    if np.isfinite(left):
        options["time_limit"] = left
    if solver == "interior_point":
        result = _run_interior_point(program, options)
    else:
        result = _linprog(program, "highs-ds", options)
    if result.status == LIMIT_REACHED:
        raise TimeLimit(f"{solver}: time is up after {result.nit} iterations")
    if result.status == INFEASIBLE and np.isfinite(budget):
        raise BudgetInfeasible(f"{solver}: no strategy fits the length budget of {budget:.3f} m")
    if result.x is None or result.status != 0:
        raise SolverFailed(f"{solver}: {result.message}")
    return result


def _run_interior_point(program: LinearProgram, options: dict[str, Any]) -> OptimizeResult:
    """Run without crossover; where HiGHS ends in an unknown state, another tolerance may help.

    HiGHS 1.2 (scipy 1.11) also ends so where its presolve leaves nothing, or nothing feasible.
    """
    options = {**options, "run_crossover": _no_crossover()}
    for presolve in (True, False):
        for tolerance in OPTIMALITY:
            tried = {"presolve": presolve, "ipm_optimality_tolerance": tolerance}
            result = _linprog(program, "highs-ipm", options | tried)
            if result.status != NUMERICAL_TROUBLE:
                return result
    return result


def _linprog(program: LinearProgram, method: str, options: dict[str, Any]) -> OptimizeResult:
    with warnings.catch_warnings():
        # run_crossover is not among scipy's documented options: it is passed through to HiGHS.
        warnings.simplefilter("ignore", OptimizeWarning)
        return linprog(
            program.cost,
            A_ub=program.inequalities if program.inequalities.shape[0] else None,
            b_ub=program.limits if program.inequalities.shape[0] else None,
            A_eq=program.equalities,
            b_eq=program.rhs,
            method=method,
            options=options,
        )


def _no_crossover() -> bool | str:
    """HiGHS' option as the scipy at hand takes it: a bool before 1.15, then a string."""
    major, minor = (int(part) for part in scipy.__version__.split(".")[:2])
    return False if (major, minor) < (1, 15) else "off"
