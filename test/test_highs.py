# SPDX-License-Identifier: Apache-2.0
"""HiGHS through scipy: optimum, infeasible, no time, unbounded.

That its interior point method runs without crossover is seen in test_linear_program.
"""

import math
import time

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from ambush_planner import SolverFailed, TimeLimit
from ambush_planner.game.value import highs
from ambush_planner.game.value.highs import Program, run

SOLVERS = ('interior_point', 'simplex')


def program(limit=1.0, total=1.0) -> Program:
    """minimise -v0 - v1 under v0 <= limit, v0 + v1 + v2 = total: a face of optima."""
    return Program(
        np.array([-1.0, -1.0, 0.0]), csr_matrix([[1.0, 0.0, 0.0]]), np.array([limit]),
        csr_matrix([[1.0, 1.0, 1.0]]), np.array([total]),
    )


@pytest.mark.parametrize('solver', SOLVERS)
def test_optimum(solver):
    found = run(program(), solver, math.inf)
    assert found.status == highs.OPTIMAL
    assert found.fun == pytest.approx(-1.0, abs=1e-8)


@pytest.mark.parametrize('solver', SOLVERS)
def test_an_infeasible_program_is_a_status(solver):
    assert run(program(total=-1.0), solver, math.inf).status == highs.INFEASIBLE


@pytest.mark.parametrize('solver', SOLVERS)
def test_no_time_raises_time_limit(solver):
    with pytest.raises(TimeLimit, match='the time limit passed'):
        run(program(), solver, time.monotonic() - 1.0)


@pytest.mark.parametrize('solver', SOLVERS)
def test_an_unbounded_program_fails_by_name(solver):
    endless = program()
    free = Program(endless.cost, csr_matrix((0, 3)), np.empty(0), csr_matrix((1, 3)), np.zeros(1))
    with pytest.raises(SolverFailed, match=solver):
        run(free, solver, math.inf)
