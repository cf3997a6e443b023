# SPDX-License-Identifier: Apache-2.0
"""A linear program that only grows, in the memory of HiGHS.

    minimise cost' x   subject to   least <= A x <= most,   low <= x <= high

Each solve goes on from the basis of the last one: columns that join keep it feasible for the primal
simplex method, rows for the dual one.
"""

from __future__ import annotations

import importlib.util
import time
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import FloatArray, IndexArray
from ...errors import SolverFailed, TimeLimit

HAS_HIGHSPY = importlib.util.find_spec('highspy') is not None

# HiGHS' options, with devex prices (1).
_OPTIONS: dict[str, Any] = {
    'output_flag': False, 'threads': 1, 'solver': 'simplex', 'presolve': 'off',
    'simplex_primal_edge_weight_strategy': 1,
}
# HiGHS' simplex methods: one that fits the basis, or the primal one.
ANY_SIMPLEX, PRIMAL_SIMPLEX = 0, 4


class Solution(NamedTuple):
    """x (columns,), the duals of the rows, and the cost."""

    x: FloatArray
    duals: FloatArray
    cost: float


@cache
def quiet_model() -> Any:
    """The class that ``highspy.Highs`` extends, which does not greet on the standard output.

    ``highspy.Highs`` itself if that class has changed: it must find x of three equations.
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


class GrowingProgram:
    """The program; rows and columns are numbered as they come."""

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


def _by_rows(entries: csr_matrix) -> tuple[int, IndexArray, IndexArray, FloatArray]:
    """Number of entries, and the arrays of a matrix by rows, as HiGHS takes them."""
    return (entries.nnz, entries.indptr[:-1].astype(np.int32), entries.indices.astype(np.int32),
            entries.data.astype(np.float64))


def _time_left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit('the time limit passed before a linear program was solved')
    return left
