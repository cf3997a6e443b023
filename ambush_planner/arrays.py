# SPDX-License-Identifier: Apache-2.0
"""Array types of the records, read-only copies, sums by index, rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Relative rounding of sums and comparisons.
ROUNDING = 1e-9


def frozen_array(values: npt.ArrayLike, dtype: Any) -> npt.NDArray[Any]:
    """Return a read-only copy of ``values`` as ``dtype``."""
    array = np.array(values, dtype=dtype, order='C')
    array.setflags(write=False)
    return array


def sums(index: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """Sum ``values`` (K,) by ``index`` (K,): (count,)."""
    return np.asarray(np.bincount(index, weights=values, minlength=count), dtype=np.float64)
