# SPDX-License-Identifier: Apache-2.0
"""Circulations of least cost on graphs that only grow.

    minimise cost' x   subject to   A x = 0,   low <= x <= high

Column e of A takes x_e from the node tail_e and brings it to the node head_e. New columns at 0 and
changed costs keep the basis feasible, so the primal simplex method starts from it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import FloatArray, IndexArray
from .growing_program import PRIMAL_SIMPLEX, GrowingProgram

_TOLERANCE = 1e-7  # HiGHS' default


class FaceFlows(GrowingProgram):
    """LP of a circulation; rows are nodes, and their duals the potential."""

    def __init__(self) -> None:
        super().__init__(PRIMAL_SIMPLEX, _TOLERANCE)
        self._free: list[int] = []

    def add_nodes(self, count: int) -> IndexArray:
        """Add nodes at which flow balances; return their numbers."""
        return self.add_rows(np.zeros(count), np.zeros(count), csr_matrix((count, self.columns)))

    def release(self, node: int) -> None:
        """Drop the balance of a node, which follows from that of the other nodes of its graph."""
        self.free_row(node)
        self._free.append(node)

    def add_arcs(self, nodes: IndexArray, entries: FloatArray, cost: FloatArray, low: FloatArray,
                 high: FloatArray) -> IndexArray:
        """Add columns with ``entries`` (K, 2) at ``nodes`` (K, 2); return their numbers."""
        count = len(nodes)
        return self.add_columns(cost, low, high, csr_matrix(
            (entries.ravel(), nodes.ravel(), 2 * np.arange(count + 1)), (count, self.rows)))

    def start_at_limits(self, limit: IndexArray) -> None:
        """Set the first basis: each column at its lower (-1) or upper (1) limit, or basic (0)."""
        rows = np.full(self.rows, -1)
        rows[self._free] = 0
        self.start_at(limit, rows)
