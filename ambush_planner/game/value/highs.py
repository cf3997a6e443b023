# SPDX-License-Identifier: Apache-2.0
"""HiGHS through scipy, with workarounds for its versions."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from scipy.sparse import csr_matrix

from ...arrays import ROUNDING, FloatArray
from ...errors import SolverFailed, TimeLimit

if TYPE_CHECKING:  # loading scipy.optimize is slow, see entropy_search
    from scipy.optimize import OptimizeResult

OPTIMAL, LIMIT_REACHED, INFEASIBLE = 0, 1, 2  # greater: unbounded, or numerical trouble
# Values of ipm_optimality_tolerance to try in turn, none finer than requested: one is finer than
# HiGHS' default of 1e-8, the other coarser.
OPTIMALITY = (1e-11, 1e-7)
# HiGHS' primal and dual feasibility tolerances, as a share of a rough precision.
FEASIBILITY = 2e-6


@dataclass(frozen=True, eq=False)
class LP:
    """Linear program: minimise cost' v, ``inequalities v <= limits``, ``equalities v = rhs``.

    v >= 0, unless ``bounds`` (variables, 2) are given.
    """

    cost: FloatArray
    inequalities: csr_matrix
    limits: FloatArray
    equalities: csr_matrix
    rhs: FloatArray
    bounds: FloatArray | tuple[float, None] = field(default=(0.0, None), kw_only=True)


def run(lp: LP, solver: str, deadline: float, presolve: bool = True,
        precision: float = OPTIMALITY[0]) -> OptimizeResult:
    """Solve by 'interior_point' (without crossover) or 'simplex' until ``deadline``.

    The interior point method ends at the relative gap ``precision``; it tries first with or without
    ``presolve``: on flow LPs, HiGHS ends in an unknown state less often without. Returns scipy's
    result, with status ``OPTIMAL`` or ``INFEASIBLE``; raises TimeLimit or SolverFailed.
    """
    tolerance = max(ROUNDING, FEASIBILITY * precision)
    options: dict[str, Any] = {'primal_feasibility_tolerance': tolerance,
                               'dual_feasibility_tolerance': tolerance}
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit(f'{solver}: the time limit passed before the first iteration')
    if np.isfinite(left):
        options['time_limit'] = left
    if solver == 'interior_point':
        result = _interior_point(lp, options, presolve, precision)
    else:
        result = _linprog(lp, 'highs-ds', options)
    if result.status == LIMIT_REACHED:
        raise TimeLimit(f'{solver}: the time limit passed after {result.nit} iterations')
    if result.status != INFEASIBLE and (result.x is None or result.status != OPTIMAL):
        raise SolverFailed(f'{solver}: {result.message}')
    return result


def run_either(lp: LP, first: str, deadline: float, presolve: bool = True,
               precision: float = OPTIMALITY[0]) -> OptimizeResult:
    """Solve by the ``first`` solver, or by the other one if HiGHS ends in an unknown state."""
    try:
        return run(lp, first, deadline, presolve, precision)
    except SolverFailed:
        other = 'simplex' if first == 'interior_point' else 'interior_point'
        return run(lp, other, deadline)


def _interior_point(lp: LP, options: dict[str, Any], presolve_first: bool,
                    precision: float) -> OptimizeResult:
    """Run without crossover; if HiGHS ends in an unknown state, try other tolerances.

    HiGHS 1.2 (scipy 1.11) also does so if its presolve removes everything.
    """
    major, minor = (int(part) for part in scipy.__version__.split('.')[:2])
    no_crossover = False if (major, minor) < (1, 15) else 'off'
    options = {**options, 'run_crossover': no_crossover}
    for presolve in (presolve_first, not presolve_first):
        for tolerance in sorted({max(precision, each) for each in OPTIMALITY}):
            tried = {'presolve': presolve, 'ipm_optimality_tolerance': tolerance}
            if tolerance > max(OPTIMALITY):  # newer versions would call the result's state unknown
                tried |= dict.fromkeys(('optimality_tolerance', 'primal_residual_tolerance',
                                        'dual_residual_tolerance'), tolerance)
            result = _linprog(lp, 'highs-ipm', options | tried)
            if result.status <= INFEASIBLE:
                return result
    return result


def _linprog(lp: LP, method: str, options: dict[str, Any]) -> OptimizeResult:
    from scipy.optimize import OptimizeWarning, linprog

    constrained = lp.inequalities.shape[0] > 0
    with warnings.catch_warnings():
        # scipy does not document run_crossover, but passes it through to HiGHS.
        warnings.simplefilter('ignore', OptimizeWarning)
        return linprog(lp.cost, A_ub=lp.inequalities if constrained else None,
                       b_ub=lp.limits if constrained else None, A_eq=lp.equalities,
                       b_eq=lp.rhs, bounds=lp.bounds, method=method, options=options)

