# SPDX-License-Identifier: Apache-2.0
"""A strategy assessed on changed ground: against frequencies, exact geometry and new games."""

from functools import cache

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner.game.game import GameOptions
from ambush_planner.game.solver import solve
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.occupancy import OccupancyMap, OccupancyOptions, risk_from_occupancy
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.network.network import Network
from ambush_planner.planning.changed_ground import Assessment, ChangedGround
from ambush_planner.planning.clear_ground import ClearGround
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.trip import plan_trip

SIZE, RESOLUTION, ORIGIN = 24, 0.5, (3.0, -2.0, 0.0)
OCCUPANCY = OccupancyOptions()
START, GOAL = (1.25, 6.25), (10.75, 6.25)  # in map axes
STOP = (5.25, 9.25)
ROUNDING = 1e-12  # of sums of probabilities


def grid(values, origin=ORIGIN):
    return OccupancyMap(values, RESOLUTION, origin)


def planned(values, clearance=0.0, game=None, origin=ORIGIN, spacing=1.0, stops=()):
    """A plan, its map, and the plan on other maps."""
    risk_map = risk_from_occupancy(values, RESOLUTION, origin, OCCUPANCY)
    game = game or GameOptions()
    options = PlanningOptions(network=NetworkOptions(spacing=spacing, clearance=clearance),
                              game=game)
    start, goal, *stops = risk_map.to_world([START, GOAL, *stops])
    made = plan_trip(risk_map, start, goal, options, stops=stops)
    on = grid(values, origin)
    return made, on, ChangedGround(made, on, OCCUPANCY)


def rough(seed):
    values = np.random.default_rng(seed).integers(0, 60, (SIZE, SIZE), dtype=np.int8)
    values[9:14, 10:13] = 100
    return values


@cache
def rough_plan(clearance, stops=()):
    return planned(rough(1), clearance, stops=stops)


def changed(values, cells, new):
    result = values.copy()
    result[tuple(np.array(cells).reshape(-1, 2).T)] = new
    return result


@pytest.mark.parametrize(('yaw', 'spacing', 'stops'), [
    (0.0, 0.7, ()), (0.3, 1.0, ()), (2.0, 1.0, ()), (0.3, 1.0, (STOP,))])
def test_on_its_own_map_a_strategy_has_its_own_value(yaw, spacing, stops):
    """Even if nodes lie on the borders of cells and the map is rotated."""
    made, on, ground = planned(rough(1), origin=(3.0, -2.0, yaw), spacing=spacing, stops=stops)
    trip = made.trip
    assessed = ground.assess(on)
    assert assessed == Assessment(trip.value, trip.lower_bound, 1.0, assessed.expected_length,
                                  assessed.length_budget)
    assert assessed.expected_length == pytest.approx(trip.expected_length)
    assert assessed.length_budget == pytest.approx(sum(leg.length_budget for leg in made.legs))
    assert not ground.assess(on).is_over_budget
    again = ground.assess(grid(on.values.copy(), on.origin))
    assert again.value == pytest.approx(made.value, rel=1e-12)
    assert again.lower_bound == pytest.approx(made.lower_bound, rel=1e-9)


cells = st.lists(st.tuples(*[st.integers(0, SIZE - 1)] * 2), min_size=1, max_size=30)


@examples(30)
@given(st.sampled_from((0.0, 0.4)), cells)
def test_a_strategy_is_blocked_if_an_edge_meets_a_new_obstacle(clearance, where):
    """Against the exact test on the whole map: no miss, and false alarms only within a cell."""
    made, on, ground = rough_plan(clearance)
    values = changed(on.values, where, 100)
    network, p = made.network, made.strategy.edge_probability
    risk_map = risk_from_occupancy(values, RESOLUTION, ORIGIN, OCCUPANCY)
    ends = risk_map.to_map_axes(network.points[network.edges[p > 1e-12]])
    field = ObstacleField(risk_map)
    blocked = ground.assess(grid(values)).clear_share < 1.0
    assert blocked or field.clear_segments(ends[:, 0], ends[:, 1], clearance).all()
    if blocked:
        wide = clearance + 0.5 * RESOLUTION
        assert not field.clear_segments(ends[:, 0], ends[:, 1], wide).all()


@examples(6)
@given(cells, st.integers(0, 99))
def test_value_and_bound_are_those_of_the_game_on_the_new_map(where, value):
    made, on, ground = rough_plan(0.0)
    values = changed(on.values, where, value)
    assessment = ground.assess(grid(values))
    network, strategy = made.network, made.strategy
    risk_map = risk_from_occupancy(values, RESOLUTION, ORIGIN, OCCUPANCY)
    rows, columns = risk_map.cells(risk_map.to_map_axes(network.points))
    alpha = risk_map.alpha[rows, columns]
    alpha[[network.source, network.target]] = 0.0
    hits = alpha * (strategy.visit_probability)
    assert assessment.value == pytest.approx(hits.max())
    assert assessment.lower_bound <= assessment.value
    assert assessment.clear_share == pytest.approx(1.0, abs=ROUNDING)
    again = Network(network.points, alpha, network.edges, network.source, network.target)
    assert solve(again).value >= assessment.lower_bound - 1e-9


def test_maps_one_after_the_other_are_assessed_as_each_alone():
    """What is kept from map to map changes nothing."""
    values, game = rough(1), GameOptions(ambush_radius=1.5)
    made, on, ground = planned(values, game=game)
    assert ground.assess(on).value == pytest.approx(made.value)
    for k in range(2):
        newest = grid(changed(values, [(5 + 2 * k, 4 + 2 * k), (20 - k, 12)], (100, 70)[k % 2]))
        alone = ChangedGround(made, on, OCCUPANCY).assess(newest)
        ground.forget_all_but(newest)
        assert ground.assess(newest) == alone
    assert ground.assess(on).value == pytest.approx(made.value)


def test_the_clear_routes_can_exceed_the_length_budget():
    """A wall across the middle leaves only routes that go around it."""
    made, on, ground = rough_plan(0.0)
    values = on.values.copy()
    values[6:17, 11] = 100
    assessment = ground.assess(grid(values))
    assert 0.0 < assessment.clear_share < 1.0 and assessment.is_over_budget
    assert assessment.length_budget == made.strategy.length_budget
    assert assessment.expected_length > 1.01 * assessment.length_budget
    values[:, 11] = 100
    closed = ground.assess(grid(values))
    assert closed.expected_length == np.inf and not closed.is_over_budget


def test_higher_losses_make_a_strategy_stale_by_the_rise_of_its_value():
    made, on, ground = rough_plan(0.0)
    dear = np.where(on.values == 100, 100, np.minimum(on.values + 30, 99)).astype(np.int8)
    assessment = ground.assess(grid(dear))
    rise = assessment.value / made.strategy.value - 1.0
    assert rise > 0.1
    assert assessment.is_stale(made.strategy.value, 0.99 * rise)
    assert not assessment.is_stale(made.strategy.value, 1.01 * rise)
    assert assessment.clear_share == pytest.approx(1.0, abs=ROUNDING)


RISK, CLEARANCE = OccupancyOptions(obstacle_threshold=99), NetworkOptions(clearance=0.3)


@examples(20)
@given(seed=st.integers(0, 10**6), clearance=st.sampled_from([0.0, 0.3]))
def test_a_paths_steps_are_clear_as_on_the_whole_map(seed, clearance):
    """Read in pieces, the map gives the same answers as an obstacle field of all of it."""
    rng = np.random.default_rng(seed)
    grid = OccupancyMap(np.where(rng.random((30, 60)) < 0.03, 100, 10).astype(np.int8), 0.2)
    points = rng.uniform((-0.2, -0.2), (12.2, 6.2), (1, 2)) + np.cumsum(
        rng.normal(0.0, 0.06, (120, 2)), axis=0)
    risk_map = risk_from_occupancy(grid.values, 0.2, options=RISK)
    wanted = ObstacleField(risk_map).clear_segments(points[:-1], points[1:], clearance)
    wanted &= risk_map.contains(points[:-1]) & risk_map.contains(points[1:])
    found = ClearGround(grid, RISK, NetworkOptions(clearance=clearance)).steps(points)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(('y', 'box', 'clear'), [
    (1.15, 99, True), (1.15, 5.0, False), (1.15, 1.8, False),
    (0.95, 99, True),  # strayed to within the clearance of the wall
    (0.6, 99, True),  # in the wall itself
    (0.6, 1.8, False), (0.0001, 99, False),  # more than a metre of wall
])
def test_a_robot_beside_its_path_may_come_back_to_it(y, box, clear):
    """The path keeps 0.35 m from a wall whose upper end is at 0.8 m."""
    values = np.zeros((20, 40), np.int8)
    values[:4] = 99
    if box < 8.0:
        values[5:7, int(box / 0.2)] = 100
    points = np.array([(1.0, y), *((x, 1.15) for x in np.arange(1.2, 7.0, 0.2))])
    if y < 0.5:
        points[1:-1, 1] = 0.5
    ground = ClearGround(OccupancyMap(values, 0.2), RISK, CLEARANCE)
    assert ground.drivable_steps(points).all() == clear
    assert len(ground.drivable_steps(points[:1])) == 0


@pytest.mark.parametrize(('x', 'y', 'out'), [
    (4.0, 2.0, None),  # clear
    (1.0, 2.1, 1.7),  # the nearest cell of which the whole clearance is free
    (0.2, 2.1, None),  # too far
    (1.0, 3.1, None),  # behind lethal cells
    (1.0, 2.9, (1.7, 2.5)),  # past their lower end: the nearest is not straight ahead
    (-1.0, 2.1, None),  # off the map
])
def test_the_way_out_of_an_inflation_is_short_and_straight(x, y, out):
    values = np.zeros((20, 40), np.int8)
    values[:, :7] = 99  # up to 1.4 m
    values[14:17, 6] = 100
    ground = ClearGround(OccupancyMap(values, 0.2), RISK, NetworkOptions(clearance=0.15))
    assert ground.way_out((x, y)) == ((x, y) if out is None else pytest.approx(
        out if isinstance(out, tuple) else (out, y)))


@pytest.mark.parametrize(('start', 'goal', 'there'), [
    ((1.0, 1.0), (1.0, 1.0), True), ((1.0, 1.0), (1.1, 1.15), True),
    ((1.0, 1.0), (1.3, 1.0), False), ((0.1, 1.0), (0.1, 1.0), False),
])
def test_a_convoy_has_arrived_within_a_cell_of_a_clear_goal(start, goal, there):
    values = np.zeros((20, 40), np.int8)
    values[:, 0] = 100
    ground = ClearGround(OccupancyMap(values, 0.2), RISK, NetworkOptions())
    assert ground.has_arrived(start, goal) == there
