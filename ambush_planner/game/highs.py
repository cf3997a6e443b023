"""HiGHS through scipy: one call, with the workarounds that its versions need."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from scipy.sparse import csr_matrix

from ..arrays import FloatArray
from ..errors import SolverFailed, TimeLimit

if TYPE_CHECKING:  # see most_entropy
    from scipy.optimize import OptimizeResult

OPTIMAL, LIMIT_REACHED, INFEASIBLE, NUMERICAL_TROUBLE = 0, 1, 2, 4
# ipm_optimality_tolerance, one after the other until HiGHS is content; its default is 1e-8.
OPTIMALITY = (1e-11, 1e-8, 1e-7)
# HiGHS' own tolerances, far below the certificate's.
TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Program:
    """minimise cost' v, ``inequalities v <= limits``, ``equalities v = rhs``, v >= 0."""

    cost: FloatArray
    inequalities: csr_matrix
    limits: FloatArray
    equalities: csr_matrix
    rhs: FloatArray


def run(
    program: Program, solver: str, deadline: float, presolve: bool = True
) -> OptimizeResult:
    """Solve by 'interior_point' (without crossover) or 'simplex' until ``deadline``.

    ``presolve`` is what the interior point method tries first; without it HiGHS ends in an unknown
    state less often on flow programs. Returns scipy's result, with status ``OPTIMAL`` or
    ``INFEASIBLE``.

    Raises
    ------
    TimeLimit, SolverFailed
        As the names say.
    """
    options: dict[str, Any] = {
        'primal_feasibility_tolerance': TOLERANCE,
        'dual_feasibility_tolerance': TOLERANCE,
    }
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit(f'{solver}: time is up before the first iteration')
    if np.isfinite(left):
        options['time_limit'] = left
    if solver == 'interior_point':
        result = _interior_point(program, options, presolve)
    else:
        result = _linprog(program, 'highs-ds', options)
    if result.status == LIMIT_REACHED:
        raise TimeLimit(f'{solver}: time is up after {result.nit} iterations')
    if result.status != INFEASIBLE and (result.x is None or result.status != OPTIMAL):
        raise SolverFailed(f'{solver}: {result.message}')
    return result


def _interior_point(
    program: Program, options: dict[str, Any], presolve_first: bool
) -> OptimizeResult:
    """Run without crossover; where HiGHS ends in an unknown state, another tolerance may help.

    HiGHS 1.2 (scipy 1.11) also ends so where its presolve leaves nothing, or nothing feasible.
    """
    options = {**options, 'run_crossover': _no_crossover()}
    for presolve in (presolve_first, not presolve_first):
        for tolerance in OPTIMALITY:
            tried = {'presolve': presolve, 'ipm_optimality_tolerance': tolerance}
            result = _linprog(program, 'highs-ipm', options | tried)
            if result.status != NUMERICAL_TROUBLE:
                return result
    return result


def _linprog(program: Program, method: str, options: dict[str, Any]) -> OptimizeResult:
    from scipy.optimize import OptimizeWarning, linprog

    constrained = program.inequalities.shape[0] > 0
    with warnings.catch_warnings():
        # run_crossover is not among scipy's documented options: it is passed through to HiGHS.
        warnings.simplefilter('ignore', OptimizeWarning)
        return linprog(
            program.cost,
            A_ub=program.inequalities if constrained else None,
            b_ub=program.limits if constrained else None,
            A_eq=program.equalities,
            b_eq=program.rhs,
            method=method,
            options=options,
        )


def _no_crossover() -> bool | str:
    """HiGHS' option as the scipy at hand takes it: a bool before 1.15, then a string."""
    major, minor = (int(part) for part in scipy.__version__.split('.')[:2])
    return False if (major, minor) < (1, 15) else 'off'
