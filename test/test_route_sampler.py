# SPDX-License-Identifier: Apache-2.0
"""Drawn routes have the published probabilities; dense paths keep to their corners."""

from collections import Counter

import numpy as np
import pytest
from games import examples, is_acyclic, networks, paper_example, terrain_network
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtri  # scipy.stats takes long to import

from ambush_planner import Network, StrategyOptions, solve
from ambush_planner.game.route_sampler import RouteSampler, route_edges

# Chance that a correct sampler fails one of these suites: one in a million per test, seeds fixed.
FALSE_ALARM = 1e-6
SOLVERS = ('max_entropy', 'interior_point', 'simplex')


def check_route(network, route) -> None:
    assert route[0] == network.source and route[-1] == network.target
    assert len(set(route.tolist())) == len(route)
    count = len(network.points)
    steps = network.tails * count + network.heads
    assert np.isin(route[:-1] * count + route[1:], steps).all()


@examples(25)
@given(networks(), st.sampled_from(SOLVERS), st.integers(0, 9))
def test_routes_of_any_network_are_simple_and_use_its_edges(network, solver, seed):
    strategy = solve(network, options=StrategyOptions(solver=solver))
    route = strategy.sample_route(np.random.default_rng(seed))
    check_route(network, route)
    assert (strategy.edge_probability[route_edges(network, route)] > 0.0).all()


def one_by_one(strategy, draws, seed):
    rng = np.random.default_rng(seed)
    return [strategy.sample_route(rng) for _ in range(draws)]


def at_once(strategy, draws, seed):
    return strategy.sample_routes(draws, np.random.default_rng(seed))


def edge_counts(network, routes) -> np.ndarray:
    """How often the routes, which are checked, use each edge."""
    for route in routes:
        assert route[0] == network.source and route[-1] == network.target
        assert len(set(route.tolist())) == len(route)
    used = np.concatenate([route_edges(network, route) for route in routes])
    return np.bincount(used, minlength=len(network.edges))


@pytest.mark.parametrize('draw', [one_by_one, at_once])
def test_drawn_frequencies_are_the_published_probabilities(draw):
    """Every edge's count is binomial: normal approximation, Bonferroni over the edges."""
    network, draws = terrain_network(3, cells=9), 3_000
    strategy = solve(network)
    counts = edge_counts(network, draw(strategy, draws, 42))
    p = strategy.edge_probability
    often = (p * draws > 30) & ((1 - p) * draws > 30)
    z = (counts - draws * p)[often] / np.sqrt(draws * p * (1 - p))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())
    assert (counts[p == 0.0] == 0).all()
    assert counts[p > 1 - 1e-9] == pytest.approx(draws)
    rare = p * draws <= 30
    assert counts[rare].sum() <= draws * p[rare].sum() + 6 * np.sqrt(draws * p[rare].sum()) + 15


@pytest.mark.parametrize('draw', [one_by_one, at_once])
def test_whole_routes_have_the_probability_of_their_steps(draw):
    network, draws = paper_example(), 3_000
    strategy = solve(network)
    drawn = Counter(tuple(route.tolist()) for route in draw(strategy, draws, 7))
    assert len(drawn) == 7
    x, p = strategy.visit_probability, strategy.edge_probability
    expected = {
        route: draws * np.prod([p[k] / x[network.tails[k]] for k in edges])
        for route in drawn
        for edges in [route_edges(network, np.array(route))]
    }
    assert sum(expected.values()) == pytest.approx(draws, rel=1e-9)
    statistic = sum((drawn[r] - expected[r]) ** 2 / expected[r] for r in drawn)
    assert statistic < chdtri(6, FALSE_ALARM)


def test_routes_at_once_have_the_distribution_of_single_routes_of_strategies_with_cycles():
    network, draws = terrain_network(5, 'uniform_delaunay', 14), 2_000
    strategy = solve(network, options=StrategyOptions(solver='interior_point', max_detour=np.inf))
    assert not is_acyclic(network, strategy.edge_probability)
    single = edge_counts(network, one_by_one(strategy, draws, 3))
    many = edge_counts(network, at_once(strategy, draws, 4))
    share = (single + many) / (2 * draws)
    often = (share * draws > 30) & ((1 - share) * draws > 30)
    z = (single - many)[often] / np.sqrt(2 * draws * share * (1 - share))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())


def test_the_same_generator_state_gives_the_same_routes_and_none_are_none():
    strategy = solve(terrain_network(3, cells=12))
    one, two = (np.random.default_rng(5) for _ in range(2))
    first = [strategy.sample_route(one).tolist() for _ in range(8)]
    assert first == [strategy.sample_route(two).tolist() for _ in range(8)]
    assert len({tuple(route) for route in first}) > 1
    assert strategy.sample_routes(0, one) == []


def test_a_walk_that_circles_ten_thousand_times_is_still_simple():
    points = [[0, 0], [1, 0], [1, 1], [2, 0]]
    network = Network(points, [0, 1, 1, 0], [(0, 1), (1, 2), (2, 1), (1, 3)], 0, 3)
    sampler = RouteSampler(network, np.array([1.0, 9_999.0, 9_999.0, 1.0]))
    assert sampler.draw(np.random.default_rng(0)).tolist() == [0, 1, 3]
