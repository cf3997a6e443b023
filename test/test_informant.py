# SPDX-License-Identifier: Apache-2.0
"""What an informant is worth, against the enumeration of all routes."""

import numpy as np
import pytest
from games import examples, planar_network, reached, routes_of
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.informant import worst_informant


@examples(25)
@given(st.integers(0, 10**6), st.sampled_from((0.0, 0.4, 0.9)), st.sampled_from((1.1, np.inf)))
def test_the_worst_place_is_that_of_all_routes(seed, reach, detour):
    network = planar_network(seed)
    if len(routes := routes_of(network)) > 1000:
        return
    game = GameOptions(ambush_radius=reach)
    strategy = solve(network, game, StrategyOptions(max_detour=detour))
    near = reached(network, reach, game.secured_distance)
    # The probability of each route, and which nodes hit it.
    p, x = strategy.edge_probability, strategy.visit_probability
    drawn = np.array([np.prod(p[route] / np.maximum(x[network.tails[route]], 1e-300))
                      for route in routes])
    hit = np.array([near[:, route].any(axis=1) for route in routes]).T * 1.0
    loss = strategy.game.loss
    losses = []
    for i in np.flatnonzero(loss > 0.0):
        if 1e-9 < hit[i] @ drawn < 1.0 - 1e-9:
            told = [loss * (hit @ (drawn * part)) for part in (hit[i], 1.0 - hit[i])]
            losses.append(sum(each.max() for each in told))
    found = worst_informant(strategy)
    if not losses or strategy.value == 0.0:
        assert found is None
        return
    assert found.loss == pytest.approx(max(losses), rel=1e-7)
    assert found.factor == found.loss / strategy.value
    assert 1.0 - 1e-9 <= found.factor <= 2.0 + 1e-9


def test_two_ways_that_are_driven_alike_are_known_to_who_sees_one():
    edges = [(0, 1), (1, 3), (0, 2), (2, 3)]
    network = Network([(0, 0), (1, 1), (1, -1), (2, 0)], [0, 3, 3, 0], edges, 0, 3)
    found = worst_informant(solve(network, options=StrategyOptions(risk_slack=0.0)))
    assert (found.x, abs(found.y)) == (1.0, 1.0)
    assert (found.loss, found.factor) == pytest.approx((3.0, 2.0), rel=1e-4)
    one_way = Network([(0, 0), (1, 1), (2, 0)], [0, 3, 0], [(0, 1), (1, 2)], 0, 2)
    assert worst_informant(solve(one_way)) is None
