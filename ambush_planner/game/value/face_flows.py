# SPDX-License-Identifier: Apache-2.0
"""Circulations of greatest gain on graphs that only grow.

    minimise cost' x   subject to   A x = 0,   low <= x <= high

Column e of A takes x_e from the node tail_e and brings it to the node head_e. Columns that join at
0 and costs that change keep the basis feasible, so the primal simplex method goes on from it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import FloatArray, IndexArray
from .growing_program import PRIMAL_SIMPLEX, GrowingProgram

# HiGHS' own.
_TOLERANCE = 1e-7


class FaceFlows(GrowingProgram):
    """The linear program; its duals are the potential of the nodes, which are its rows."""

    def __init__(self) -> None:
        super().__init__(PRIMAL_SIMPLEX, _TOLERANCE)
        self._free: list[int] = []

    def add_nodes(self, count: int) -> IndexArray:
        """Add nodes, in balance; return their numbers."""
        return self.add_rows(np.zeros(count), np.zeros(count), csr_matrix((count, self.columns)))

    def release(self, node: int) -> None:
        """Let a node be out of balance: the others of its graph then say all."""
        self._model.changeRowBounds(node, -self._highs.kHighsInf, self._highs.kHighsInf)
        self._free.append(node)

    def add_arcs(self, nodes: IndexArray, entries: FloatArray, cost: FloatArray, low: FloatArray,
                 high: FloatArray) -> IndexArray:
        """Add columns with ``entries`` (K, 2) at ``nodes`` (K, 2). Return their numbers."""
        count = len(nodes)
        return self.add_columns(cost, low, high, csr_matrix(
            (entries.ravel(), nodes.ravel(), 2 * np.arange(count + 1)), (count, self.rows)))

    def start_at(self, limit: IndexArray) -> None:
        """Begin with each column at its lower (-1) or upper (1) limit, or in the basis (0)."""
        status = {-1: self._highs.HighsBasisStatus.kLower, 0: self._highs.HighsBasisStatus.kBasic,
                  1: self._highs.HighsBasisStatus.kUpper}
        basis = self._highs.HighsBasis()
        basis.col_status = [status[each] for each in limit.tolist()]
        rows = np.full(self.rows, -1)
        rows[self._free] = 0
        basis.row_status = [status[each] for each in rows.tolist()]
        basis.valid = True
        self._model.setBasis(basis)
