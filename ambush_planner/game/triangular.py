"""Repeated solves of sparse triangular systems with one pattern.

scipy's ``spsolve_triangular`` copies and checks its matrix at every call, which takes longer than
the solve itself. Its sparse product ``y += A x`` goes through the rows in order; with x and y the
same array, each row of a strictly lower triangle reads entries that are final: y = (1 - A)^-1 y.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from ..arrays import FloatArray, IndexArray

try:
    from scipy.sparse._sparsetools import csr_matvecs
except ImportError:
    csr_matvecs = None


class Recursion:
    """The pattern of a strictly lower triangular matrix A (n, n), entry by entry."""

    def __init__(self, row: IndexArray, column: IndexArray, n: int) -> None:
        self._order = np.lexsort((column, row))
        self._column = column[self._order].astype(np.intc)
        self._first = np.searchsorted(row[self._order], np.arange(n + 1)).astype(np.intc)

    def solve(self, entries: FloatArray, right: FloatArray) -> FloatArray:
        """y = right + A y, for ``right`` (n,) or (n, R), which may be overwritten."""
        n, y, entries = len(right), np.ascontiguousarray(right), entries[self._order]
        if IN_PLACE:
            csr_matvecs(n, n, y.size // n, self._first, self._column, entries, *2 * (y.ravel(),))
            return y
        matrix = identity(n) - csr_matrix((entries, self._column, self._first), shape=(n, n))
        factors = splu(matrix.tocsc(), permc_spec='NATURAL', diag_pivot_thresh=0.0)
        return np.asarray(factors.solve(y))


def _goes_row_by_row() -> bool:
    """Whether scipy's product, a private function, still works in place."""
    y, index = np.array([1.0, 0.0, 0.0]), np.array([0, 0, 1, 2, 0, 1], dtype=np.intc)
    try:
        csr_matvecs(3, 3, 1, index[:4], index[4:], np.ones(2), y, y)
    except (TypeError, ValueError):
        return False
    return bool(y.min() == 1.0)


IN_PLACE = _goes_row_by_row()
