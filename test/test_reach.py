# SPDX-License-Identifier: Apache-2.0
"""The value with a reach, against all routes."""

import numpy as np
import pytest
from games import (
    check_unit_flow,
    examples,
    planar_network,
    reached,
    routes_of,
    terrain_network,
    value_by_routes,
)
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.budget import length_budget
from ambush_planner.game.certificate.best_response import Subnetwork, best_response
from ambush_planner.game.game import make_game
from ambush_planner.game.hits import entry_value

EXACT = StrategyOptions(max_detour=np.inf, risk_slack=0.0)


@examples(15)
@given(st.integers(0, 10**6), st.floats(0.2, 1.5),
       st.sampled_from([-1.0, 0.0, 0.5, 2.0]), st.sampled_from((1.05, 1.3, np.inf)), st.booleans())
def test_value_and_bound_enclose_the_value_over_all_routes(
    seed, reach, secured, detour, inside
):
    """And the bound is that value, up to the LP's precision."""
    network = planar_network(seed, inside)
    routes = routes_of(network)
    assume(0 < len(routes) <= 1000)
    game = GameOptions(ambush_radius=reach, secured_radius=secured)
    strategy = solve(network, game, StrategyOptions(max_detour=detour))
    near = reached(network, reach, game.secured_distance)
    limits = [(network.lengths, strategy.length_budget)]
    once = value_by_routes(network.alpha, near, routes, limits)
    assert strategy.lower_bound <= once * (1 + 1e-7) + 1e-9
    assert strategy.lower_bound == pytest.approx(once, rel=2e-3, abs=1e-7)
    assert strategy.value >= once * (1 - 2e-6) - 1e-9
    assert strategy.reason == 'complete'
    check_unit_flow(network, strategy.edge_probability)
    assert strategy.expected_length <= strategy.length_budget * (1 + 1e-6)
    assert strategy.value <= once * (1 + 0.01 + 1e-5) + 1e-9


@examples(20)
@given(st.integers(0, 10**6), st.floats(0.5, 2.0), st.floats(0.0, 2.0))
def test_the_best_response_is_the_best_of_all_routes(seed, reach, price):
    rng, network = np.random.default_rng(seed), planar_network(seed)
    game = make_game(network, GameOptions(ambush_radius=reach))
    q = np.zeros(game.node_count)
    q[game.sites] = rng.random(len(game.sites)) * (rng.random(len(game.sites)) < 0.7)
    budget = length_budget(game, 1.1)
    routes = routes_of(network)
    assume(len(routes) <= 1000)
    met = np.array([(game.entering[:, route].getnnz(axis=1) > 0) for route in routes])
    over = np.array([budget.reduced_cost[route].sum() for route in routes])
    costs = met @ (game.loss * q)[game.sites] + price * over
    base = price * np.where(game.playable, budget.reduced_cost, 0.0)
    assert best_response(game, q, base) == pytest.approx(costs.min(), abs=1e-9)
    # A search that is cut short proves no more.
    bound, edges = Subnetwork(game, game.entering).least_cost(
        base, (game.loss * q)[game.sites], ((9, 3), (81, 10**6)))
    assert sorted(edges.tolist()) in [sorted(route) for route in routes]
    assert bound <= costs.min() * (1.0 + 1e-9) + 1e-9


def test_a_route_that_comes_back_to_a_disc_is_hit_once():
    # A hairpin: in, out and in again of the disc around node 3.
    points = [[0, -3], [0.2, 0], [4, 0.5], [0, 0.5], [0.2, 1.0], [0, 4]]
    edges = [(0, 1), (1, 2), (2, 4), (4, 5)]
    network = Network(points, [0, 0, 0, 3.0, 0, 0], edges, 0, 5)
    strategy = solve(network, GameOptions(ambush_radius=1.0), EXACT)
    assert entry_value(strategy.game, strategy.edge_probability) == pytest.approx(6.0)
    assert strategy.value == pytest.approx(3.0) and strategy.lower_bound == pytest.approx(3.0)


def test_label_searches_close_the_gap():
    network = terrain_network(3, 'uniform_grid8', 40)
    strategy = solve(network, GameOptions(ambush_radius=3.0),
                     StrategyOptions(risk_slack=1e-3))
    assert strategy.reason == 'complete'
