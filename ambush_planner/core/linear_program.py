"""The paper's linear program (its equation 6), solved by HiGHS through scipy."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from scipy.optimize import OptimizeResult, OptimizeWarning, linprog
from scipy.sparse import csr_matrix, hstack, vstack

from .errors import BudgetInfeasible, SolverFailed, TimeLimit
from .game import Game
from .game_value import indifferent_ambusher
from .network import IndexArray
from .outcome import Outcome
from .risk_map import FloatArray

LIMIT_REACHED, INFEASIBLE = 1, 2
# HiGHS' own tolerances, far below the certificate's.
TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """minimise cost' v, ``inequalities v <= limits``, ``equalities v = rhs``, v = (p, z) >= 0.

    p are the expected uses of the playable edges ``edge`` (m,). Rows of ``inequalities``: one a
    site, ``sum p into j - z / alpha_j <= 0``, and last, where a budget is set, ``l' p <= budget``.
    """

    edge: IndexArray
    cost: FloatArray
    inequalities: csr_matrix
    limits: FloatArray
    equalities: csr_matrix
    rhs: FloatArray


def linear_program(game: Game, length_weight: float, budget: float) -> LinearProgram:
    """Build the program: (1 - w) z + w l' p under D p <= z, A p = b and l' p <= budget."""
    network = game.network
    edge = np.flatnonzero(game.playable)
    lengths = network.lengths[edge]
    cost = np.append(length_weight * lengths, 1.0 - length_weight)
    per_loss = -1.0 / game.loss[game.sites]
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
    program = linear_program(game, length_weight, np.inf)
    result = _run(program, solver, budget, deadline)
    row_added = float(game.network.lengths[program.edge] @ result.x[:-1]) > budget * (1 + 1e-9)
    if row_added:
        program = linear_program(game, length_weight, budget)
        result = _run(program, solver, budget, deadline)
    p = np.zeros(len(game.network.edges))
    p[program.edge] = np.maximum(result.x[:-1], 0.0)
    reference = budget if length_weight == 0.0 else float(p @ game.network.lengths)
    return _with_ambusher(game, p, result, length_weight, row_added, reference)


def _with_ambusher(
    game: Game,
    p: FloatArray,
    result: OptimizeResult,
    length_weight: float,
    row_added: bool,
    budget: float,
) -> Outcome:
    """Read q and the price of length off the duals of the inequalities."""
    duals = np.maximum(-np.asarray(result.ineqlin.marginals), 0.0)
    q = np.zeros(game.node_count)
    q[game.sites] = duals[: len(game.sites)] / game.loss[game.sites]
    total = q.sum()
    if total <= 0.0:
        return Outcome(p, indifferent_ambusher(game), budget, 0.0, int(result.nit))
    price = length_weight + (duals[-1] if row_added else 0.0)
    if price == 0.0:
        budget = max(budget, float(p @ game.network.lengths))
    return Outcome(p, q / total, budget, price / total, int(result.nit))


def _run(program: LinearProgram, solver: str, budget: float, deadline: float) -> OptimizeResult:
    options: dict[str, Any] = {
        "primal_feasibility_tolerance": TOLERANCE,
        "dual_feasibility_tolerance": TOLERANCE,
    }
    if np.isfinite(deadline):
        options["time_limit"] = max(deadline - time.monotonic(), 1e-3)
    if solver == "interior_point":
        options |= {"run_crossover": _no_crossover()}
    with warnings.catch_warnings():
        # run_crossover is not among scipy's documented options: it is passed through to HiGHS.
        warnings.simplefilter("ignore", OptimizeWarning)
        result = linprog(
            program.cost,
            A_ub=program.inequalities if program.inequalities.shape[0] else None,
            b_ub=program.limits if program.inequalities.shape[0] else None,
            A_eq=program.equalities,
            b_eq=program.rhs,
            method="highs-ipm" if solver == "interior_point" else "highs-ds",
            options=options,
        )
    if result.status == LIMIT_REACHED:
        raise TimeLimit(f"{solver}: time is up after {result.nit} iterations")
    if result.status == INFEASIBLE:
        raise BudgetInfeasible(f"{solver}: no strategy fits the length budget of {budget:.3f} m")
    if result.x is None or result.status != 0:
        raise SolverFailed(f"{solver}: {result.message}")
    return result


def _no_crossover() -> bool | str:
    """HiGHS' option as the scipy at hand takes it: a bool before 1.15, then a string."""
    major, minor = (int(part) for part in scipy.__version__.split(".")[:2])
    return False if (major, minor) < (1, 15) else "off"
