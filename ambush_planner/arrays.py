"""The arrays that the records are made of: their types, read-only copies, sums by index."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def frozen_array(values: npt.ArrayLike, dtype: Any) -> npt.NDArray[Any]:
    """Return a private copy of ``values`` as ``dtype`` that nobody can write to."""
    array = np.array(values, dtype=dtype, order='C')
    array.setflags(write=False)
    return array


def sums(index: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """Add up ``values`` (K,) by ``index`` (K,): result (count,)."""
    return np.asarray(np.bincount(index, weights=values, minlength=count), dtype=np.float64)
