# SPDX-License-Identifier: Apache-2.0
"""The best ambush costs the value, outside held ground; shares in words."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from games import examples, plain_options, random_map
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, PlanningOptions, plan_trip
from ambush_planner.planning.ambush_costs import best_ambush
from ambush_planner.words import of_departures

HELD = (7.0, 12.5, 1.2)


@cache
def planned(seed, reach, held=()):
    risk_map = replace(random_map(seed, 14, 0.0), origin=(0.0, 0.0, 0.0))
    return plan_trip(risk_map, (1.0, 6.0), (13.0, 8.0), PlanningOptions(
        network=plain_options(spacing=2.0),
        game=GameOptions(ambush_radius=reach, secured_radius=1.5, held_places=held)))


@examples(5)
@given(st.integers(0, 10**6), st.sampled_from((0.0, 1.4)))
def test_the_best_ambush_costs_the_value(seed, reach):
    plan = planned(seed, reach, (HELD,))
    best = best_ambush(plan.trip, plan.risk_map)
    cell = plan.risk_map.cells(plan.risk_map.to_map_axes(best.xy))
    assert plan.value == pytest.approx(best.hit * plan.risk_map.alpha[cell], rel=1e-6)
    assert np.hypot(best.xy[0] - HELD[0], best.xy[1] - HELD[1]) >= HELD[2]


@pytest.mark.parametrize(('share', 'said'), [
    (1.0, 'every departure'), (0.95, 'nearly every departure'), (0.7, '7 of 10 departures'),
    (0.31, '4 of 10 departures'), (0.25, '1 of 4 departures'), (0.15, '1 of 6 departures'),
    (1.0 / 7.0, '1 of 7 departures'), (1e-4, 'fewer than 1 of 1000 departures'),
])
def test_shares_are_said_in_departures_and_never_too_low(share, said):
    assert of_departures(share) == said
