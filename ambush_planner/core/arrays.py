"""Read-only arrays for the frozen records that the stages hand on."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def frozen_array(values: npt.ArrayLike, dtype: Any) -> npt.NDArray[Any]:
    """Return a private copy of ``values`` as ``dtype`` that nobody can write to."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array
