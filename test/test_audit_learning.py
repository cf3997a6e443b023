"""Order and learning: shared ground, the permutation test, what an observer gains."""

from __future__ import annotations

import numpy as np
import pytest
from audit_oracles import drawn, routes_with_probabilities, run
from games import examples, networks, terrain_network
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.recordings.audit_departures import Driven, audit
from ambush_planner.recordings.audit_draws import ManyRoutes
from ambush_planner.recordings.audit_learning import (
    LEARNT,
    _until_pair,
    learning_from,
    repeat_probability,
)
from ambush_planner.recordings.audit_tallies import LONGEST_LAG

pytestmark = pytest.mark.usefixtures('fewer_draws')


@pytest.fixture(scope='module')
def terrain():
    return solve(terrain_network(3, cells=12))


# Order


def test_shared_ground_is_dices_coefficient_of_squares(terrain):
    """Recomputed for each pair of departures k apart, square by square."""
    routes = drawn(terrain, 9, 4)
    order = run(terrain, routes).order
    low = terrain.network.points.min(axis=0)
    squares = [
        {tuple(np.floor((terrain.network.points[node] - low) / order.square)) for node in route}
        for route in routes
    ]
    for k, share in enumerate(order.by_lag, start=1):
        pairs = zip(squares, squares[k:], strict=False)
        assert share == pytest.approx(np.mean(
            [2 * len(a & b) / (len(a) + len(b)) for a, b in pairs]
        ))
    assert len(order.by_lag) == 4


def test_departures_that_are_all_alike_have_no_order(terrain):
    result = run(terrain, drawn(terrain, 1, 1) * 8)
    assert result.order.by_lag.tolist() == [1.0] * 4
    assert result.tests['order'].p_value > 0.5 and 'repeats' in result.findings


def test_no_lag_is_longer_than_a_fortnight(terrain):
    assert len(run(terrain, drawn(terrain, 40, 1)).order.by_lag) == LONGEST_LAG


# Learning


def learning_of(strategy, routes):
    many = ManyRoutes(strategy.network, strategy.edge_probability)
    steps, _ = many.recorded(routes)
    every = np.arange(len(routes))
    return learning_from([(many, strategy)], np.zeros(len(routes), int), [steps], [every])


@examples(40)
@given(networks())
def test_repeat_probability_is_the_sum_over_all_routes(network):
    strategy = solve(network)
    expected = sum(q * q for q in routes_with_probabilities(strategy).values())
    many = ManyRoutes(network, strategy.edge_probability)
    assert repeat_probability(many) == pytest.approx(expected, rel=1e-9)


def test_an_observer_on_a_network_by_hand():
    """Two ways through nodes 1 (loss 2) and 2 (loss 3), driven with 0.6 and 0.4."""
    network = Network([[0, 0], [1, 1], [1, -1], [2, 0]], [0, 2, 3, 0],
                      [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    strategy = solve(network, options=StrategyOptions(max_detour=np.inf, risk_slack=0.0))
    p = strategy.edge_probability
    # 1e-5 of the value may be left for more entropy.
    np.testing.assert_allclose(p, [0.6, 0.4, 0.6, 0.4], atol=0.6e-5)
    routes = [np.array([0, node, 3]) for node in (1, 2, 1, 1, 1, 2)]
    learning = learning_of(strategy, routes)
    # He waits at 1, 2 (3 > 2), 1 (4 > 3), 1, 1; the next routes pass 2, 1, 1, 1, 2.
    assert learning.ambusher_loss == pytest.approx((0 + 0 + 2 + 2 + 0) / 5)
    assert learning.ambushes == 2
    assert learning.fixed_loss == pytest.approx((4 * 2 + 2 * 3) / 6)
    assert learning.value == pytest.approx(1.2, rel=1e-5)
    assert learning.loss_after == pytest.approx([1.2] * 6, rel=1e-5)
    assert learning.departures_to_learn == 1
    assert learning.departures_to_repeat == 3.0  # 3 pairs x 0.52 > 1, one pair is not
    assert learning.effective_routes == pytest.approx(0.6**-0.6 * 0.4**-0.4, rel=1e-5)


@given(st.floats(1e-12, 1.0))
@examples(100)
def test_departures_until_a_pair_is_expected(repeat):
    n = _until_pair(repeat)
    assert n * (n - 1) / 2 * repeat >= 1.0 - 1e-9
    assert (n - 1) * (n - 2) / 2 * repeat < 1.0 + 1e-9


def test_watching_never_brings_more_than_the_value(terrain):
    """Fictitious play over 3000 departures: at most the value, by five standard errors."""
    learning = learning_of(terrain, drawn(terrain, 3000, 6))
    assert (learning.loss_after <= learning.value * (1 + 1e-12)).all()
    error = float(terrain.game.loss.max()) / np.sqrt(3000)
    assert learning.ambusher_loss <= learning.value + 5.0 * error
    assert learning.departures_to_learn <= 3000
    assert learning.loss_after[learning.departures_to_learn - 1] >= LEARNT * learning.value
    assert learning.fixed_loss > 2.0 * learning.value


def test_an_ambush_with_a_reach_counts_each_passage_of_its_disc():
    strategy = solve(terrain_network(3, cells=12), GameOptions(ambush_radius=2.0))
    learning = learning_of(strategy, drawn(strategy, 400, 1))
    assert learning.value == pytest.approx(strategy.value)
    assert learning.ambusher_loss <= strategy.value + float(strategy.game.loss.max()) / 4.0
    assert learning.fixed_loss >= strategy.value


def test_places_of_several_strategies_count_as_one(terrain):
    """Halves of the departures with a copy of the strategy: the observer learns the same."""
    routes = drawn(terrain, 40, 2)
    copy = solve(terrain_network(3, cells=12))
    both = audit([
        Driven(copy if k % 2 else terrain, route) for k, route in enumerate(routes)
    ])
    one = run(terrain, routes)
    assert both.strategies == 2
    assert both.learning.loss_after == pytest.approx(one.learning.loss_after)
    assert both.learning.ambusher_loss == pytest.approx(one.learning.ambusher_loss)
    assert both.tests['frequency'].observed == pytest.approx(one.tests['frequency'].observed)
