# SPDX-License-Identifier: Apache-2.0
"""Slots of departure: the best shares, by the linear program of the game."""

import numpy as np
import pytest
from games import least_value

from ambush_planner.operations.slots import Slots


@pytest.mark.parametrize(('slots', 'window'), [(1, 1), (5, 1), (4, 2), (5, 2), (6, 3), (7, 3),
                                               (3, 8)])
def test_shares_are_the_best_against_any_window(slots, window):
    found = Slots.of([f'{hour:02d}:00' for hour in range(slots)], window)
    covered = np.arange(slots) - np.arange(1 - window, slots)[:, None]
    covered = ((covered >= 0) & (covered < window)).astype(float)
    assert found.covered == pytest.approx(least_value(covered))
    assert (covered @ found.shares).max() == pytest.approx(found.covered)
    assert sum(found.shares) == pytest.approx(1.0)
    if window in (1, 8):  # no time is better than another
        assert found.shares == pytest.approx([1.0 / slots] * slots)
