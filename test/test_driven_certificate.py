"""The value holds for what is driven: drawn, driven and hit, by geometry alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    RiskMap,
    StrategyOptions,
    build_network,
    solve,
)
from ambush_planner.core.corridors import make_corridors
from ambush_planner.core.driven_path import driven_path

SIDE, SPACING, REACH, TUBE, SECURED = 100.0, 6.0, 6.0, 2.0, 12.0
DRAWS = 5000


def hills():
    """Risk that rises and falls, and two blocks in the way."""
    v, u = np.mgrid[0:50, 0:50] / 50
    alpha = 2.0 + np.sin(7 * u + 3 * v) + np.cos(5 * v - 2 * u)
    obstacles = ((np.abs(u - 0.4) < 0.08) & (np.abs(v - 0.6) < 0.15)) | (
        (np.abs(u - 0.7) < 0.1) & (np.abs(v - 0.3) < 0.1))
    return alpha, obstacles


def strewn():
    """Even ground with rocks on it."""
    rng = np.random.default_rng(4)
    obstacles = rng.random((50, 50)) < 0.03
    obstacles[23:27, :4] = obstacles[23:27, -4:] = False
    return np.ones((50, 50)), obstacles


def gates():
    """A wall with three gates, the middle one cheap to watch."""
    alpha, obstacles = np.full((50, 50), 2.0), np.zeros((50, 50), bool)
    obstacles[:, 24:26] = True
    for low, loss in ((5, 3.0), (22, 1.0), (38, 2.0)):
        obstacles[low : low + 8, 24:26] = False
        alpha[low : low + 8, 20:30] = loss
    return alpha, obstacles


@pytest.mark.slow
@pytest.mark.parametrize("ground", [hills, strewn, gates])
def test_no_place_is_hit_more_often_than_the_value_says(ground):
    alpha, obstacles = ground()
    risk_map = RiskMap(alpha, obstacles, SIDE / 50)
    ends = (3.0, 50.0), (97.0, 50.0)
    network = build_network(risk_map, *ends, NetworkOptions(spacing=SPACING))
    game = GameOptions(ambush_radius=REACH + TUBE, secured_radius=SECURED)
    strategy = solve(network, game, StrategyOptions(max_detour=1.3))
    corridors = make_corridors(network, risk_map, tube=TUBE)
    rng = np.random.default_rng(1)
    hits = np.zeros(len(network.points))
    for _ in range(DRAWS):
        poses = driven_path(corridors, strategy.sample_route(rng), 0.5)
        near, _ = cKDTree(poses[:, :2]).query(network.points, distance_upper_bound=REACH + 1.0)
        hits += near <= REACH
    apart = np.stack([np.hypot(*(network.points - end).T) for end in ends]).min(axis=0)
    share = hits[apart > SECURED] / DRAWS
    loss = network.alpha[apart > SECURED]
    error = np.sqrt(share * (1 - share) / DRAWS)
    assert (loss * (share - 4 * error)).max() <= strategy.value
    # And the value is not far above: the test could fail.
    assert (loss * share).max() > 0.5 * strategy.value
