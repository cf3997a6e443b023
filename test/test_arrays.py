"""Read-only copies of arrays, sums by index."""

import numpy as np
import pytest

from ambush_planner.arrays import frozen_array, sums


def test_a_frozen_array_is_a_private_copy():
    given = np.arange(3)
    frozen = frozen_array(given, np.float64)
    given[0] = 9
    assert frozen.tolist() == [0.0, 1.0, 2.0] and frozen.dtype == np.float64
    with pytest.raises(ValueError, match='read-only'):
        frozen[0] = 1.0


def test_sums_by_index():
    assert sums(np.array([2, 0, 2]), np.array([1.0, 2.0, 4.0]), 4).tolist() == [2, 0, 5, 0]
    assert sums(np.empty(0, np.int64), np.empty(0), 2).tolist() == [0, 0]
