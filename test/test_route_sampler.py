"""Drawn routes have the published probabilities; dense paths keep to their corners."""

from __future__ import annotations

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


@pytest.mark.parametrize('solver', SOLVERS)
def test_routes_are_simple_and_lead_from_source_to_target(solver):
    network = terrain_network(5, 'uniform_delaunay', 14)
    strategy = solve(network, options=StrategyOptions(solver, np.inf))
    rng = np.random.default_rng(1)
    for _ in range(300):
        check_route(network, strategy.sample_route(rng))


@examples(50)
@given(networks(), st.sampled_from(SOLVERS), st.integers(0, 9))
def test_routes_of_any_network_are_simple_and_use_its_edges(network, solver, seed):
    strategy = solve(network, options=StrategyOptions(solver))
    route = strategy.sample_route(np.random.default_rng(seed))
    check_route(network, route)
    assert (strategy.edge_probability[route_edges(network, route)] > 0.0).all()


@pytest.mark.parametrize(
    'network', [paper_example(), terrain_network(3, cells=9)], ids=['paper', 'terrain']
)
def test_drawn_frequencies_are_the_published_probabilities(network):
    """Every edge's count is binomial: normal approximation, Bonferroni over the edges."""
    strategy, draws = solve(network), 20_000
    sampler, rng = strategy, np.random.default_rng(42)
    counts = np.zeros(len(network.edges))
    for _ in range(draws):
        counts[route_edges(network, sampler.sample_route(rng))] += 1
    p = strategy.edge_probability
    often = (p * draws > 30) & ((1 - p) * draws > 30)
    z = (counts - draws * p)[often] / np.sqrt(draws * p * (1 - p))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())
    assert (counts[p == 0.0] == 0).all()
    assert counts[p > 1 - 1e-9] == pytest.approx(draws)
    rare = p * draws <= 30
    assert counts[rare].sum() <= draws * p[rare].sum() + 6 * np.sqrt(draws * p[rare].sum()) + 15


def test_whole_routes_are_as_likely_as_the_walk_says():
    network, draws = paper_example(), 20_000
    strategy, rng = solve(network), np.random.default_rng(7)
    drawn: dict[tuple, int] = {}
    for _ in range(draws):
        route = tuple(strategy.sample_route(rng).tolist())
        drawn[route] = drawn.get(route, 0) + 1
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


def many_counts(network, strategy, draws: int, seed: int) -> np.ndarray:
    """How often many routes use each edge; what ``check_route`` says holds for each of them."""
    routes = strategy.sample_routes(draws, np.random.default_rng(seed))
    ends = {(int(route[0]), int(route[-1])) for route in routes}
    assert ends == {(network.source, network.target)}
    count = len(network.points)
    visits = np.concatenate([k * count + route for k, route in enumerate(routes)])
    assert len(np.unique(visits)) == len(visits)
    steps = np.concatenate([route[:-1] * count + route[1:] for route in routes])
    keys = network.tails * count + network.heads
    assert np.isin(steps, keys).all()
    order = np.argsort(keys)
    return np.bincount(order[np.searchsorted(keys, steps, sorter=order)], minlength=len(keys))


@pytest.mark.parametrize('cells', [9, 16])
def test_many_routes_at_once_have_the_published_probabilities(cells):
    network, draws = terrain_network(3, cells=cells), 20_000
    strategy = solve(network)
    p, counts = strategy.edge_probability, many_counts(network, strategy, draws, 11)
    often = (p * draws > 30) & ((1 - p) * draws > 30)
    z = (counts - draws * p)[often] / np.sqrt(draws * p * (1 - p))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())
    assert (counts[p == 0.0] == 0).all()


@pytest.mark.parametrize('solver', ['max_entropy', 'interior_point'])
def test_many_at_once_follow_the_law_of_one_by_one(solver):
    """Also where the strategy circles: two samples of each edge's use, compared."""
    network, draws = terrain_network(5, 'uniform_delaunay', 14), 4_000
    strategy = solve(network, options=StrategyOptions(solver, np.inf))
    assert is_acyclic(network, strategy.edge_probability) == (solver == 'max_entropy')
    single, rng = np.zeros(len(network.edges)), np.random.default_rng(3)
    for _ in range(draws):
        single[route_edges(network, strategy.sample_route(rng))] += 1
    many = many_counts(network, strategy, draws, 4)
    share = (single + many) / (2 * draws)
    often = (share * draws > 30) & ((1 - share) * draws > 30)
    z = (single - many)[often] / np.sqrt(2 * draws * share * (1 - share))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())


def test_whole_routes_at_once_are_as_likely_as_the_walk_says():
    network, draws = paper_example(), 20_000
    strategy = solve(network)
    drawn: dict[tuple, int] = {}
    for route in strategy.sample_routes(draws, np.random.default_rng(8)):
        drawn[tuple(route.tolist())] = drawn.get(tuple(route.tolist()), 0) + 1
    x, p = strategy.visit_probability, strategy.edge_probability
    expected = {
        route: draws * np.prod([p[k] / x[network.tails[k]] for k in edges])
        for route in drawn
        for edges in [route_edges(network, np.array(route))]
    }
    statistic = sum((drawn[r] - expected[r]) ** 2 / expected[r] for r in drawn)
    assert len(drawn) == 7 and statistic < chdtri(6, FALSE_ALARM)


def test_none_and_one_at_once():
    strategy = solve(paper_example())
    assert strategy.sample_routes(0, np.random.default_rng(1)) == []
    (route,) = strategy.sample_routes(1, np.random.default_rng(1))
    check_route(paper_example(), route)


def test_the_same_generator_state_gives_the_same_routes():
    strategy = solve(terrain_network(3, cells=12))
    one, two = (np.random.default_rng(5) for _ in range(2))
    first = [strategy.sample_route(one).tolist() for _ in range(8)]
    assert first == [strategy.sample_route(two).tolist() for _ in range(8)]
    assert len({tuple(route) for route in first}) > 1


def test_a_walk_that_circles_ten_thousand_times_is_still_simple():
    points = [[0, 0], [1, 0], [1, 1], [2, 0]]
    network = Network(points, [0, 1, 1, 0], [(0, 1), (1, 2), (2, 1), (1, 3)], 0, 3)
    sampler = RouteSampler(network, np.array([1.0, 9_999.0, 9_999.0, 1.0]))
    assert sampler.draw(np.random.default_rng(0)).tolist() == [0, 1, 3]
