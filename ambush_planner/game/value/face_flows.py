# SPDX-License-Identifier: Apache-2.0
"""Circulations of greatest gain on a graph that only grows, by HiGHS.

    minimise cost' x   subject to   A x = 0,   low <= x <= high

Column e of A takes x_e from the node tail_e and brings it to the node head_e. With ``highspy`` the
model stays in HiGHS' memory: columns that join at 0 and costs that change keep the basis feasible,
so the primal simplex method goes on from it. Without ``highspy``, scipy's linprog solves each
LP from nothing.
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
from . import highs

HAS_HIGHSPY = importlib.util.find_spec('highspy') is not None

# HiGHS' options: primal simplex (4) with devex prices (1), which keeps a feasible basis.
_OPTIONS: dict[str, Any] = {
    'output_flag': False, 'threads': 1, 'solver': 'simplex', 'simplex_strategy': 4,
    'presolve': 'off', 'simplex_primal_edge_weight_strategy': 1,
}


class FlowSolution(NamedTuple):
    """x (columns,), the potential (nodes,) of the nodes, 0 at the first, and the cost."""

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


class KeptFlows:
    """The LP in HiGHS' memory."""

    def __init__(self) -> None:
        import highspy

        self._status, self._infinity = highspy.HighsBasisStatus, highspy.kHighsInf
        self._new_basis, self._optimal = highspy.HighsBasis, highspy.HighsModelStatus.kOptimal
        self._model = _with_options(quiet_model()())
        self._nodes = 0

    def add_nodes(self, count: int) -> None:
        """Add nodes; the very first one need not be balanced."""
        none = np.zeros(0)
        self._model.addRows(count, np.zeros(count), np.zeros(count), 0, np.zeros(count, np.int32),
                            none.astype(np.int32), none)
        if not self._nodes:
            self._model.changeRowBounds(0, -self._infinity, self._infinity)
        self._nodes += count

    def add_columns(self, tail: IndexArray, head: IndexArray, cost: FloatArray, low: FloatArray,
                    high: FloatArray) -> None:
        """Add columns (K,)."""
        count = len(tail)
        self._model.addCols(count, cost, low, high, 2 * count, 2 * np.arange(count, dtype=np.int32),
                            np.column_stack((tail, head)).ravel().astype(np.int32),
                            np.tile([1.0, -1.0], count))

    def start_at(self, limit: IndexArray) -> None:
        """Begin with each column at its lower (-1) or upper (1) limit, or in the basis (0)."""
        status = {-1: self._status.kLower, 0: self._status.kBasic, 1: self._status.kUpper}
        basis = self._new_basis()
        basis.col_status = [status[each] for each in limit.tolist()]
        basis.row_status = [status[0]] + [status[-1]] * (self._nodes - 1)
        basis.valid = True
        self._model.setBasis(basis)

    def change_costs(self, first: int, cost: FloatArray) -> None:
        """Change the costs of the columns from ``first`` on."""
        columns = first + np.arange(len(cost), dtype=np.int32)
        self._model.changeColsCost(len(cost), columns, cost)

    def solve(self, deadline: float) -> FlowSolution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        left = _time_left(deadline)
        if np.isfinite(left):  # HiGHS' limit is one for all runs together
            self._model.setOptionValue('time_limit', self._model.getRunTime() + left)
        self._model.run()
        if self._model.getModelStatus() != self._optimal:
            _time_left(deadline)
            raise SolverFailed('HiGHS ended the LP in potentials with the status '
                               f'{self._model.modelStatusToString(self._model.getModelStatus())}')
        found = self._model.getSolution()
        return _solution(np.array(found.col_value), np.array(found.row_dual),
                         self._model.getInfo().objective_function_value)


class RepeatedFlows:
    """The same LP, solved from nothing each time."""

    def __init__(self) -> None:
        self._nodes, self._columns = 0, np.zeros((5, 0))

    def add_nodes(self, count: int) -> None:
        """Add nodes; the very first one need not be balanced."""
        self._nodes += count

    def add_columns(self, tail: IndexArray, head: IndexArray, cost: FloatArray, low: FloatArray,
                    high: FloatArray) -> None:
        """Add columns (K,)."""
        self._columns = np.hstack((self._columns, [tail, head, cost, low, high]))

    def start_at(self, limit: IndexArray) -> None:
        """Nothing: linprog takes no basis."""

    def change_costs(self, first: int, cost: FloatArray) -> None:
        """Change the costs of the columns from ``first`` on."""
        self._columns[2, first:] = cost

    def solve(self, deadline: float) -> FlowSolution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        tail, head, cost, low, high = self._columns
        each = np.arange(len(tail))
        places = np.concatenate((tail, head)).astype(np.int64), np.concatenate((each, each))
        balance = csr_matrix((np.repeat([1.0, -1.0], len(each)), places), (self._nodes, len(each)))
        lp = highs.LP(cost, csr_matrix((0, len(each))), np.zeros(0), balance[1:],
                      np.zeros(self._nodes - 1), bounds=np.column_stack((low, high)))
        found = highs.run(lp, 'simplex', deadline)
        return _solution(found.x, np.append(0.0, found.eqlin.marginals), float(found.fun))


class LegFlows:
    """One such LP for each leg of a trip: legs have no nodes in common."""

    def __init__(self, legs: int) -> None:
        self._lps = [new_flows() for _ in range(legs)]
        # The leg of each node and each column, and their numbers there.
        self._nodes, self._columns = (_Numbers(legs) for _ in range(2))

    def add_nodes(self, leg: IndexArray) -> None:
        """Add nodes on the legs (K,)."""
        for lp, count in zip(self._lps, self._nodes.add(leg), strict=True):
            lp.add_nodes(count)

    def add_columns(self, tail: IndexArray, head: IndexArray, cost: FloatArray, low: FloatArray,
                    high: FloatArray) -> None:
        """Add columns (K,), each between two nodes of a leg."""
        leg, number = self._nodes.leg[tail], self._nodes.number
        self._columns.add(leg)
        for k, lp in enumerate(self._lps):
            own = leg == k
            lp.add_columns(number[tail[own]], number[head[own]], cost[own], low[own], high[own])

    def start_at(self, limit: IndexArray) -> None:
        """Begin with each column at its lower (-1) or upper (1) limit, or in the basis (0)."""
        for k, lp in enumerate(self._lps):
            lp.start_at(limit[self._columns.leg == k])

    def change_costs(self, first: int, cost: FloatArray) -> None:
        """Change the costs of the columns from ``first`` on."""
        before, after = np.split(self._columns.leg, [first])
        for k, lp in enumerate(self._lps):
            lp.change_costs(int(np.count_nonzero(before == k)), cost[after == k])

    def solve(self, deadline: float) -> FlowSolution:
        """Solve; raises TimeLimit at the ``deadline`` (``time.monotonic``), or SolverFailed."""
        x, potential = np.empty(len(self._columns.leg)), np.empty(len(self._nodes.leg))
        cost = 0.0
        for k, lp in enumerate(self._lps):
            found = lp.solve(deadline)
            x[self._columns.leg == k], potential[self._nodes.leg == k] = found.x, found.potential
            cost += found.cost
        return FlowSolution(x, potential, cost)


class _Numbers:
    """The legs (K,) of some things, and their numbers on them."""

    def __init__(self, legs: int) -> None:
        self.leg, self.number = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._count = np.zeros(legs, dtype=np.int64)

    def add(self, leg: IndexArray) -> list[int]:
        """Add things on the legs (K,); return how many are on each."""
        count = np.bincount(leg, minlength=len(self._count))
        number = np.empty(len(leg), dtype=np.int64)
        for k in range(len(count)):
            number[leg == k] = self._count[k] + np.arange(count[k])
        self.leg, self.number = np.append(self.leg, leg), np.append(self.number, number)
        self._count = self._count + count
        return [int(each) for each in count]


def new_flows() -> KeptFlows | RepeatedFlows:
    """An empty LP: in HiGHS' memory if ``highspy`` is installed."""
    return KeptFlows() if HAS_HIGHSPY else RepeatedFlows()


def _solution(x: FloatArray, potential: FloatArray, cost: float) -> FlowSolution:
    return FlowSolution(x, potential - potential[0], cost)


def _time_left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeLimit('the time limit passed before the LP in potentials was solved')
    return left
