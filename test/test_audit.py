"""The audit's parts against slow, independent answers; its conduct on any network."""

from __future__ import annotations

import math
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from audit_oracles import drawn, routes_with_probabilities, run
from games import examples, networks, paper_example, terrain_network
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtri  # scipy.stats takes long to import

from ambush_planner import InvalidOption, Network, solve
from ambush_planner.game.route_sampler import route_edges
from ambush_planner.recordings import audit_departures as auditing
from ambush_planner.recordings.audit_departures import FEWEST_DEPARTURES, TESTS
from ambush_planner.recordings.audit_draws import ManyRoutes, NotAuditable
from ambush_planner.recordings.audit_tallies import identical_pairs

FALSE_ALARM = 1e-6


@pytest.fixture(scope='module')
def paper():
    return solve(paper_example())


@pytest.fixture(scope='module')
def terrain():
    return solve(terrain_network(3, cells=12))


# Draws


def test_many_routes_have_the_law_of_the_walk(paper):
    count = 40_000
    steps = ManyRoutes(paper.network, paper.edge_probability).draw(count, np.random.default_rng(1))
    heads = paper.network.heads[steps.edge]
    order = np.argsort(steps.route, kind='stable')
    walks = np.split(heads[order], np.flatnonzero(np.diff(steps.route[order])) + 1)
    seen = Counter((paper.network.source, *walk.tolist()) for walk in walks)
    expected = {route: count * q for route, q in routes_with_probabilities(paper).items()}
    assert set(seen) == set(expected) and len(expected) == 7
    statistic = sum((seen[r] - e) ** 2 / e for r, e in expected.items())
    assert statistic < chdtri(6, FALSE_ALARM)


def test_many_routes_use_edges_with_the_published_probabilities(terrain):
    p, count = terrain.edge_probability, 50_000
    steps = ManyRoutes(terrain.network, p).draw(count, np.random.default_rng(2))
    passages = np.bincount(steps.edge, minlength=len(p))
    often = (count * p > 30) & (count * (1 - p) > 30)
    z = (passages - count * p)[often] / np.sqrt(count * p * (1 - p))[often]
    assert (z**2).max() < chdtri(1, FALSE_ALARM / often.sum())
    assert (passages[p == 0.0] == 0).all()


@examples(40)
@given(networks(), st.integers(0, 9))
def test_many_routes_lead_from_source_to_target_on_used_edges(network, seed):
    strategy = solve(network)
    p = strategy.edge_probability
    steps = ManyRoutes(network, p).draw(50, np.random.default_rng(seed))
    assert (p[steps.edge] > 0.0).all()
    for k in range(50):
        edges = steps.edge[steps.route == k]
        assert network.tails[edges[0]] == network.source
        assert network.heads[edges[-1]] == network.target
        assert (network.heads[edges[:-1]] == network.tails[edges[1:]]).all()


def test_sets_of_draws_are_complete_whatever_the_memory_allows(paper, monkeypatch):
    many = ManyRoutes(paper.network, paper.edge_probability)
    monkeypatch.setattr('ambush_planner.recordings.audit_draws.ROUTES_AT_ONCE', 10)
    parts = list(many.draw_sets(4, 7, np.random.default_rng(0)))
    assert [sets.stop - sets.start for sets, _ in parts] == [2, 2, 2, 1]
    assert [steps.count for _, steps in parts] == [8, 8, 8, 4]


def test_a_strategy_with_cycles_is_refused():
    network = Network([[0, 0], [1, 0], [1, 1], [2, 0]], [0, 1, 1, 0],
                      [(0, 1), (1, 2), (2, 1), (1, 3)], 0, 3)
    p = np.array([1.0, 0.5, 0.5, 1.0])
    with pytest.raises(NotAuditable, match='cycles'):
        ManyRoutes(network, p)


def test_steps_of_recorded_routes_and_what_cannot_have_been_drawn(paper):
    network, p = paper.network, paper.edge_probability.copy()
    routes = [np.array([0, 1, 4, 7]), np.array([0, 2, 5, 7])]
    steps, impossible = ManyRoutes(network, p).recorded(routes)
    assert impossible == 0 and steps.count == 2
    edges = [tuple(edge) for edge in network.edges[steps.edge].tolist()]
    assert edges == [(0, 1), (1, 4), (4, 7), (0, 2), (2, 5), (5, 7)]
    assert steps.route.tolist() == [0, 0, 0, 1, 1, 1]
    # 1 -> 6 is no edge, the second route ends early and the third begins late.
    wrong = [np.array([0, 1, 6, 7]), np.array([0, 1, 4]), np.array([1, 4, 7])]
    assert ManyRoutes(network, p).recorded(wrong)[1] == 3
    p[route_edges(network, np.array([1, 4]))] = 0.0
    assert ManyRoutes(network, p).recorded([np.array([0, 1, 4, 7])])[1] == 1


# The statistics


def test_frequency_surprise_and_repeats_by_hand(paper):
    routes = drawn(paper, 9, 3)
    result = run(paper, routes)
    p, n = paper.edge_probability, 9
    passages = Counter(e for route in routes for e in route_edges(paper.network, route).tolist())
    frequency = sum(
        (passages[e] - n * p[e]) ** 2 / (n * p[e] * (1 - p[e]) + 1)
        for e in range(len(p)) if p[e] > 0.0
    )
    assert result.tests['frequency'].observed == pytest.approx(frequency)
    probability = routes_with_probabilities(paper)
    surprise = [-math.log(probability[tuple(route.tolist())]) for route in routes]
    assert result.mean_surprise == pytest.approx(np.mean(surprise))
    assert result.tests['surprise'].observed == pytest.approx(
        abs(sum(surprise) - n * paper.route_entropy)
    )
    same = sum(tuple(a.tolist()) == tuple(b.tolist()) for a, b in combinations(routes, 2))
    assert result.tests['repeats'].observed == same
    assert sorted(result.passages.tolist()) == sorted(passages[e] for e in np.flatnonzero(p))
    assert result.expected.sum() == pytest.approx(n * p.sum())
    assert result.different == len({tuple(route.tolist()) for route in routes})


def test_what_is_expected_by_chance_is_what_theory_says(paper):
    """Means over the resamples: of repeats exactly; of the frequencies up to the 1 below."""
    n = 12
    result = run(paper, drawn(paper, n, 4))
    p = paper.edge_probability
    pairs = n * (n - 1) / 2 * sum(q * q for q in routes_with_probabilities(paper).values())
    assert result.tests['repeats'].expected == pytest.approx(pairs, rel=0.05)
    variance = n * p * (1 - p)
    assert result.tests['frequency'].expected == pytest.approx(
        (variance / (variance + 1)).sum(), rel=0.05
    )


@given(st.lists(st.lists(st.integers(0, 3), min_size=6, max_size=6), min_size=1, max_size=4))
@examples(60)
def test_identical_pairs_are_counted(rows):
    expected = [sum(a == b for a, b in combinations(row, 2)) for row in rows]
    assert identical_pairs(np.array(rows, dtype=np.uint64)).tolist() == expected


def test_holms_method():
    found = {'a': (0.0, 0.0, 0.004), 'b': (0.0, 0.0, 0.0024), 'c': (0.0, 0.0, 0.02),
             'd': (0.0, 0.0, 0.0032)}
    judged = auditing._judged(found, 0.01)
    assert {name for name, verdict in judged.items() if verdict.finding} == {'a', 'b', 'd'}
    found['b'] = (0.0, 0.0, 0.0026)
    assert not any(verdict.finding for verdict in auditing._judged(found, 0.01).values())


# The whole


@pytest.mark.usefixtures('fewer_draws')
@examples(30)
@given(networks(), st.integers(FEWEST_DEPARTURES, 9), st.integers(0, 9))
def test_any_departures_of_any_network_can_be_audited(network, count, seed):
    strategy = solve(network)
    routes = drawn(strategy, count, seed)
    result = run(strategy, routes)
    assert set(result.tests) == set(TESTS) and result.departures == count
    assert result.impossible == 0
    assert all(0.0 < verdict.p_value <= 1.0 for verdict in result.tests.values())
    assert result.passages.sum() == sum(len(route) - 1 for route in routes)
    assert np.isfinite(result.learning.loss_after).all()


def test_a_strategy_without_choice_has_nothing_to_find():
    network = Network([[0, 0], [1, 0], [2, 0]], [0, 3, 0], [(0, 1), (1, 2)], 0, 2)
    strategy = solve(network)
    result = run(strategy, [np.array([0, 1, 2])] * 6)
    assert result.findings == () and result.different == 1
    assert all(verdict.p_value == 1.0 for verdict in result.tests.values())
    assert result.learning.effective_routes == pytest.approx(1.0)
    assert result.learning.departures_to_repeat == 2.0


def test_a_game_without_losses_can_be_audited():
    network = Network(paper_example().points, np.zeros(8), paper_example().edges, 0, 7)
    strategy = solve(network)
    result = run(strategy, drawn(strategy, 6, 1))
    assert result.learning.value == result.learning.fixed_loss == 0.0
    assert result.learning.departures_to_learn == 1


def test_the_same_departures_give_the_same_audit(terrain):
    one, two = (run(terrain, drawn(terrain, 10, 7)) for _ in range(2))
    assert one.tests == two.tests


def test_impossible_steps_are_a_finding_of_their_own(paper):
    result = run(paper, [*drawn(paper, 8, 1), np.array([0, 1, 6, 7])])
    assert result.impossible == 1 and result.findings[0] == 'impossible'


def test_too_few_departures_and_rates_out_of_range_are_refused(paper):
    with pytest.raises(NotAuditable, match='4 departures are too few'):
        run(paper, drawn(paper, FEWEST_DEPARTURES - 1, 1))
    for rate in (0.0, -0.1, 0.0009, 0.9, math.nan):
        with pytest.raises(InvalidOption, match='false alarm rate'):
            run(paper, drawn(paper, 6, 1), rate)


@pytest.mark.parametrize('rate', [0.001, 0.01, 0.05, 0.5])
def test_the_smallest_p_value_can_always_be_a_finding(rate):
    assert 1.0 / (auditing._resamples(rate, 1, 1) + 1) <= rate / len(TESTS)
