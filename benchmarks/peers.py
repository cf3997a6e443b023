"""The same problems in the form that other solvers take.

HiGHS (Huangfu and Hall, 2018) gets the linear program for the value, with or without the strategy's
length budget; Clarabel (Goulart and Chen, 2024), a conic interior point method, gets the entropy
problem on the strategy's own edges. Both run on one thread with their default tolerances. What is
timed is the solver alone, not the making of its matrices.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import clarabel
import highspy
import numpy as np
from scipy.sparse import csc_matrix, identity, vstack

from ambush_planner import GameOptions, Network
from ambush_planner.core.arrays import IndexArray
from ambush_planner.core.game import make_game
from ambush_planner.core.linear_program import linear_program

Answer = dict[str, Any]
# What they call an answer that they stand by.
SOLVED = ("Optimal", "Solved", "AlmostSolved")


@dataclass(frozen=True, eq=False)
class EntropyProblem:
    """Largest -sum p ln p of a unit flow on ``edges`` (K,), visits and length within limits.

    ``value`` bounds alpha_j x_j at every node, ``length`` the expected length [m].
    """

    edges: IndexArray
    value: float
    length: float


def _answer(status: str, seconds: float, iterations: int, **result: float) -> Answer:
    """The result only of a solver that stands by it; of another that it failed."""
    answer = {"seconds": seconds, "iterations": iterations, "status": status}
    return answer | (result if status in SOLVED else {"failed": True})


def highs(network: Network, budget: float, solver: str) -> Callable[[], Answer]:
    """Prepare the linear program for HiGHS; ``solver`` 'simplex' (dual) or 'ipx' (no crossover).

    An infinite ``budget`` leaves the row of the expected length [m] out.
    """
    program = linear_program(make_game(network, GameOptions()), 0.0, budget, unit=1.0)
    matrix = vstack((program.inequalities, program.equalities)).tocsc()
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = matrix.shape
    model.col_cost_ = program.cost
    model.col_lower_ = np.zeros(matrix.shape[1])
    model.col_upper_ = np.full(matrix.shape[1], np.inf)
    nothing = np.full(len(program.limits), -np.inf)
    model.row_lower_ = np.concatenate((nothing, program.rhs))
    model.row_upper_ = np.concatenate((program.limits, program.rhs))
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_, model.a_matrix_.index_ = matrix.indptr, matrix.indices
    model.a_matrix_.value_ = matrix.data

    def run() -> Answer:
        engine = highspy.Highs()
        for name, setting in (
            ("output_flag", False),
            ("threads", 1),
            ("solver", solver),
            ("run_crossover", "off"),
        ):
            engine.setOptionValue(name, setting)
        engine.passModel(model)
        started = time.process_time()
        engine.run()
        seconds = time.process_time() - started
        status, info = engine.getModelStatus(), engine.getInfo()
        return _answer(
            engine.modelStatusToString(status),
            seconds,
            max(info.simplex_iteration_count, info.ipm_iteration_count),
            value=info.objective_function_value,
        )

    return run


def clarabel_entropy(network: Network, problem: EntropyProblem) -> Callable[[], Answer]:
    """Prepare the entropy problem for Clarabel.

    Variables (p, t): (t_k, p_k, 1) in the exponential cone says t_k <= -p_k ln p_k. The slack
    b - A v is 0 for conservation and >= 0 for the limits, then comes one cone an edge.
    """
    edges, m = problem.edges, len(problem.edges)
    ends = network.edges[edges].T
    column, shape = np.arange(m), (len(network.points), m)
    out, into = (csc_matrix((np.ones(m), (end, column)), shape=shape) for end in ends)
    node = np.setdiff1d(ends, [network.target])
    with np.errstate(divide="ignore"):
        capacity = problem.value / network.alpha
    capped = node[capacity[node] < 1.0]  # a node is visited once at the most
    flow = vstack(
        ((out - into)[node], into[capped], csc_matrix(network.lengths[edges] / problem.length))
    ).tocsc()
    flow.resize((flow.shape[0], 2 * m))
    cones = vstack((identity(2 * m), csc_matrix((m, 2 * m)))).tocsr()
    triples = np.arange(3 * m).reshape(3, m)[[1, 0, 2]].T.ravel()
    matrix = vstack((flow, -cones[triples])).tocsc()
    supply = (node == network.source).astype(float)
    right = np.concatenate((supply, capacity[capped], [1.0], np.tile([0.0, 0.0, 1.0], m)))
    kinds = [clarabel.ZeroConeT(len(node)), clarabel.NonnegativeConeT(len(capped) + 1)]
    kinds += [clarabel.ExponentialConeT()] * m
    cost = np.concatenate((np.zeros(m), -np.ones(m)))
    nothing = csc_matrix((2 * m, 2 * m))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1

    def run() -> Answer:
        started = time.process_time()
        found = clarabel.DefaultSolver(nothing, cost, matrix, right, kinds, settings).solve()
        seconds = time.process_time() - started
        return _answer(
            str(found.status), seconds, found.iterations, entropy=-found.obj_val
        )

    return run
