"""``rows W rows'`` for changing diagonals W: its pattern, order and assembly are found once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import splu

from .dissection import nested_dissection
from .errors import SolverFailed
from .network import IndexArray
from .risk_map import FloatArray


class NormalMatrix:
    """The normal matrix of sparse ``rows`` (R, K), row r lying at ``places[r]`` in the plane."""

    def __init__(self, rows: csr_matrix, places: FloatArray) -> None:
        count = rows.shape[0]
        row, column, factor, variable = _products(rows.tocsc())
        off = row < column
        links = np.unique(row[off] * count + column[off])
        self._order = nested_dissection(places, np.stack(np.divmod(links, count), axis=1))
        position = np.empty(count, dtype=np.int64)
        position[self._order] = np.arange(count)
        keys, entry = np.unique(position[column] * count + position[row], return_inverse=True)
        self._assembly = csr_matrix(
            (factor, (entry, variable)), shape=(len(keys), rows.shape[1])
        )
        columns, indices = np.divmod(keys, count)
        self._indices = indices.astype(np.int32)
        self._indptr = np.searchsorted(columns, np.arange(count + 1)).astype(np.int32)
        self._diagonal = np.flatnonzero(columns == indices)

    def factorise(self, weight: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Return a function that solves ``rows diag(weight) rows' y = r`` for y.

        Raises
        ------
        SolverFailed
            The matrix is singular.
        """
        count, order = len(self._order), self._order
        data = self._assembly @ weight
        data[self._diagonal] *= 1.0 + 1e-15
        matrix = csc_matrix((data, self._indices, self._indptr), shape=(count, count))
        try:
            factor = splu(
                matrix,
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError as error:
            raise SolverFailed(f"interior point method: {error}") from error

        def solve(right: FloatArray) -> FloatArray:
            ordered = right[order]
            found = factor.solve(ordered)
            found += factor.solve(ordered - matrix @ found)  # one step of iterative refinement
            result = np.empty_like(right)
            result[order] = found
            return result

        return solve


def _products(
    rows: csc_matrix,
) -> tuple[IndexArray, IndexArray, FloatArray, IndexArray]:
    """All (row a, row b, value product, column) with both rows in the same column."""
    size = np.diff(rows.indptr).astype(np.int64)
    start = rows.indptr[:-1].astype(np.int64)
    variable = np.repeat(np.arange(len(size)), size**2)
    first = np.repeat(np.cumsum(size**2) - size**2, size**2)
    place = np.arange(len(variable)) - first
    a = start[variable] + place // size[variable]
    b = start[variable] + place % size[variable]
    indices = rows.indices.astype(np.int64)
    return indices[a], indices[b], rows.data[a] * rows.data[b], variable
