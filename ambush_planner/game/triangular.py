"""Repeated solves of sparse triangular systems with one pattern.

scipy's ``spsolve_triangular`` copies and checks its matrix at every call, which takes longer than
the solve itself; before scipy 1.13 it was a loop in Python.
"""

from __future__ import annotations

import contextlib

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from ..arrays import FloatArray, IndexArray

try:
    from scipy.sparse.linalg._dsolve._superlu import gstrs
except ImportError:
    gstrs = None


class UnitTriangle:
    """An upper triangular matrix (n, n) in rows that begin with the diagonal, which is 1.

    Set its entries, ``data``, between solves.
    """

    def __init__(self, indices: IndexArray, indptr: IndexArray) -> None:
        self._indices, self._indptr = indices.astype(np.intc), indptr.astype(np.intc)
        self.data = np.ones(len(indices))

    def solve(self, right: FloatArray, transposed: bool = False) -> FloatArray:
        """Solve for ``right`` (n,) or (n, R)."""
        if gstrs is not None:
            # The signature of this private function may change.
            with contextlib.suppress(TypeError, ValueError):
                return self._by_superlu(right, transposed)
        return self._by_factors(right, transposed)

    def _by_superlu(self, right: FloatArray, transposed: bool) -> FloatArray:
        # The rows are the columns of a lower triangle.
        n, none, nowhere = len(self._indptr) - 1, np.empty(0), np.empty(0, np.intc)
        solution, failed = gstrs('N' if transposed else 'T', n, len(self.data), self.data,
                                 self._indices, self._indptr, n, 0, none, nowhere,
                                 np.zeros(n + 1, np.intc), right)
        assert not failed  # the diagonal has no 0
        return np.asarray(solution)

    def _by_factors(self, right: FloatArray, transposed: bool) -> FloatArray:
        n = len(self._indptr) - 1
        matrix = csr_matrix((self.data, self._indices, self._indptr), shape=(n, n))
        factors = splu(matrix.tocsc(), permc_spec='NATURAL', diag_pivot_thresh=0.0)
        return np.asarray(factors.solve(right, trans='T' if transposed else 'N'))
