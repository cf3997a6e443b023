# SPDX-License-Identifier: Apache-2.0
"""Mean loss by an ambush at each place: by hand, below the value, and the best place attains it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from games import examples, hit_once, meets, plain_options, random_map
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, PlanningOptions, plan_trip
from ambush_planner.planning.ambush_costs import best_ambush, cost_raster
from ambush_planner.words import of_departures

HELD = (7.0, 12.5, 1.2)


@cache
def planned(seed, reach, held=()):
    risk_map = replace(random_map(seed, 14, 0.0), origin=(0.0, 0.0, 0.0))
    return plan_trip(risk_map, (1.0, 6.0), (13.0, 8.0), PlanningOptions(
        network=plain_options(spacing=2.0),
        game=GameOptions(ambush_radius=reach, secured_radius=1.5, secured_places=held)))


@examples(5)
@given(st.integers(0, 10**6))
def test_costs_are_loss_times_hits_at_each_cell(seed):
    plan = planned(seed, 1.4)
    strategy, network, risk_map = plan.strategy, plan.network, plan.risk_map
    found = cost_raster(plan.trip, risk_map, 14)
    at = np.argwhere(~np.isnan(found.cost))
    centres = risk_map.to_world(at[:, ::-1] + 0.5)
    options = strategy.game.options
    hits = meets(network, centres, options.ambush_radius + options.tube,
                 options.secured_distance - options.tube)
    by_hand = risk_map.alpha[tuple(at.T)] * hit_once(network, strategy.edge_probability, hits)
    np.testing.assert_allclose(found.cost[tuple(at.T)], by_hand, atol=2e-3 * plan.value)
    ends = network.points[[network.source, network.target]]
    near = np.hypot(*np.moveaxis(risk_map.to_world(np.moveaxis(
        np.indices((14, 14)), 0, 2)[..., ::-1] + 0.5)[:, :, None] - ends, 3, 0)).min(axis=2)
    np.testing.assert_array_equal(found.secured, near <= 1.5)


@examples(5)
@given(st.integers(0, 10**6), st.sampled_from((0.0, 1.4)))
def test_no_place_costs_more_than_the_value_and_the_best_ambush_costs_that(seed, reach):
    plan = planned(seed, reach, (HELD,))
    found, best = cost_raster(plan.trip, plan.risk_map, 14), best_ambush(
        plan.trip, plan.risk_map)
    assert 0.3 * plan.value < np.nanmax(found.cost) <= plan.value * (1.0 + 1e-9)
    cell = plan.risk_map.cells(plan.risk_map.to_map_axes(best.xy))
    assert plan.value == pytest.approx(best.hit * plan.risk_map.alpha[cell], rel=1e-6)
    assert found.secured[12, 7] and np.isnan(found.cost[12, 7]), 'nobody waits at the held place'
    assert np.hypot(best.xy[0] - HELD[0], best.xy[1] - HELD[1]) >= HELD[2]


def test_a_block_has_the_cost_of_its_dearest_cell():
    plan = planned(3, 1.4)
    fine, coarse = (cost_raster(plan.trip, plan.risk_map, most) for most in (14, 5))
    assert coarse.block == 3 and coarse.cost.shape == (5, 5)
    for row, column in np.argwhere(~np.isnan(coarse.cost)):
        block = np.s_[3 * row:3 * row + 3, 3 * column:3 * column + 3]
        dearest = plan.risk_map.alpha[block].argmax()
        assert coarse.cost[row, column] == pytest.approx(fine.cost[block].ravel()[dearest])


@pytest.mark.parametrize(('share', 'said'), [
    (1.0, 'every departure'), (0.95, 'nearly every departure'), (0.7, '7 of 10 departures'),
    (0.31, '4 of 10 departures'), (0.25, '1 of 4 departures'), (0.15, '1 of 6 departures'),
    (1.0 / 7.0, '1 of 7 departures'), (1e-4, 'fewer than 1 of 1000 departures'),
])
def test_shares_are_said_in_departures_and_never_too_low(share, said):
    assert of_departures(share) == said
