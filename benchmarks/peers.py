"""The same problems for other solvers.

HiGHS (Huangfu and Hall, 2018) solves the linear program for the value, with or without the
strategy's length budget. Clarabel (Goulart and Chen, 2024), a conic interior point method,
maximises the route entropy on the strategy's own acyclic edges. Both run on one thread with default
tolerances. Only the solver is timed, not the construction of its matrices.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import clarabel
import highspy
import numpy as np
from scipy.sparse import bmat, csc_matrix, csr_matrix, identity, vstack

from ambush_planner import GameOptions, Network
from ambush_planner.arrays import IndexArray
from ambush_planner.game.game import Game, make_game
from ambush_planner.game.linear_program import linear_program

Answer = dict[str, Any]
# Statuses of a usable answer.
SOLVED = ('Optimal', 'Solved', 'AlmostSolved')


@dataclass(frozen=True, eq=False)
class EntropyProblem:
    """Maximise -sum p ln(p / x_tail) of a unit flow on acyclic ``edges`` (K,) within limits.

    ``value`` bounds alpha_j x_j at every node, ``length`` the expected length [m].
    """

    edges: IndexArray
    value: float
    length: float


def _answer(status: str, seconds: float, **result: float) -> Answer:
    """The result, or that the solver failed."""
    answer = {'seconds': seconds, 'status': status}
    return answer | (result if status in SOLVED else {'failed': True})


def highs(network: Network, game: GameOptions, budget: float, solver: str) -> Callable[[], Answer]:
    """Prepare the linear program for HiGHS; ``solver`` 'simplex' (dual) or 'ipx' (no crossover).

    With an infinite ``budget`` the row of the expected length [m] is omitted.
    """
    program = linear_program(make_game(network, game), 0.0, budget, unit=1.0)
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
            ('output_flag', False),
            ('threads', 1),
            ('solver', solver),
            ('run_crossover', 'off'),
        ):
            engine.setOptionValue(name, setting)
        engine.passModel(model)
        started = time.process_time()
        engine.run()
        seconds = time.process_time() - started
        status = engine.modelStatusToString(engine.getModelStatus())
        return _answer(status, seconds, value=engine.getInfo().objective_function_value)

    return run


def clarabel_entropy(
    network: Network, game: GameOptions, problem: EntropyProblem
) -> Callable[[], Answer]:
    """Prepare the route-entropy problem for Clarabel.

    Variables (p, t, x), where x are the visits of each node but the target: the flow into and out
    of a node is x, which keeps all rows sparse. (t_k, p_k, x_tail) in the exponential cone means
    p exp(t / p) <= x, that is t_k <= -p_k ln(p_k / x_tail). The slack b - A v is 0 for the flow and
    >= 0 for the limits, each scaled to 1, followed by one cone per edge.
    """
    m = len(problem.edges)
    tail, head = network.edges[problem.edges].T
    node = np.unique(tail)
    n, inner = len(node), node != network.source
    place = np.full(len(network.points), -1)
    place[node] = np.arange(n)
    ones, each = np.ones(m), np.arange(m)
    onward = np.flatnonzero(head != network.target)
    out = csr_matrix((ones, (place[tail], each)), shape=(n, m))
    into = csr_matrix((ones[onward], (place[head[onward]], onward)), shape=(n, m))
    unit, nothing = identity(n, format='csr'), csr_matrix((n, m))
    source = csr_matrix((np.ones(1), ([0], [place[network.source]])), shape=(1, n))
    flow = bmat([
        [out, nothing, -unit],
        [into[inner], nothing[inner], -unit[inner]],
        [csr_matrix((1, m)), csr_matrix((1, m)), source],
    ])
    supply = np.append(np.zeros(n + int(inner.sum())), 1.0)
    limits, kept = _limits(make_game(network, game), problem, node)
    lengths = csr_matrix(network.lengths[problem.edges] / problem.length)
    visits = limits[kept].shape[0]
    room = bmat([
        [csr_matrix((visits, m)), csr_matrix((visits, m)), limits[kept]],
        [lengths, csr_matrix((1, m)), csr_matrix((1, n))],
    ])
    cones = bmat([
        [None, identity(m), csr_matrix((m, n))],
        [identity(m), None, csr_matrix((m, n))],
        [csr_matrix((m, m)), csr_matrix((m, m)), csr_matrix((ones, (each, place[tail])), (m, n))],
    ]).tocsr()
    triples = np.arange(3 * m).reshape(3, m).T.ravel()
    matrix = csc_matrix(vstack((flow, room, -cones[triples])))
    right = np.concatenate((supply, np.ones(visits + 1), np.zeros(3 * m)))
    kinds = [clarabel.ZeroConeT(len(supply)), clarabel.NonnegativeConeT(visits + 1)]
    kinds += [clarabel.ExponentialConeT()] * m
    cost = np.concatenate((np.zeros(m), -np.ones(m), np.zeros(n)))
    quadratic = csc_matrix((2 * m + n, 2 * m + n))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1

    def run() -> Answer:
        started = time.process_time()
        found = clarabel.DefaultSolver(quadratic, cost, matrix, right, kinds, settings).solve()
        seconds = time.process_time() - started
        return _answer(str(found.status), seconds, route_entropy=-found.obj_val)

    return run


def _limits(
    game: Game, problem: EntropyProblem, node: IndexArray
) -> tuple[csr_matrix, IndexArray]:
    """Rows alpha_j x_j / value over x, and which of them can bind: a node is visited once."""
    share = game.loss[node] / problem.value
    return csr_matrix((share, (np.arange(len(node)),) * 2)), np.flatnonzero(share > 1.0)
