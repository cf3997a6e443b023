# SPDX-License-Identifier: Apache-2.0
"""Graded networks, passes, lengths over the ground, and rounds of refinement."""

import numpy as np
import pytest
from games import examples, least_weight
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from ambush_planner import (
    GameOptions,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    plan_trip,
)
from ambush_planner.game.budget import length_budget, shortest_length
from ambush_planner.game.game import make_game
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.network.construction import build_trip_graph
from ambush_planner.network.grading import RING
from ambush_planner.network.passages import pass_nodes
from ambush_planner.network.shortest_way import LATTICE_RATIO, taut_length
from ambush_planner.planning.options import grading
from ambush_planner.planning.solving import WarmStart
from ambush_planner.planning.trip import Trip

START, GOAL = (4.0, 20.0), (56.0, 20.0)
NONE = np.empty((0, 3))


def yard(alpha=1.0, walls=(), resolution=1.0):
    """A yard of 60 m x 40 m; walls are (x, first y, last y) [m], one cell thick."""
    obstacles = np.zeros((int(40 / resolution), int(60 / resolution)), dtype=bool)
    for walled in walls:
        column, first, last = (int(each / resolution) for each in walled)
        obstacles[first:last, column] = True
    losses = np.broadcast_to(np.asarray(alpha, dtype=float), obstacles.shape)
    return RiskMap(np.where(obstacles, 0.0, losses), obstacles, resolution)


def sloping(*walls):
    """A yard of coarse cells, four times as dangerous in the north as in the south."""
    return yard(np.linspace(1.0, 4.0, 20)[:, None], walls, 2.0)


def planning(refine, reach=4.0, spacing=5.0, **strategy):
    return PlanningOptions(network=NetworkOptions(refine=refine, spacing=spacing),
                           game=GameOptions(ambush_radius=reach),
                           strategy=StrategyOptions(**strategy))


def network_of(risk_map, options, refined=NONE):
    return Trip(risk_map, START, GOAL, (), options).networks(refined)[0]


def test_the_network_is_fine_around_the_secured_area_and_refined_places():
    options = planning(1)
    refined = np.array([[30.0, 30.0, 0.8]])
    network = network_of(yard(), options, refined)
    apart = cKDTree(network.points).query(network.points, 2)[0][:, 1]
    fine = grading(yard(), options, refined)
    for centre, radius, most in ((START, fine.rim, 1.4), ((30.0, 30.0), RING * fine.radius, 1.6)):
        there = np.abs(np.hypot(*(network.points - centre).T) - radius) < 1.5
        assert there.sum() > 4 and np.median(apart[there]) < most
    middle = (np.abs(network.points - (30.0, 10.0)) < 6.0).all(axis=1)
    assert np.median(apart[middle]) > 2.0
    assert np.array_equal(network.refined, refined)
    assert np.array_equal(network.points, network_of(yard(), options, refined).points)


@pytest.mark.parametrize('options', [planning(0), planning(1, reach=0.0), PlanningOptions(
    network=NetworkOptions(method='lattice_delaunay', spacing=5.0, refine=1),
    game=GameOptions(ambush_radius=4.0))])
def test_without_a_reach_and_for_the_papers_methods_networks_are_plain(options):
    network = network_of(yard(), options)
    assert len(network.points) <= 12 * 8 and network.ground_length is None


def test_a_pass_of_one_cell_is_in_the_network():
    """Two ways through a wall: a wide one, and one of a cell that a lattice of 5 m would miss."""
    walls = [(30, 0, 18), (30, 19, 25)]
    risk_map, options = yard(1.0, walls), planning(1)
    graph = build_trip_graph(risk_map, START, GOAL, options.network, (),
                             grading(risk_map, options, NONE))
    inside = (np.abs(graph.points - (30.5, 18.5)) < 0.5).all(axis=1)
    beyond = graph.points[graph.edges[inside[graph.edges[:, 0]], 1], 0]
    assert inside.any() and beyond.min() < 30.0 and beyond.max() > 31.0


def test_the_first_network_has_the_pass_on_its_way_and_the_budget_of_those_that_follow():
    """A lattice of 5 m misses the gap in the middle; the way around is longer by a sixth."""
    risk_map, options = yard(1.0, [(30, 0, 19), (30, 20, 34)]), planning(1)
    first = Trip(risk_map, START, GOAL, (), options).networks(None)[0]
    later, plain = network_of(risk_map, options), network_of(risk_map, planning(0))
    assert first.refined is None
    assert first.ground_length == pytest.approx(later.ground_length, rel=1e-3)
    assert shortest_length(first) < 1.05 * first.ground_length < shortest_length(plain)
    assert len(plain.points) < len(first.points) < len(later.points)
    plan = plan_trip(risk_map, START, GOAL, planning(1, max_detour=1.1))
    budgets = [length_budget(make_game(each, GameOptions()), 1.1).limit for each in (first, later)]
    assert budgets[0] == pytest.approx(budgets[1], rel=1e-3)
    assert plan.strategy.expected_length <= budgets[1] * (1.0 + 1e-6)


@examples(20)
@given(st.integers(0, 10**6), st.sampled_from((0.05, 0.2, 0.35)), st.sampled_from((0.0, 0.4)))
def test_nodes_of_passes_are_clear_and_narrow(seed, share, clearance):
    rng = np.random.default_rng(seed)
    obstacles = rng.random((20, 30)) < share
    risk_map = RiskMap(np.where(obstacles, 0.0, 1.0), obstacles, 1.0)
    field = ObstacleField(risk_map)
    nodes = pass_nodes(risk_map, field, clearance, lambda uv: np.full(len(uv), 3.0))
    assert field.clear_points(nodes, clearance).all()
    assert len(nodes) == len(np.unique(nodes, axis=0))


def test_the_taut_length_is_that_of_a_string():
    """Around the end of one wall: by hand, two straight pieces over its corner."""
    risk_map = yard(1.0, [(30, 0, 30)])
    field, corners = ObstacleField(risk_map), np.array([(30.0, 30.0), (31.0, 30.0)])
    hand = (np.hypot(*(corners[0] - START)) + 1.0 + np.hypot(*(corners[1] - GOAL)))
    for spacing in (2.0, 3.0, 5.0):
        network = network_of(risk_map, planning(1, spacing=spacing))
        assert network.ground_length == pytest.approx(LATTICE_RATIO * hand, rel=4e-3)
    way = np.array([START, (30.5, 39.0), GOAL])
    assert taut_length(field, way, 0.0) == pytest.approx(hand, rel=4e-3)


def test_the_budget_is_the_same_in_all_rounds_and_never_below_the_shortest_route():
    risk_map = sloping((30, 0, 16), (30, 22, 34))
    plan = plan_trip(risk_map, START, GOAL, planning(2, max_detour=1.1))
    again = plan_trip(risk_map, START, GOAL, planning(1, max_detour=1.1))
    assert plan.strategy.length_budget == pytest.approx(again.strategy.length_budget, rel=1e-3)
    assert plan.strategy.expected_length <= plan.strategy.length_budget * (1.0 + 1e-6)
    tight = plan_trip(risk_map, START, GOAL, planning(0, max_detour=1.0)).strategy
    shortest = least_weight(tight.network, tight.network.lengths)
    assert tight.length_budget >= shortest * (1.0 - 1e-9)


def test_refinement_lowers_the_value_and_keeps_the_best_round():
    risk_map = sloping((30, 0, 14), (30, 26, 36))
    plain, seen = plan_trip(risk_map, START, GOAL, planning(0)), []
    plan = plan_trip(risk_map, START, GOAL, planning(2), progress=lambda *each: seen.append(each))
    assert 1 <= len(plan.refinement) <= 3 and plan.refinement[0].nodes > 0
    least = min(each.value for each in plan.refinement)
    assert plan.value < 1.02 * least < plain.value
    assert seen


def test_no_round_repeats_a_network():
    plan = plan_trip(sloping((30, 0, 14), (30, 26, 36)), START, GOAL, planning(6))
    nodes = [each.nodes for each in plan.refinement[1:]]
    assert 1 < len(nodes) == len(set(nodes))


def test_a_later_plan_keeps_the_refined_places():
    risk_map = sloping((30, 0, 14), (30, 26, 36))
    refined = np.array([[30.0, 20.0, 0.8]])
    options = planning(1, 8.0, 8.0)
    first = plan_trip(risk_map, START, GOAL, planning(0, 8.0, 8.0))
    warm = WarmStart.of(first.trip, refined)
    later = plan_trip(risk_map, (5.0, 20.0), GOAL, options, warm=warm)
    assert (later.network.refined == refined[0]).all(axis=1).any()
