# SPDX-License-Identifier: Apache-2.0
"""Warm starts: a solve that starts from what is known of another map."""

import time

import numpy as np
import pytest
from games import examples, plain_options
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, StrategyOptions, build_network
from ambush_planner.maps.occupancy import risk_from_occupancy
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.solving import Ground, WarmStart

ENDS = (1.5, 5.0), (10.5, 7.0)


def ground(seed, changed=()):
    values = np.random.default_rng(seed).integers(0, 60, (24, 24), dtype=np.int8)
    for row, column, value in changed:
        values[row, column] = value
    return risk_from_occupancy(values, 0.5)


def solve_on_network(risk_map, options, warm=None):
    network = build_network(risk_map, *ENDS, options.network)
    return Ground.of(risk_map, options).solve([network], time.monotonic() + 60.0, warm)


@examples(3)
@given(
    st.integers(0, 99), st.sampled_from((0.0, 2.0)), st.sampled_from((1.1, 1.3, np.inf)),
    st.lists(st.tuples(st.integers(0, 23), st.integers(4, 19), st.sampled_from((0, 80, 100))),
             min_size=1, max_size=12),
)
def test_a_warm_start_leads_to_as_good_a_strategy(seed, reach, detour, changed):
    options = PlanningOptions(
        network=plain_options(spacing=1.0), game=GameOptions(ambush_radius=reach),
        strategy=StrategyOptions(max_detour=detour),
    )
    before = solve_on_network(ground(seed), options)
    newest = ground(seed, changed)
    cold = solve_on_network(newest, options)
    warm = solve_on_network(newest, options, WarmStart.of(before))
    assert np.array_equal(warm.game.network.edges, cold.game.network.edges)
    # With a reach, the cells that became sites may differ.
    room = 3e-3 if reach else 1e-5
    assert warm.value <= cold.lower_bound * 1.01 * (1 + room) or warm.reason == 'stalled'
    assert warm.lower_bound <= cold.value * (1 + room)
    assert cold.lower_bound <= warm.value * (1 + room)
    assert warm.route_entropy == pytest.approx(cold.route_entropy, rel=0.05 if reach else 0.01)
