# SPDX-License-Identifier: Apache-2.0
"""The paper's table III: laws, and tiny games whose rows are known by hand."""

import itertools

import numpy as np
import pytest
from games import examples, least_weight, networks, routes_of, terrain_networks
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, evaluate, solve
from ambush_planner.planning.evaluation import energy_efficient_route, risk_avoiding_route

PLANNERS = ['stochastic', 'energy_efficient', 'risk_avoidance']


def length(network, route) -> float:
    steps = np.diff(network.points[list(route)], axis=0)
    return float(np.hypot(*steps.T).sum())


@examples(20)
@given(networks(max_nodes=7))
def test_fixed_routes_are_the_best_of_all_routes(network):
    game = solve(network).game
    routes = [[network.source, *network.heads[route]] for route in routes_of(network)]
    straight, careful = energy_efficient_route(game), risk_avoiding_route(game)
    assert length(network, straight) == pytest.approx(min(length(network, r) for r in routes))
    least = min(network.alpha[r].sum() for r in routes)
    assert network.alpha[careful].sum() == pytest.approx(least, abs=1e-12)
    ties = [r for r in routes if network.alpha[r].sum() <= least + 1e-12]
    assert length(network, careful) == pytest.approx(min(length(network, r) for r in ties))


@examples(20)
@given(st.one_of(networks(), terrain_networks))
def test_measures_of_any_network(network):
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf))
    rows = evaluate(strategy)
    assert list(rows) == PLANNERS
    q, x = strategy.ambush_probability, strategy.visit_probability
    alpha, value = strategy.network.alpha, strategy.value
    stochastic = rows['stochastic']
    assert stochastic.expected_length == strategy.expected_length
    sites = alpha > 0.0
    assert stochastic.p_first == pytest.approx(float(q[sites] @ x[sites]), abs=1e-9)
    assert (stochastic.p_repeated, stochastic.v_repeated) == (stochastic.p_first, value)
    shortest = least_weight(strategy.network, strategy.network.lengths)
    assert rows['energy_efficient'].expected_length == pytest.approx(shortest, rel=1e-12)
    for name in PLANNERS[1:]:
        row = rows[name]
        assert row.planner == name
        assert row.expected_length >= shortest * (1 - 1e-12)
        # No fixed route does better against one who has learnt it than the optimum.
        assert row.v_repeated >= strategy.lower_bound
        assert row.p_repeated == (1.0 if row.v_repeated > 0.0 else 0.0)
        assert -1e-12 <= row.p_first <= 1.0 + 1e-9


def test_three_parallel_nodes_by_hand():
    # Losses 1, 2, 4: value 4 / 7, q = x = (4, 2, 1) / 7. Shortest: the middle one, loss 4.
    points = [[0, 0], [2, 3], [2, 1], [2, 0], [4, 0]]
    edges = list(itertools.product([0], [1, 2, 3])) + [(k, 4) for k in (1, 2, 3)]
    network = Network(points, [0, 1, 2, 4, 0], edges, 0, 4)
    rows = evaluate(solve(network, options=StrategyOptions(max_detour=np.inf, risk_slack=0.0)))
    assert rows['stochastic'].p_first == pytest.approx((16 + 4 + 1) / 49, rel=1e-5)
    assert rows['stochastic'].v_repeated == pytest.approx(4 / 7, rel=1e-5)
    straight, careful = rows['energy_efficient'], rows['risk_avoidance']
    assert (straight.expected_length, straight.v_repeated) == (4.0, 4.0)
    assert straight.p_first == pytest.approx(1 / 7, rel=1e-6)
    assert careful.expected_length == pytest.approx(2 * np.sqrt(13))
    assert (careful.p_first, careful.v_repeated) == (pytest.approx(4 / 7, rel=1e-6), 1.0)


def test_forbidden_nodes_are_forbidden_to_every_planner():
    points = [[0, 0], [2, 0], [2, 3], [4, 0]]
    network = Network(points, [0, 9, 1, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    strategy = solve(network, GameOptions(alpha_threshold=5.0), StrategyOptions(max_detour=np.inf))
    for row in evaluate(strategy).values():
        assert row.expected_length == pytest.approx(2 * np.sqrt(13))
