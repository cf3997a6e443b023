# SPDX-License-Identifier: Apache-2.0
"""A linear program that only grows.

    minimise cost' x   subject to   least <= A x <= most,   low <= x <= high

In the memory of HiGHS (highspy), each solve starts from the basis of the previous one. It stays
feasible for the primal simplex method when columns are added, and for the dual simplex method when
rows are. Without highspy, scipy solves it from the start each time.
"""

from __future__ import annotations

import importlib.util
import time
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ...arrays import FloatArray, IndexArray
from ...errors import SolverFailed, TimeLimit
from . import highs

HAS_HIGHSPY = importlib.util.find_spec('highspy') is not None

# HiGHS' options, with devex prices (1).
_OPTIONS: dict[str, Any] = {
    'output_flag': False, 'threads': 1, 'solver': 'simplex', 'presolve': 'off',
    'simplex_primal_edge_weight_strategy': 1,
}
# HiGHS' simplex methods: the one that suits the basis, or the primal one.
ANY_SIMPLEX, PRIMAL_SIMPLEX = 0, 4


class Solution(NamedTuple):
    """Solution of a program: ``x`` (columns,), the ``duals`` (rows,), and the cost."""

    x: FloatArray
    duals: FloatArray
    cost: float


@cache
def quiet_model() -> Any:
    """Return the base class of ``highspy.Highs``, which prints no banner to the standard output.

    If a later version has changed it, so that it does not solve three equations, return
    ``highspy.Highs`` itself.
    """
    import highspy

    quiet: Any = highspy.Highs.__base__
    model, find = quiet(), np.array([4.0, -1.0, 2.0])
    try:
        _set_options(model, _OPTIONS)  # HiGHS keeps the number of threads of its first run
        model.addCols(3, np.ones(3), np.full(3, -9.0), np.full(3, 9.0), 0, np.zeros(3, np.int32),
                      np.zeros(0, np.int32), np.zeros(0))
        rows = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]])
        model.addRows(3, rows @ find, rows @ find, 9, 3 * np.arange(3, dtype=np.int32),
                      np.tile(np.arange(3, dtype=np.int32), 3), rows.ravel())
        model.run()
        found = np.allclose(model.getSolution().col_value, find)
    except (AttributeError, TypeError):
        found = False
    return quiet if found else highspy.Highs


def _set_options(model: Any, options: dict[str, Any]) -> None:
    for name, setting in options.items():
        model.setOptionValue(name, setting)


class HighsProgram:
    """The program in HiGHS' memory; rows and columns are numbered in the order of their addition.

    ``simplex`` is HiGHS' method; limits are kept to ``tolerance``.
    """

    def __init__(self, simplex: int, tolerance: float) -> None:
        import highspy

        self._highs, self._model = highspy, quiet_model()()
        _set_options(self._model, _OPTIONS | {
            'simplex_strategy': simplex, 'primal_feasibility_tolerance': tolerance,
            'dual_feasibility_tolerance': tolerance})
        self.rows = self.columns = 0

    def add_rows(self, least: FloatArray, most: FloatArray, entries: csr_matrix) -> IndexArray:
        """Add rows with limits (K,) and ``entries`` (K, columns); return their numbers."""
        count = len(least)
        self._model.addRows(count, least, most, *_by_rows(entries))
        self.rows += count
        return np.arange(self.rows - count, self.rows)

    def add_columns(self, cost: FloatArray, low: FloatArray, high: FloatArray,
                    entries: csr_matrix) -> IndexArray:
        """Add columns with costs and limits (K,), and ``entries`` (K, rows).

        Returns their numbers.
        """
        count = len(cost)
        self._model.addCols(count, cost, low, high, *_by_rows(entries))
        self.columns += count
        return np.arange(self.columns - count, self.columns)

    def change_costs(self, columns: IndexArray, cost: FloatArray) -> None:
        """Change the costs of columns (K,)."""
        self._model.changeColsCost(len(columns), columns.astype(np.int32), cost)

    def free_row(self, row: int) -> None:
        """Drop the limits of a row."""
        self._model.changeRowBounds(row, -self._highs.kHighsInf, self._highs.kHighsInf)

    def start_at(self, columns: IndexArray, rows: IndexArray) -> None:
        """Set the first basis: each at its lower (-1) or upper (1) limit, or basic (0)."""
        status = {-1: self._highs.HighsBasisStatus.kLower, 0: self._highs.HighsBasisStatus.kBasic,
                  1: self._highs.HighsBasisStatus.kUpper}
        basis = self._highs.HighsBasis()
        basis.col_status = [status[each] for each in columns.tolist()]
        basis.row_status = [status[each] for each in rows.tolist()]
        basis.valid = True
        self._model.setBasis(basis)

    def solve(self, deadline: float) -> Solution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        left = _time_left(deadline)
        if np.isfinite(left):  # HiGHS' limit is one for all runs together
            self._model.setOptionValue('time_limit', self._model.getRunTime() + left)
        self._model.run()
        status = self._model.getModelStatus()
        if status != self._highs.HighsModelStatus.kOptimal:
            _time_left(deadline)
            raise SolverFailed('HiGHS ended a linear program with the status '
                               f'{self._model.modelStatusToString(status)}')
        found = self._model.getSolution()
        return Solution(np.array(found.col_value), np.array(found.row_dual),
                        self._model.getInfo().objective_function_value)


class ScipyProgram:
    """The same without highspy."""

    def __init__(self, simplex: int, tolerance: float) -> None:
        self._tolerance, self.rows, self.columns = tolerance, 0, 0
        self._matrix = csr_matrix((0, 0))
        self._least, self._most, self._cost, self._low, self._high = (np.zeros(0) for _ in range(5))

    def add_rows(self, least: FloatArray, most: FloatArray, entries: csr_matrix) -> IndexArray:
        """See ``HighsProgram.add_rows``."""
        self._matrix = csr_matrix(vstack((self._matrix, entries)))
        self._least, self._most = np.append(self._least, least), np.append(self._most, most)
        self.rows = len(self._least)
        return np.arange(self.rows - len(least), self.rows)

    def add_columns(self, cost: FloatArray, low: FloatArray, high: FloatArray,
                    entries: csr_matrix) -> IndexArray:
        """See ``HighsProgram.add_columns``."""
        self._matrix = csr_matrix(hstack((self._matrix, entries.T)))
        self._cost = np.append(self._cost, cost)
        self._low, self._high = np.append(self._low, low), np.append(self._high, high)
        self.columns = len(self._cost)
        return np.arange(self.columns - len(cost), self.columns)

    def change_costs(self, columns: IndexArray, cost: FloatArray) -> None:
        """Change the costs of columns (K,)."""
        self._cost[columns] = cost

    def free_row(self, row: int) -> None:
        """Drop the limits of a row."""
        self._least[row], self._most[row] = -np.inf, np.inf

    def start_at(self, columns: IndexArray, rows: IndexArray) -> None:
        """Do nothing: each solve chooses its own first basis."""

    def solve(self, deadline: float) -> Solution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        equal = np.flatnonzero(self._least == self._most)
        above = np.flatnonzero((self._least != self._most) & (self._most < np.inf))
        below = np.flatnonzero((self._least != self._most) & (self._least > -np.inf))
        lp = highs.LP(self._cost, csr_matrix(vstack((self._matrix[above], -self._matrix[below]))),
                      np.append(self._most[above], -self._least[below]), self._matrix[equal],
                      self._least[equal], bounds=np.column_stack((self._low, self._high)))
        found = highs.run(lp, 'simplex', deadline, precision=self._tolerance / highs.FEASIBILITY)
        if found.x is None:
            raise SolverFailed(f'HiGHS ended a linear program: {found.message}')
        duals, marginals = np.zeros(self.rows), np.asarray(found.ineqlin.marginals)
        duals[equal] = found.eqlin.marginals
        duals[above] += marginals[:len(above)]
        duals[below] -= marginals[len(above):]
        return Solution(np.array(found.x), duals, float(found.fun))


if TYPE_CHECKING or HAS_HIGHSPY:
    GrowingProgram = HighsProgram
else:
    GrowingProgram = ScipyProgram


def _by_rows(entries: csr_matrix) -> tuple[int, IndexArray, IndexArray, FloatArray]:
    """Number of entries and the arrays of a matrix by rows, as HiGHS takes them."""
    return (entries.nnz, entries.indptr[:-1].astype(np.int32), entries.indices.astype(np.int32),
            entries.data.astype(np.float64))


def _time_left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit('the time limit passed before a linear program was solved')
    return left
