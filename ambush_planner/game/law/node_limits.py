# SPDX-License-Identifier: Apache-2.0
"""Newton's method for limits on the visits of nodes, by one sparse factorisation a step.

Let W hold the Markov chain's probabilities, X = diag(x) its visits with 0 at the source, L = 1 - W
and Q = X - W' diag(x) W. If each entry into node i costs w_i, the mean cost from a node on, its
own included, is a with L a = w, and visits change by -L'^-1 Q a: their covariance is L'^-1 Q L^-1.
So a step with (covariance + D) w = r, D a diagonal, solves

    (Q + L' D L) a = L' r,      w = L a,

a positive definite system as sparse as the network, whatever the number of limits: it joins nodes
that share an edge or a predecessor. The few other rows, such as budgets, border it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from ...arrays import BoolArray, FloatArray, IndexArray, sums
from .gibbs import AcyclicNetwork

# Most rows that may border the system.
MAX_OTHERS = 4
# Entry of D for nodes without a limit, whose costs stay as they are.
FIXED = 1e8


class NodeLimits:
    """The rows C (R, m) as limits on visits, of the nodes ``place`` in units ``unit``, and others.

    ``node`` and ``other`` are their row indices.
    """

    def __init__(self, network: AcyclicNetwork, rows: csr_matrix) -> None:
        self._network, self._rows = network, rows
        entry = rows.indptr[:-1]  # of an empty last row, it is beyond the end
        first = np.append(network.head[rows.indices], 0)[entry]
        value = np.append(rows.data, 1.0)[entry]
        whole = self._on_all_entries(first, value)
        self.node, self.other = np.flatnonzero(whole), np.flatnonzero(~whole)
        self._place, self._unit = first[self.node], 1.0 / value[self.node]

    @property
    def fits(self) -> bool:
        """Whether all rows but a few limit the visits of different nodes."""
        different = len(np.unique(self._place)) == len(self._place)
        return different and len(self.node) > 0 and len(self.other) <= MAX_OTHERS

    def _on_all_entries(self, first: IndexArray, value: FloatArray) -> BoolArray:
        """Which rows (R,) have one ``value`` on exactly the edges into the node ``first``."""
        rows, head = self._rows, self._network.head
        count = np.diff(rows.indptr)
        row = np.repeat(np.arange(len(count)), count)
        whole = (count > 0) & (count == np.bincount(head, minlength=self._network.count)[first])
        whole[row[(head[rows.indices] != first[row]) | (rows.data != value[row])]] = False
        return np.asarray(whole)

    def factor(self, share: FloatArray, p: FloatArray, diagonal: FloatArray) -> None:
        """Prepare ``solve`` for the law (share, p) and the ``diagonal`` (R,) > 0.

        Raises RuntimeError if rounding made the system singular.
        """
        tail, head, n = self._network.tail, self._network.head, self._network.count
        chain = csr_matrix((share, (tail, head)), shape=(n, n))
        weight = np.full(n, FIXED)
        weight[self._place] = np.minimum(self._unit**2 * diagonal[self.node], FIXED)
        self._one_less = identity(n, format='csr') - chain
        system = diags(sums(head, p, n)) - chain.T @ csr_matrix((p, (tail, head)), shape=(n, n))
        system = (system + self._one_less.T @ diags(weight) @ self._one_less).tocsc()
        self._factor = splu(system, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0, relax=1,
                            panel_size=4, options={'SymmetricMode': True})
        others = self._rows[self.other]
        moved = [self._network.covariance_with(share, p, row.toarray()[0]) for row in others]
        crossed = np.asarray(self._rows @ np.reshape(moved, (len(moved), len(p))).T)
        self._border = crossed[self.node]
        self._answer = np.reshape([self._on_nodes(c) for c in self._border.T], (-1, len(self.node)))
        self._corner = (crossed[self.other] + np.diag(diagonal[self.other])
                        - self._answer @ self._border)

    def solve(self, right: FloatArray) -> FloatArray:
        """y (R,) with (covariance of the rows' costs + diagonal) y = right."""
        y = np.empty(len(right))
        alone = self._on_nodes(right[self.node])
        y[self.other] = np.linalg.solve(self._corner, right[self.other] - self._border.T @ alone)
        y[self.node] = alone - y[self.other] @ self._answer
        return y

    def _on_nodes(self, right: FloatArray) -> FloatArray:
        spread = np.zeros(self._network.count)
        spread[self._place] = self._unit * right
        ahead = self._factor.solve(self._one_less.T @ spread)
        return np.asarray(self._unit * (self._one_less @ ahead)[self._place])
