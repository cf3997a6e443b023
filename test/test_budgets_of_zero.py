"""Budgets at a value or a least exposure of 0: a mixture of two routes, and edges at no cost."""

import numpy as np
import pytest
from games import examples, least_weight, networks, terrain_network, unbalanced
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from ambush_planner import BudgetInfeasible, GameOptions, Network, NoRoute, StrategyOptions, solve


def two_ways():
    """A short way of exposure 12, and one of length and exposure 7.2; no site is unsecured."""
    points = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 3.0), (4.0, 0.0)])
    edges = np.array([(0, 1), (1, 3), (0, 2), (2, 3)])
    return Network(points, np.array([0.0, 3.0, 1.0, 0.0]), edges, 0, 3), GameOptions(0.0, 9.0)


def test_a_mixture_of_two_routes_keeps_both_budgets_at_value_0():
    network, game = two_ways()
    strategy = solve(network, game, StrategyOptions(max_detour=1.5, max_exposure=1.4))
    assert strategy.value == 0.0
    assert strategy.expected_length <= 6.0 * (1 + 1e-6)
    assert strategy.expected_exposure <= strategy.exposure_budget * (1 + 1e-6)
    assert 0.39 < strategy.edge_probability[2] < 0.63


@pytest.mark.parametrize('radius', [0.0, 1.0])
def test_no_mixture_keeps_both_budgets_at_value_0(radius):
    network, _ = two_ways()
    with pytest.raises(BudgetInfeasible, match='max_detour and max_exposure'):
        solve(network, GameOptions(radius, 9.0), StrategyOptions(max_detour=1.2, max_exposure=1.2))


def least_exposure(network, length):
    """Least mean exposure of a strategy within the mean length, by one linear program."""
    count, edges = len(network.points), np.arange(len(network.edges))
    balance = np.zeros((count, len(edges)))
    np.add.at(balance, (network.tails, edges), 1.0)
    np.add.at(balance, (network.heads, edges), -1.0)
    supply = np.zeros(count)
    supply[[network.source, network.target]] = 1.0, -1.0
    found = linprog(network.edge_exposure, [network.lengths], [length], balance, supply)
    assert found.status == 0
    return found.fun


@pytest.mark.parametrize(('detour', 'exposure'), [(1.05, 1.05), (1.1, 1.02), (1.02, 1.1)])
@pytest.mark.parametrize('seed', [4, 33, 36, 37, 38, 40, 42])
def test_two_budgets_at_value_0_are_kept_if_that_is_possible(seed, detour, exposure):
    network = terrain_network(seed, 'uniform_delaunay', 8)
    shortest = least_weight(network, network.lengths)
    most = exposure * least_weight(network, network.edge_exposure)
    options = StrategyOptions(max_detour=detour, max_exposure=exposure)
    if least_exposure(network, detour * shortest) > most * (1 + 1e-9):
        with pytest.raises(BudgetInfeasible, match='max_detour and max_exposure'):
            solve(network, GameOptions(secured_radius=99.0), options)
        return
    strategy = solve(network, GameOptions(secured_radius=99.0), options)
    assert strategy.value == 0.0
    assert strategy.expected_length <= detour * shortest * (1 + 1e-6)
    assert strategy.expected_exposure <= most * (1 + 1e-6)


def test_a_strategy_without_exposure_has_none_despite_rounding():
    """Ambushes reach the routes of exposure 0, so that the value is positive."""
    points = [(1, 2), (2, 5), (1, 5), (1, 6), (2, 0), (5, 4), (3, 2)]
    edges = [
        (0, 1), (0, 2), (0, 4), (0, 6), (1, 3), (1, 4), (1, 5), (1, 6), (2, 1), (2, 4), (2, 5),
        (2, 6), (3, 5), (4, 2), (4, 3), (4, 5), (5, 2), (5, 3),
    ]
    alpha = np.array([0.0, 0.0, 1.0, 0.5, 0.5, 0.0, 0.0])
    network = Network(np.array(points, float), alpha, np.array(edges), 0, 6)
    options = StrategyOptions(max_detour=2.0, max_exposure=1.0, risk_slack=0.1)
    strategy = solve(network, GameOptions(ambush_radius=2.0, secured_radius=0.5), options)
    assert strategy.expected_exposure == strategy.exposure_budget == 0.0
    assert strategy.value == pytest.approx(1.0 / 3.0, rel=0.1)


@examples(120)
@given(
    networks((0.0, 0.0, 0.5, 1.0, 3.0)),
    st.sampled_from((0.0, 1.0, 2.0)),
    st.sampled_from((1.0, 1.05, 1.5, 3.0, np.inf)),
    st.sampled_from((1.0, 1.05, 1.5, np.inf)),
)
def test_any_budgets_are_kept_or_infeasible(network, radius, detour, exposure):
    options = StrategyOptions(max_detour=detour, max_exposure=exposure)
    try:
        strategy = solve(network, GameOptions(ambush_radius=radius), options)
    except (BudgetInfeasible, NoRoute):
        return
    assert unbalanced(network, strategy.edge_probability) < 1e-9
    assert strategy.expected_length <= strategy.length_budget * (1 + 1e-6)
    assert strategy.expected_exposure <= strategy.exposure_budget * (1 + 1e-6)


def test_two_budgets_of_zero_need_both_prices():
    # The way by a costs nothing, by b only time, by c only exposure: a bound needs both prices.
    points = [[0, 0], [0, 0], [1, 0], [2, 0], [0, 0]]
    edges = [(0, 1), (1, 4), (0, 2), (2, 4), (0, 3), (3, 4)]
    network = Network(points, [0, 1, 0, 1e-3, 0], edges, 0, 4, seconds=[0, 0, 1, 1, 0, 0])
    strategy = solve(network, options=StrategyOptions(max_detour=1.0, max_exposure=1.0))
    assert strategy.value == pytest.approx(1.0)
    assert strategy.lower_bound == pytest.approx(1.0, rel=1e-6)
