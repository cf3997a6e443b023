# SPDX-License-Identifier: Apache-2.0
"""The route distribution on a trip's layered graph."""

import math

import numpy as np
import pytest
from ambush_planner.game.trip_search import find_trip
from games import drawn_routes, examples, is_acyclic, unbalanced
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from test_routes import games

from ambush_planner import GameOptions, Network, StrategyOptions
from ambush_planner.game.hits import hit_probabilities, worst_loss
from ambush_planner.game.route_sampler import route_entropy
from ambush_planner.game.search import Search, SearchProblem
from ambush_planner.game.solver import solve
from ambush_planner.game.value.routes import Routes

SLACK = 0.02


def distribution_around(game, budget, routes):
    """The distribution on layers around the routes of an LP."""
    search = Search(SearchProblem(game, budget, SLACK, math.inf), routes, SLACK)
    return find_trip(search, routes)


def solved(seed, reach, detour):
    """A trip's game, its budget, its routes, and the distribution on layers around some."""
    game, budget = games(seed, 1, reach, detour)
    routes = Routes(game, budget, 0.3 * SLACK, math.inf)
    routes.solve()
    assume(routes.bound > 0.0)  # else nothing can be lost
    found = distribution_around(game, budget, routes)
    assume(found is not None)  # rounding where the budget just fits
    return game, budget, routes, found


def hit_loss(game, p, row):
    """Mean loss by the site in a row."""
    return game.loss[game.sites[row]] * hit_probabilities(game, p, np.array([row]))[0]


@examples(25)
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.0, 1.0, 2.5]),
       detour=st.sampled_from([1.05, 1.3, math.inf]))
def test_a_strategy_within_the_budgets_on_nodes_that_stand_for_places(seed, reach, detour):
    game, budget, routes, found = solved(seed, reach, detour)
    unrolled, p = found.layers.unrolled(found.chain)
    network, base, edge = unrolled.network, game.network, found.layers.edge
    assert (network.place_count, network.legs) == (base.place_count, base.legs)
    count = len(base.points)
    assert np.array_equal(network.points[:count], base.points)
    assert np.array_equal(network.edges[: len(base.edges)], base.edges)
    # Each edge stands for one of the trip's, between the same places on the same legs.
    for name in ('places', 'leg'):
        ends = getattr(network, name)[network.edges]
        assert np.array_equal(ends, getattr(base, name)[base.edges[edge]])
    assert np.array_equal(network.first_edge, edge)
    assert unrolled.playable[p > 0.0].all() and is_acyclic(network, p)
    assert unbalanced(network, p) < 1e-8
    assert not budget.binds or p @ budget.cost[edge] <= budget.limit * (1.0 + 1e-6)
    assert np.array_equal(unrolled.sites, game.sites)
    assert np.array_equal(unrolled.entering.toarray(), game.entering.toarray()[:, edge])
    # The value is an upper bound, nearly exact for the sites that matter.
    worst = worst_loss(unrolled, p)
    assert worst * (1.0 - 1e-9) <= found.value <= worst * (1.0 + 1e-3)
    assert hit_loss(unrolled, p, found.worst) == pytest.approx(worst, rel=1e-3)
    assert found.value >= routes.bound * (1.0 - 1e-9)
    limit = max(routes.bound * (1.0 + SLACK), routes.value * (1.0 + SLACK))
    assert found.value <= limit * (1.0 + 1e-3) or len(routes.routes) == 1


@examples(8)
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.0, 1.0]))
def test_the_entropy_is_at_most_that_of_the_routes_of_places(seed, reach):
    game, _, routes, found = solved(seed, reach, 1.3)
    unrolled, p = found.layers.unrolled(found.chain)
    network, edge = unrolled.network, found.layers.edge
    chance: dict[bytes, float] = {}
    labelled = 0.0
    for route, one in drawn_routes(network, p).items():
        labelled -= one * math.log(one)
        key = edge[list(route)].tobytes()
        chance[key] = chance.get(key, 0.0) + one
    assert sum(chance.values()) == pytest.approx(1.0)
    of_places = -sum(each * math.log(each) for each in chance.values())
    assert found.chain.entropy == pytest.approx(labelled)
    entropy = route_entropy(network, p)
    assert entropy <= of_places + 1e-9
    assert entropy >= of_places - math.log(len(routes.routes) + 1.0) - 1e-9


def _bridges():
    """From 0 over 1 or 2, two equal bridges, to the stop 3, and back over 1 or 2 to 4."""
    at = np.array([(0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (2.0, 0.0), (0.0, -0.5)])
    alpha = np.array([0.0, 1.0, 1.0, 0.0, 0.0])
    edges = [(0, 1), (0, 2), (1, 8), (2, 8), (8, 6), (8, 7), (6, 9), (7, 9)]
    return Network(np.tile(at, (2, 1)), np.tile(alpha, 2), edges, 0, 9,
                   np.tile(np.arange(5), 2), np.repeat([0, 1], 5))


def test_layers_share_an_edge_from_the_source_to_the_target():
    """Two ways part before and after a bridge, and a road leads past it."""
    points = [(-10, 0), (1.5, 4), (1.5, -4), (2, 0), (2.5, 4), (2.5, -4), (14, 0), (8, 0)]
    edges = [(0, 1), (0, 2), (1, 3), (2, 3), (3, 4), (3, 5), (4, 6), (5, 6), (0, 6)]
    network = Network(points, [0, 1, 1, 0, 1, 1, 0, 1], edges, 0, 6)
    strategy = solve(network, GameOptions(ambush_radius=1.2, secured_radius=0.0),
                     StrategyOptions(max_detour=3.0))
    assert strategy.reason == 'complete' and len(strategy.edge_probability) > len(edges)
    assert strategy.lower_bound == pytest.approx(1.0 / 3.0)
    assert len(np.unique(strategy.network.edges, axis=0)) == len(strategy.network.edges)
    assert unbalanced(strategy.network, strategy.edge_probability) < 1e-9
    assert strategy.network.stretches == len(edges)


def test_pictures_show_a_stretch_once_with_the_probability_of_all_its_layers():
    strategy = solve(_bridges(), GameOptions(secured_radius=0.0))
    assert len(strategy.edge_probability) > 8, 'it lives on layers'
    shown = strategy.shown_probability
    np.testing.assert_allclose(shown[:8], 0.5, atol=0.02)
    assert not shown[8:].any()
    leaving = strategy.network.points[[1, 2]] / math.sqrt(2.0)
    np.testing.assert_allclose(strategy.mean_direction()[0], leaving.mean(axis=0), atol=0.02)
    axes = strategy.plot()
    (lines,) = [each for each in axes.collections if isinstance(each, LineCollection)]
    assert len(lines.get_segments()) == 8
