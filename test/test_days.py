"""Convoys of one day: their joint distribution by enumeration, its effect, and impossible days."""

import math
from collections import Counter
from itertools import product

import networkx
import numpy as np
import pytest
from audit_oracles import routes_with_probabilities
from games import examples, networks
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.special import chdtri  # scipy.stats takes long to import

from ambush_planner import (
    InvalidOption,
    Network,
    NotDistinct,
    StrategyOptions,
    day_effect,
    sample_departures,
    solve,
)
from ambush_planner.routes.days import MiddleSection, _ConditionalFlow, draw_days

SHARES = st.sampled_from((0.0, 0.3, 0.5, 0.9, 1.0))


def corridors(*alphas):
    """Ways from s to t of three nodes each; the middle one of way k costs alphas[k]."""
    points, alpha, edges = [(0.0, 0.0)], [0.0], []
    target = 3 * len(alphas) + 1
    for k, loss in enumerate(alphas):
        points += [(1.0, k), (2.0, k), (3.0, k)]
        alpha += [0.0, loss, 0.0]
        way = [0, 3 * k + 1, 3 * k + 2, 3 * k + 3, target]
        edges += zip(way[:-1], way[1:], strict=True)
    points.append((4.0, 0.0))
    return Network(np.array(points), np.array([*alpha, 0.0]), np.array(edges), 0, target)


def exact_law(strategy, n, distinct):
    """The chance of each day of n routes, by multiplying out."""
    law, nodes = routes_with_probabilities(strategy), MiddleSection(strategy, distinct).nodes
    found = {}
    for day in product(law, repeat=n):
        driven = [j for route in day for j in route if nodes[j]]
        if len(driven) == len(set(driven)):
            found[day] = math.prod(law[route] for route in day)
    return found


@examples(40)
@given(networks(), SHARES, st.integers(1, 3))
def test_conditional_flows_average_to_the_exact_distribution(network, distinct, n):
    """Given each day of n - 1, the flow of one more; averaged over them, the exact marginal."""
    strategy = solve(network, options=StrategyOptions(max_detour=2.0))
    assume(len(routes_with_probabilities(strategy)) <= 12)
    law = exact_law(strategy, n, distinct)
    others = exact_law(strategy, n - 1, distinct)
    conditional, middle = _ConditionalFlow(strategy), MiddleSection(strategy, distinct)
    chance, flow = 0.0, np.zeros(len(network.edges))
    for day, probability in others.items():
        z, p = conditional.flow(middle, [[np.array(route) for route in day]])
        chance, flow = chance + probability * z, flow + probability * p
    assert chance == pytest.approx(sum(law.values()), abs=1e-12)
    expected = np.zeros(len(network.edges))
    number = {tuple(edge): k for k, edge in enumerate(network.edges.tolist())}
    for day, probability in law.items():
        for step in zip(day[-1][:-1], day[-1][1:], strict=True):
            expected[number[step]] += probability
    np.testing.assert_allclose(flow, expected, atol=1e-12)


@examples(40)
@given(networks(), SHARES, st.integers(1, 3), st.integers(0, 9))
def test_days_are_distinct_or_impossible(network, distinct, n, seed):
    strategy = solve(network, options=StrategyOptions(max_detour=2.0))
    middle = MiddleSection(strategy, distinct)
    try:
        routes = sample_departures(strategy, n, np.random.default_rng(seed), distinct)
    except NotDistinct:
        assert middle.max_disjoint(n) < n
        return
    assert len(routes) == n and middle.max_disjoint(n) == n
    driven = [j for route in routes for j in route.tolist() if middle.nodes[j]]
    assert len(driven) == len(set(driven))


@examples(30)
@given(networks(), SHARES)
def test_the_number_of_disjoint_routes_is_a_maximum_flow(network, distinct):
    strategy = solve(network, options=StrategyOptions(max_detour=2.0))
    middle = MiddleSection(strategy, distinct)
    graph = networkx.DiGraph()
    for j in range(len(network.points)):
        graph.add_edge(('in', j), ('out', j), capacity=1 if middle.nodes[j] else 4)
    for (tail, head), p in zip(network.edges.tolist(), strategy.edge_probability, strict=True):
        if p > 0.0:
            graph.add_edge(('out', tail), ('in', head), capacity=4)
    ends = ('in', network.source), ('out', network.target)
    assert middle.max_disjoint(4) == networkx.maximum_flow_value(graph, *ends)


def test_three_parallel_ways_by_hand():
    """Ways with chances 1/2, 1/4, 1/4: two distinct convoys drive the first with 0.4 each."""
    strategy = solve(corridors(1.0, 2.0, 2.0), options=StrategyOptions(max_detour=3.0,
                                                                       risk_slack=0.0))
    np.testing.assert_allclose(strategy.visit_probability[[2, 5, 8]], [0.5, 0.25, 0.25], atol=1e-4)
    effect = day_effect(strategy, 2, np.random.default_rng(1), 0.5, days=4000)
    np.testing.assert_allclose(effect.visit_probability[[2, 5, 8]], [0.4, 0.3, 0.3], atol=0.01)
    assert effect.share == pytest.approx(0.625, abs=0.02)
    assert effect.largest_change == pytest.approx(0.1, abs=0.01)
    # The ambusher leaves the first way: 2 x 0.3 instead of 0.5.
    assert strategy.value == pytest.approx(0.5, abs=1e-4)
    assert effect.value == pytest.approx(0.6, abs=5 * effect.standard_error)
    assert 0.0 < effect.standard_error < 0.01


def test_one_convoy_follows_the_strategy():
    strategy = solve(corridors(1.0, 2.0, 3.0), options=StrategyOptions(max_detour=3.0))
    effect = day_effect(strategy, 1, np.random.default_rng(1), 1.0, days=50)
    np.testing.assert_allclose(effect.visit_probability, strategy.visit_probability, atol=1e-9)
    assert effect.share == pytest.approx(1.0) and effect.standard_error < 1e-9
    assert effect.value == pytest.approx(strategy.value)


def test_days_are_drawn_with_their_exact_probabilities():
    strategy = solve(corridors(1.0, 2.0, 2.0, 5.0), options=StrategyOptions(max_detour=3.0))
    law = exact_law(strategy, 2, 0.5)
    total = sum(law.values())
    days, share = draw_days(strategy, 2, 20_000, np.random.default_rng(4), 0.5)
    seen = Counter(tuple(tuple(route.tolist()) for route in day) for day in days)
    assert set(seen) <= set(law) and len(law) == 12
    expected = {day: 20_000 * chance / total for day, chance in law.items()}
    statistic = sum((seen[day] - e) ** 2 / e for day, e in expected.items())
    assert statistic < chdtri(len(law) - 1, 0.0001)
    assert share == pytest.approx(total, abs=0.02)


def test_the_standard_error_matches_the_spread_of_estimates():
    """Over many estimates the error at the worst site is as large as they say."""
    strategy = solve(corridors(1.0, 1.5, 2.0, 5.0), options=StrategyOptions(max_detour=3.0))
    law = exact_law(strategy, 2, 0.5)
    total, exact = sum(law.values()), 0.0
    for k, loss in enumerate((1.0, 1.5, 2.0, 5.0)):
        visits = sum(chance for day, chance in law.items() if 3 * k + 2 in day[0]) / total
        exact = max(exact, loss * visits)
    found = [day_effect(strategy, 2, np.random.default_rng(k), 0.5, days=400) for k in range(25)]
    off = np.array([(each.value - exact) / each.standard_error for each in found])
    assert abs(off.mean()) < 1.0 and 0.5 < off.std() < 2.0


@pytest.mark.parametrize('distinct', [0.0, 0.2, 1.0])
def test_edges_across_the_middle_section_count(distinct):
    """Two convoys cannot both take the one edge that leads from before the middle behind it."""
    points = np.array([(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (10.0, 0.0), (5.0, 9.0)])
    edges = np.array([(0, 1), (1, 2), (2, 3), (0, 4), (4, 3)])
    network = Network(points, np.array([0.0, 1.0, 1.0, 0.0, 1.0]), edges, 0, 3)
    strategy = solve(network, options=StrategyOptions(max_detour=5.0))
    nodes = MiddleSection(strategy, distinct).nodes
    assert nodes.tolist() == [False, distinct > 0.0, distinct == 1.0, False, distinct > 0.0]


def test_reports_a_bottleneck():
    points = np.array([(0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (2.0, 0.0), (4.0, 0.0)])
    edges = np.array([(0, 1), (0, 2), (1, 3), (2, 3), (3, 4)])
    strategy = solve(Network(points, np.array([0.0, 1.0, 1.0, 1.0, 0.0]), edges, 0, 4))
    message = r'2 routes .* middle 60 % .* at most 1 can be; plan fewer convoys'
    with pytest.raises(NotDistinct, match=message):
        sample_departures(strategy, 2, np.random.default_rng(1), 0.6)
    with pytest.raises(NotDistinct, match='at most 1'):
        day_effect(strategy, 2, np.random.default_rng(1), 0.6)


def test_reports_that_distinct_days_are_too_rare():
    strategy = solve(corridors(*[1.0] * 6), options=StrategyOptions(max_detour=3.0))
    message = 'in 0 of 5 tries: distinct routes are too rare'
    with pytest.raises(NotDistinct, match=message):
        sample_departures(strategy, 6, np.random.default_rng(1), 0.5, tries=5)
    routes = sample_departures(strategy, 6, np.random.default_rng(1), 0.5)
    assert sorted(route[2] for route in routes) == [2, 5, 8, 11, 14, 17]


def test_no_effect_is_estimated_if_distinct_days_are_too_rare():
    """Of n convoys on n ways of equal chance, n! / n^n are distinct: 3.6e-4 of 10, 5.4e-5 of 12."""
    rng, options = np.random.default_rng(1), StrategyOptions(max_detour=6.0)
    strategy = solve(corridors(*[1.0] * 10), options=options)
    assert day_effect(strategy, 10, rng, days=20).share == pytest.approx(3.6e-4, rel=0.5)
    message = r'12 routes .* middle 50 % .* probability [3-8]\.?\d?e-05, too rarely .* is 0\.0001'
    with pytest.raises(NotDistinct, match=message):
        day_effect(solve(corridors(*[1.0] * 12), options=options), 12, rng, days=20)


def test_rejects_bad_options():
    strategy = solve(corridors(1.0, 2.0))
    rng = np.random.default_rng(1)
    for n, options in ((0, {}), (2, {'distinct': 1.5}), (2, {'distinct': -0.1}),
                       (2, {'distinct': math.nan}), (2, {'tries': 0}), (2.5, {})):
        with pytest.raises(InvalidOption):
            sample_departures(strategy, n, rng, **options)
    with pytest.raises(InvalidOption, match='days'):
        day_effect(strategy, 2, rng, days=3)


def test_rejects_trips_with_stops():
    """Two convoys there can share a place in different legs."""
    points = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])
    network = Network(
        np.concatenate((points, points)), np.zeros(6), np.array([(0, 4), (4, 5)]), 0, 5,
        np.tile(np.arange(3), 2), np.repeat([0, 1], 3),
    )
    with pytest.raises(InvalidOption, match='cannot have stops'):
        sample_departures(solve(network), 2, np.random.default_rng(0))
