"""Order and learning: shared ground, the permutation test, what an observer gains."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from audit_oracles import drawn, routes_with_probabilities, run
from games import examples, networks, paper_example, terrain_network
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.core.audit_draws import ManyRoutes, recorded_steps
from ambush_planner.core.audit_learning import (
    LEARNT,
    _until_pair,
    learning_from,
    repeat_probability,
)
from ambush_planner.core.audit_order import LONGEST_LAG, order_of, shared_ground


@pytest.fixture(scope="module")
def terrain():
    return solve(terrain_network(3, cells=12))


# Order


def test_shared_ground_is_dices_coefficient_of_squares():
    network = paper_example()
    routes = [np.array([0, 1, 4, 7]), np.array([0, 1, 5, 7]), np.array([0, 3, 6, 7])]
    share = shared_ground(network, routes, 1.0)
    squares = [{tuple(np.floor(network.points[node])) for node in route} for route in routes]
    for i, j in np.ndindex(3, 3):
        common = 2 * len(squares[i] & squares[j]) / (len(squares[i]) + len(squares[j]))
        assert share[i, j] == pytest.approx(common)
    assert share[0, 1] == 0.75 and share[0, 2] == 0.5


def test_the_order_test_is_the_permutation_test():
    """All 720 orders of 6 departures give the p-value that 20000 shuffles estimate."""
    rng = np.random.default_rng(5)
    share = rng.random((6, 6))
    share = (share + share.T) / 2.0
    np.fill_diagonal(share, 1.0)
    result = order_of(share, 1.0, 20_000, np.random.default_rng(1))

    def statistic(order):
        means = [np.mean([share[order[i], order[i + k]] for i in range(6 - k)]) for k in (1, 2, 3)]
        pairs = [share[i, j] for i, j in permutations(range(6), 2)]
        deviations = np.abs(np.array(means) - np.mean(pairs)) / np.std(pairs)
        return float((deviations * np.sqrt(6 - np.arange(1, 4))).max())

    recorded = statistic(range(6))
    assert result.statistic == pytest.approx(recorded)
    exact = np.mean([statistic(order) >= recorded - 1e-9 for order in permutations(range(6))])
    estimate = np.mean(result.shuffled >= recorded - 1e-9)
    assert abs(estimate - exact) < 5.0 * math.sqrt(exact * (1 - exact) / 20_000)


def test_departures_that_are_all_alike_have_no_order():
    result = order_of(np.ones((8, 8)), 1.0, 99, np.random.default_rng(1))
    assert result.statistic == 0.0 and not result.shuffled.any() and not result.band.any()
    assert result.mean == 1.0 and result.by_lag.tolist() == [1.0] * 4


def test_no_lag_is_longer_than_a_fortnight():
    share = np.eye(60)
    assert len(order_of(share, 1.0, 9, np.random.default_rng(1)).by_lag) == LONGEST_LAG


# Learning


@examples(60)
@given(networks())
def test_repeat_probability_is_the_sum_over_all_routes(network):
    strategy = solve(network)
    expected = sum(q * q for q in routes_with_probabilities(strategy).values())
    many = ManyRoutes(network, strategy.edge_probability)
    assert repeat_probability(many, strategy.game) == pytest.approx(expected, rel=1e-9)


def test_an_observer_on_a_network_by_hand():
    """Two ways through nodes 1 (loss 2) and 2 (loss 3), driven with 0.6 and 0.4."""
    network = Network([[0, 0], [1, 1], [1, -1], [2, 0]], [0, 2, 3, 0],
                      [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf))
    p = strategy.edge_probability
    np.testing.assert_allclose(p, [0.6, 0.4, 0.6, 0.4], atol=1e-6)
    routes = [np.array([0, node, 3]) for node in (1, 2, 1, 1, 1, 2)]
    steps, _ = recorded_steps(network, p, routes)
    learning = learning_from(strategy.game, p, ManyRoutes(network, p), steps)
    # He waits at 1, 2 (3 > 2), 1 (4 > 3), 1, 1; the next routes pass 2, 1, 1, 1, 2.
    assert learning.ambusher_loss == pytest.approx((0 + 0 + 2 + 2 + 0) / 5)
    assert learning.ambushes == 2
    assert learning.ambusher_error == pytest.approx(np.std([0, 0, 2, 2, 0]) / math.sqrt(5))
    assert learning.fixed_loss == pytest.approx((4 * 2 + 2 * 3) / 6)
    assert learning.value == pytest.approx(1.2) and learning.loss_after == pytest.approx([1.2] * 6)
    assert learning.departures_to_learn == 1
    assert learning.repeat_probability == pytest.approx(0.52, abs=1e-5)
    assert learning.departures_to_repeat == 3.0  # 3 pairs x 0.52 > 1, one pair is not
    assert learning.effective_routes == pytest.approx(0.6**-0.6 * 0.4**-0.4, rel=1e-5)


@given(st.floats(1e-12, 1.0))
@examples(300)
def test_departures_until_a_pair_is_expected(repeat):
    n = _until_pair(repeat)
    assert n * (n - 1) / 2 * repeat >= 1.0 - 1e-9
    assert (n - 1) * (n - 2) / 2 * repeat < 1.0 + 1e-9


def test_watching_never_brings_more_than_the_value(terrain):
    """Fictitious play over 3000 departures: at most the value, by five standard errors."""
    p = terrain.edge_probability
    steps, _ = recorded_steps(terrain.network, p, drawn(terrain, 3000, 6))
    learning = learning_from(terrain.game, p, ManyRoutes(terrain.network, p), steps)
    assert (learning.loss_after <= learning.value * (1 + 1e-12)).all()
    assert learning.ambusher_loss <= learning.value + 5.0 * learning.ambusher_error
    assert learning.departures_to_learn <= 3000
    assert learning.loss_after[learning.departures_to_learn - 1] >= LEARNT * learning.value
    assert learning.fixed_loss > 2.0 * learning.value


def test_an_ambush_with_a_reach_counts_each_passage_of_its_disc():
    strategy = solve(terrain_network(3, cells=12), GameOptions(ambush_radius=2.0))
    result = run(strategy, drawn(strategy, 400, 1))
    assert result.learning.value == pytest.approx(strategy.value)
    assert result.learning.ambusher_loss <= strategy.value + 5.0 * result.learning.ambusher_error
    assert result.learning.fixed_loss >= strategy.value


def test_the_chance_of_a_route_seen_before_is_the_sum_over_those_seen(terrain):
    p, network = terrain.edge_probability, terrain.network
    routes = [*drawn(terrain, 8, 3), *drawn(terrain, 8, 3), np.array([network.source])]
    known = {tuple(route): 0.0 for route in routes[:8]}
    many = ManyRoutes(network, p)
    edge = {(int(a), int(b)): k for k, (a, b) in enumerate(network.edges)}
    for route in known:
        passed = zip(route[:-1], route[1:], strict=True)
        known[route] = math.prod(many.choice[edge[step]] for step in passed)
    steps, _ = recorded_steps(network, p, routes)
    learning = learning_from(terrain.game, p, many, steps)
    assert learning.seen_probability == pytest.approx(sum(known.values()), rel=1e-9)
