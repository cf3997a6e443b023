# SPDX-License-Identifier: Apache-2.0
"""The bottleneck report: the decisive sites."""

import numpy as np
import pytest

from ambush_planner import Network, StrategyOptions, solve
from ambush_planner.game.bottleneck import find_bottleneck


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
    report = find_bottleneck(strategy.alone)
    assert report.sites.tolist() == [1]
    assert report.near_ends == 1
    assert strategy.value == pytest.approx(2.0, rel=1e-6)


def test_a_game_of_value_zero_has_no_decisive_sites():
    points = np.array([[0, 0], [1, 0], [2, 0.0]])
    network = Network(points, np.zeros(3), np.array([[0, 1], [1, 2]]), 0, 2)
    strategy = solve(network)
    report = find_bottleneck(strategy.alone)
    assert len(report.sites) == 0 and report.near_ends == 0
    assert strategy.value == 0.0
