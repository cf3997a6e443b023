# SPDX-License-Identifier: Apache-2.0
"""The value with a reach, against all routes."""

from dataclasses import replace

import numpy as np
import pytest
from games import examples, planar_network, reached, routes_of, terrain_network, value_by_routes
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.ambusher import Ambusher
from ambush_planner.game.budget import Budget
from ambush_planner.game.certificate.best_response import TripNetworks, best_response
from ambush_planner.game.game import make_game
from ambush_planner.game.hits import entry_value

EXACT = StrategyOptions(max_detour=np.inf, risk_slack=0.0)


@examples(90)
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
    assert strategy.value <= once * (1 + 0.01 + 1e-5) + 1e-9


@examples(20)
@given(st.integers(0, 10**6), st.floats(0.5, 2.0), st.floats(0.0, 2.0))
def test_the_best_response_is_the_best_of_all_routes(seed, reach, price):
    rng, network = np.random.default_rng(seed), planar_network(seed)
    game = make_game(network, GameOptions(ambush_radius=reach))
    q = np.zeros(game.node_count)
    q[game.sites] = rng.random(len(game.sites)) * (rng.random(len(game.sites)) < 0.7)
    budget = Budget.length(game, 1.1)
    routes = routes_of(network)
    assume(len(routes) <= 1000)
    met = np.array([(game.entering[:, route].getnnz(axis=1) > 0) for route in routes])
    over = np.array([budget.reduced_cost[route].sum() - budget.slack for route in routes])
    costs = met @ (game.loss * q)[game.sites] + price * over
    bound = best_response(game, Ambusher(q, price), budget)
    assert bound == pytest.approx(max(costs.min(), 0.0), abs=1e-9)
    # A search that is cut short proves no more.
    base, dual_weights = price * budget.reduced_cost, (game.loss * q)[None, game.sites]
    least = costs.min() + price * budget.slack
    bound, edges = TripNetworks(game, game.entering).least_cost(
        base, dual_weights, ((9, 3), (81, 10**6)))
    assert sorted(edges.tolist()) in [sorted(route) for route in routes]
    assert bound <= least * (1.0 + 1e-9) + 1e-9


def test_a_route_that_comes_back_to_a_disc_is_hit_once():
    # A hairpin: in, out and in again of the disc around node 3.
    points = [[0, -3], [0.2, 0], [4, 0.5], [0, 0.5], [0.2, 1.0], [0, 4]]
    edges = [(0, 1), (1, 2), (2, 4), (4, 5)]
    network = Network(points, [0, 0, 0, 3.0, 0, 0], edges, 0, 5)
    strategy = solve(network, GameOptions(ambush_radius=1.0), EXACT)
    assert entry_value(strategy.game, strategy.edge_probability) == pytest.approx(6.0)
    assert strategy.value == pytest.approx(3.0) and strategy.lower_bound == pytest.approx(3.0)


def test_routes_that_share_a_bridge_remember_which_way_they_came():
    """An ambush on either side reaches the ways before and after the bridge.

    So routes stay on their side: a chain, which forgets it, would be hit in 3 of 4 trips.
    """
    points = [(-2, 0), (1.5, 2), (1.5, -2), (2, 0), (2.5, 2), (2.5, -2), (6, 0)]
    edges = [(0, 1), (0, 2), (1, 3), (2, 3), (3, 4), (3, 5), (4, 6), (5, 6)]
    network = Network(points, [0, 1, 1, 0, 1, 1, 0], edges, 0, 6)
    strategy = solve(network, GameOptions(ambush_radius=1.2, secured_radius=0.0))
    assert strategy.reason == 'complete'
    assert strategy.lower_bound == pytest.approx(0.5)
    assert strategy.value <= 0.5 * 1.01 + 1e-9
    np.testing.assert_allclose(strategy.shown_probability[:8], 0.5, atol=0.01)


@pytest.mark.parametrize('seed', [3, 4])
def test_label_searches_close_the_gap(seed):
    network = terrain_network(seed, 'uniform_grid8', 40)
    strategy = solve(network, GameOptions(ambush_radius=3.0),
                     StrategyOptions(risk_slack=1e-3))
    assert strategy.reason == 'complete'


def test_places_may_be_numbered_in_any_order():
    network = terrain_network(3, cells=12)
    places = np.random.default_rng(1).permutation(len(network.points))
    one, other = (solve(each, GameOptions(ambush_radius=2.0))
                  for each in (network, replace(network, places=places)))
    assert other.reason == 'complete'
    assert other.lower_bound == pytest.approx(one.lower_bound, rel=1e-3)
