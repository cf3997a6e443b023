# SPDX-License-Identifier: Apache-2.0
"""Slots of departure: the full matrix game, and the formulas for windows."""

from math import ceil

import numpy as np
import pytest
from games import examples, least_value
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import InvalidOption
from ambush_planner.planning.slots import mix_slots


@given(st.integers(0, 10**6))
@examples(10)
def test_joint_value_is_that_of_the_game_over_slots_routes_and_sites(seed):
    """Three slots with sites and routes of their own: one matrix for all."""
    rng = np.random.default_rng(seed)
    games = [rng.uniform(0.0, 1.0, (3, 4)) * (rng.random((3, 4)) < 0.7) + 0.1 for _ in range(3)]
    joint = np.zeros((9, 12))
    for k, game in enumerate(games):
        joint[3 * k : 3 * k + 3, 4 * k : 4 * k + 4] = game
    values = [least_value(game) for game in games]
    found = mix_slots(values, values)
    assert found.value == pytest.approx(least_value(joint), rel=1e-7)
    assert found.value == pytest.approx(1.0 / np.sum(1.0 / np.array(values)), rel=1e-9)
    assert found.shares * values == pytest.approx(found.value, rel=1e-9)


@pytest.mark.parametrize(('slots', 'window'), [(1, 1), (5, 2), (6, 3), (7, 3), (3, 8)])
def test_equal_slots_and_a_window(slots, window):
    found = mix_slots([2.0] * slots, [1.9] * slots, window)
    assert found.value == pytest.approx(2.0 / ceil(slots / window))
    assert found.lower_bound == pytest.approx(1.9 / ceil(slots / window))
    worst = max(found.shares[k : k + window].sum() for k in range(slots))
    assert worst * 2.0 == pytest.approx(found.value)
    if window >= slots:  # no time is better than another
        assert found.shares == pytest.approx(1.0 / slots)


def test_a_safe_slot_takes_all():
    found = mix_slots([1.0, 0.0, 2.0], [1.0, 0.0, 2.0])
    assert found.value == 0.0 and found.shares.tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(('values', 'window', 'name'), [([], 1, 'slots'), ([1.0], 0, 'window')])
def test_bad_slots_are_refused(values, window, name):
    with pytest.raises(InvalidOption, match=name):
        mix_slots(values, values, window)
