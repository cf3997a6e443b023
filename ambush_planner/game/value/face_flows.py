# SPDX-License-Identifier: Apache-2.0
"""Circulations of greatest gain on graphs that only grow, by HiGHS.

    minimise cost' x   subject to   A x = 0,   low <= x <= high

Column e of A takes x_e from the node tail_e and brings it to the node head_e. The model stays in
HiGHS' memory: columns that join at 0 and costs that change keep the basis feasible, so the primal
simplex method goes on from it.
"""

from __future__ import annotations

import importlib.util
import time
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ...arrays import FloatArray, IndexArray
from ...errors import SolverFailed, TimeLimit

HAS_HIGHSPY = importlib.util.find_spec('highspy') is not None

# HiGHS' options: primal simplex (4) with devex prices (1), which keeps a feasible basis.
_OPTIONS: dict[str, Any] = {
    'output_flag': False, 'threads': 1, 'solver': 'simplex', 'simplex_strategy': 4,
    'presolve': 'off', 'simplex_primal_edge_weight_strategy': 1,
}


class FlowSolution(NamedTuple):
    """x (columns,), the potential (nodes,), and the cost."""

    x: FloatArray
    potential: FloatArray
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
        _with_options(model)  # HiGHS keeps the number of threads of its first run
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


def _with_options(model: Any) -> Any:
    for name, setting in _OPTIONS.items():
        model.setOptionValue(name, setting)
    return model


class FaceFlows:
    """The linear program in HiGHS' memory; nodes, rows and columns are numbered as they come."""

    def __init__(self) -> None:
        import highspy

        self._highs = highspy
        self._model = _with_options(quiet_model()())
        self._rows = self._columns = 0
        self._free: list[int] = []

    def add_nodes(self, count: int) -> IndexArray:
        """Add nodes, in balance; return their numbers."""
        none = np.zeros(0)
        self._model.addRows(count, np.zeros(count), np.zeros(count), 0, np.zeros(count, np.int32),
                            none.astype(np.int32), none)
        self._rows += count
        return np.arange(self._rows - count, self._rows)

    def release(self, node: int) -> None:
        """Let a node be out of balance: the others of its graph then say all."""
        self._model.changeRowBounds(node, -self._highs.kHighsInf, self._highs.kHighsInf)
        self._free.append(node)

    def add_columns(self, rows: IndexArray, entries: FloatArray, cost: FloatArray, low: FloatArray,
                    high: FloatArray) -> IndexArray:
        """Add columns with ``entries`` (K, 2) in ``rows`` (K, 2). Return their numbers."""
        count = len(rows)
        self._model.addCols(count, cost, low, high, rows.size, 2 * np.arange(count, dtype=np.int32),
                            rows.ravel().astype(np.int32), entries.ravel())
        self._columns += count
        return np.arange(self._columns - count, self._columns)

    def start_at(self, limit: IndexArray) -> None:
        """Begin with each column at its lower (-1) or upper (1) limit, or in the basis (0)."""
        status = {-1: self._highs.HighsBasisStatus.kLower, 0: self._highs.HighsBasisStatus.kBasic,
                  1: self._highs.HighsBasisStatus.kUpper}
        basis = self._highs.HighsBasis()
        basis.col_status = [status[each] for each in limit.tolist()]
        rows = np.full(self._rows, -1)
        rows[self._free] = 0
        basis.row_status = [status[each] for each in rows.tolist()]
        basis.valid = True
        self._model.setBasis(basis)

    def change_costs(self, columns: IndexArray, cost: FloatArray) -> None:
        """Change the costs of columns (K,)."""
        self._model.changeColsCost(len(columns), columns.astype(np.int32), cost)

    def solve(self, deadline: float) -> FlowSolution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        left = _time_left(deadline)
        if np.isfinite(left):  # HiGHS' limit is one for all runs together
            self._model.setOptionValue('time_limit', self._model.getRunTime() + left)
        self._model.run()
        if self._model.getModelStatus() != self._highs.HighsModelStatus.kOptimal:
            _time_left(deadline)
            raise SolverFailed('HiGHS ended the LP in potentials with the status '
                               f'{self._model.modelStatusToString(self._model.getModelStatus())}')
        found = self._model.getSolution()
        return FlowSolution(np.array(found.col_value), np.array(found.row_dual),
                            self._model.getInfo().objective_function_value)


def _time_left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit('the time limit passed before the LP in potentials was solved')
    return left
