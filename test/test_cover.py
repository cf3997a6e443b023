"""Hiding places in obstacles: which cells, their losses, and what they do to a plan."""

from __future__ import annotations

import numpy as np
import pytest

from ambush_planner import GameOptions, NetworkOptions, RiskMap, StrategyOptions, build_network
from ambush_planner.core.cover import with_hiding_places
from ambush_planner.core.planner import DriveOptions, PlanningOptions, plan

START, GOAL = (0.5, 10.0), (39.5, 10.0)


def walled_map(hidden=5.0) -> RiskMap:
    """Ground of loss 1, 20 m x 40 m, with a strip of obstacles, and of loss 9 along its side."""
    alpha, obstacles = np.ones((20, 40)), np.zeros((20, 40), bool)
    obstacles[8:12, 15:25] = True
    alpha[8:12, 15:25] = hidden
    alpha[7, 15:25] = 9.0
    return RiskMap(alpha, obstacles, 1.0, (0.0, 0.0, 0.0))


def test_cells_have_the_loss_of_the_nearest_free_cell():
    risk_map = walled_map(np.nan)
    network = build_network(risk_map, START, GOAL, NetworkOptions(spacing=2.0))
    covered = with_hiding_places(network, risk_map, 3.0, 2.0)
    cells = risk_map.cells(covered.cover_points)
    assert risk_map.obstacles[cells].all() and len(covered.cover_points) == 40
    free = np.argwhere(~risk_map.obstacles) + 0.5
    for (x, y), loss in zip(covered.cover_points, covered.cover_alpha, strict=True):
        apart = np.hypot(*(free - (y, x)).T)
        nearest = free[np.isclose(apart, apart.min())].astype(int)
        assert loss in risk_map.alpha[tuple(nearest.T)]
    assert np.array_equal(covered.edges, network.edges)


def test_cells_out_of_reach_and_more_than_a_few_a_spacing_are_left_out():
    risk_map = walled_map()
    network = build_network(risk_map, START, GOAL, NetworkOptions(spacing=4.0))
    assert len(with_hiding_places(network, risk_map, 3.0, 4.0).cover_points) == 12
    solid = RiskMap(np.ones((40, 40)), np.mgrid[:40, :40][0] > 20, 1.0)
    few = with_hiding_places(
        build_network(solid, START, GOAL, NetworkOptions(spacing=2.0)), solid, 3.0, 2.0)
    assert 21 < few.cover_points[:, 1].max() < 27


@pytest.mark.parametrize("hides", [False, True])
def test_a_plan_knows_of_them_when_asked(hides):
    options = PlanningOptions(
        NetworkOptions(spacing=2.0),
        GameOptions(ambush_radius=3.0, secured_radius=6.0, ambush_in_obstacles=hides),
        StrategyOptions(),
        DriveOptions(tube=0.0),
    )
    made = plan(walled_map(), START, GOAL, options)
    sites = made.strategy.game.sites
    inside = walled_map().obstacles[walled_map().cells(made.network.points[sites])]
    assert inside.any() == hides
