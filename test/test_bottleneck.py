# SPDX-License-Identifier: Apache-2.0
"""The bottleneck report: the decisive sites, and the value with secured ends."""

import math

import numpy as np
import pytest

from ambush_planner import GameOptions, Network, StrategyOptions, solve
from ambush_planner.game.bottleneck import find_bottleneck, secured_bound


def detour_network() -> Network:
    """s, a site of loss 2, then three sites abreast, 0, 3 and 4 m off the straight road, t."""
    road = [[float(x), 0.0] for x in range(13)]
    points = [*road, [6, 3], [6, -4]]
    alpha = np.zeros(15)
    alpha[1], abreast = 2.0, [6, 13, 14]
    alpha[abreast] = 1.0
    edges = [[k, k + 1] for k in range(12) if k not in (5, 6)]
    edges += [[5, k] for k in abreast] + [[k, 7] for k in abreast]
    return Network(np.array(points, float), alpha, np.array(edges), 0, 12)


def test_the_decisive_site_and_its_place_are_reported():
    strategy = solve(detour_network(), options=StrategyOptions(max_detour=np.inf))
    report = find_bottleneck(strategy)
    assert report.sites.tolist() == [1]
    assert report.near_ends == 1
    assert strategy.value == pytest.approx(2.0, rel=1e-6)
    # With that site out of the game, the ambusher picks one of three.
    assert secured_bound(strategy, report.distance) == pytest.approx(1 / 3, rel=1e-6)


@pytest.mark.parametrize('detour', [1.0, 1.05, 2.0])
def test_the_secured_bound_keeps_the_budget(detour):
    """It is what solving without the sites near the ends gives within the same budget."""
    network = detour_network()
    options = StrategyOptions(max_detour=detour, risk_slack=0.0)
    strategy = solve(network, options=options)
    distance = find_bottleneck(strategy).distance
    secured = solve(network, GameOptions(secured_radius=distance), options)
    bound = secured_bound(strategy, distance)
    assert bound == pytest.approx(secured.value, rel=1e-4)
    if detour == 1.0:
        assert bound == pytest.approx(1.0)


def test_without_time_nothing_is_said_of_secured_ends():
    """A bound of 0 would promise that holding the ends ends the danger."""
    strategy = solve(detour_network(), options=StrategyOptions(max_detour=1.01))
    assert secured_bound(strategy, find_bottleneck(strategy).distance, -math.inf) is None


def test_a_game_of_value_zero_has_no_decisive_sites():
    points = np.array([[0, 0], [1, 0], [2, 0.0]])
    network = Network(points, np.zeros(3), np.array([[0, 1], [1, 2]]), 0, 2)
    strategy = solve(network)
    report = find_bottleneck(strategy)
    assert len(report.sites) == 0 and report.near_ends == 0
    assert secured_bound(strategy, report.distance) == strategy.value == 0.0
