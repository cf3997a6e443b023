# SPDX-License-Identifier: Apache-2.0
"""Repeated solves of sparse triangular systems with one pattern.

scipy's ``spsolve_triangular`` copies and checks its matrix at every call, which takes longer than
the solve itself. Its sparse product ``y += A x`` goes through the rows in order; with x and y the
same array, each row of a strictly lower triangle reads entries that are final: y = (1 - A)^-1 y.
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray, IndexArray

try:
    from scipy.sparse._sparsetools import csr_matvecs
except ImportError:  # it is private, a version of scipy may lack it or, see below, change it
    csr_matvecs = None


class Recursion:
    """Pattern of a strictly lower triangular matrix A (n, n), given by the places of its entries.

    ``order`` sorts the entries by row.
    """

    def __init__(self, row: IndexArray, column: IndexArray, n: int) -> None:
        self.order = np.lexsort((column, row))
        self._column = column[self.order].astype(np.intc)
        self._first = np.searchsorted(row[self.order], np.arange(n + 1)).astype(np.intc)

    def solve(self, entries: FloatArray, right: FloatArray) -> FloatArray:
        """Solve y = right + A y, for ``right`` (n,) or (n, R), which may be overwritten."""
        y = np.ascontiguousarray(right)
        self.add_rows(entries[self.order], y, 0, len(y))
        return y

    def add_rows(self, entries: FloatArray, y: FloatArray, begin: int, end: int) -> None:
        """Add the rows ``begin`` to ``end`` - 1 of A y to y, one by one.

        ``entries`` are those of all rows, sorted by row.
        """
        if csr_matvecs:
            csr_matvecs(end - begin, len(y), y.size // len(y), self._first[begin : end + 1],
                        self._column, entries, y.ravel(), y[begin:end].ravel())
            return
        for row in range(begin, end):
            own = slice(self._first[row], self._first[row + 1])
            y[row] += entries[own] @ y[self._column[own]]


def _goes_by_rows() -> bool:
    """Return whether scipy's product solves a small system, with one right side and with two."""
    system = Recursion(np.array([1, 2, 2]), np.array([0, 0, 1]), 3)
    entries, solution = np.array([2.0, 3.0, 5.0]), np.array([1.0, 3.0, 19.0])
    try:
        return all(np.array_equal(system.solve(entries, np.ones_like(each)), each)
                   for each in (solution, np.outer(solution, (1.0, 1.0))))
    except (TypeError, ValueError):  # it takes other arguments
        return False


if csr_matvecs and not _goes_by_rows():
    csr_matvecs = None
