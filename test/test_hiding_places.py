# SPDX-License-Identifier: Apache-2.0
"""Hiding places in obstacles: their cells and losses, and their effect on a plan."""

from dataclasses import replace

import numpy as np

from ambush_planner import GameOptions, NetworkOptions, RiskMap, build_network
from ambush_planner.network.construction import build_trip_graph
from ambush_planner.network.hiding_places import hiding_places
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.solving import add_hiding_places

START, GOAL = (0.5, 10.0), (39.5, 10.0)


def walled_map(hidden=5.0) -> RiskMap:
    """Ground of loss 1, 20 m x 40 m, with a strip of obstacles, and of loss 9 along its side."""
    alpha, obstacles = np.ones((20, 40)), np.zeros((20, 40), bool)
    obstacles[8:12, 15:25] = True
    alpha[8:12, 15:25] = hidden
    alpha[7, 15:25] = 9.0
    return RiskMap(alpha, obstacles, 1.0, (0.0, 0.0, 0.0))


def test_hiding_places_have_the_loss_of_the_nearest_free_cell():
    risk_map = walled_map(np.nan)
    network = build_network(risk_map, START, GOAL, NetworkOptions(spacing=2.0))
    places, losses = hiding_places([network], risk_map, 3.0, 2.0)
    assert risk_map.obstacles[risk_map.cells(places)].all() and len(places) == 40
    free = np.argwhere(~risk_map.obstacles) + 0.5
    for (x, y), loss in zip(places, losses, strict=True):
        apart = np.hypot(*(free - (y, x)).T)
        nearest = free[np.isclose(apart, apart.min())].astype(int)
        assert loss in risk_map.alpha[tuple(nearest.T)]


def test_omits_cells_out_of_reach_and_thins_the_others():
    risk_map = walled_map()
    network = build_network(risk_map, START, GOAL, NetworkOptions(spacing=4.0))
    assert len(hiding_places([network], risk_map, 3.0, 4.0)[0]) == 12
    solid = RiskMap(np.ones((40, 40)), np.mgrid[:40, :40][0] > 20, 1.0)
    network = build_network(solid, START, GOAL, NetworkOptions(spacing=2.0))
    places, _ = hiding_places([network], solid, 3.0, 2.0)
    assert 21 < places[:, 1].max() < 27


def test_all_legs_of_a_trip_have_the_same_hiding_places_as_nodes_without_edges():
    risk_map, options = walled_map(), PlanningOptions()
    legs = build_trip_graph(risk_map, START, GOAL, NetworkOptions(spacing=2.0),
                            [(20.0, 15.0)]).networks()
    game = GameOptions(ambush_in_obstacles=True)
    assert add_hiding_places(legs, risk_map, options, game) == list(legs)
    covered = add_hiding_places(legs, risk_map, options, replace(game, ambush_radius=3.0))
    added = np.arange(len(legs[0].points), len(covered[0].points))
    assert len(added) > 10
    for leg, own in zip(legs, covered, strict=True):
        assert np.array_equal(own.points, covered[0].points)
        assert np.array_equal(own.edges, leg.edges) and not np.isin(own.edges, added).any()
