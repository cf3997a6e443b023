"""Small array helpers: read-only copies for the frozen records, sums by index."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def frozen_array(values: npt.ArrayLike, dtype: Any) -> npt.NDArray[Any]:
    """Return a private copy of ``values`` as ``dtype`` that nobody can write to."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


def sums(
    index: npt.NDArray[np.int64], values: npt.NDArray[np.float64], count: int
) -> npt.NDArray[np.float64]:
    """Add up ``values`` (K,) by ``index`` (K,): result (count,)."""
    return np.asarray(np.bincount(index, weights=values, minlength=count), dtype=np.float64)
