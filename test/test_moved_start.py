# SPDX-License-Identifier: Apache-2.0
"""A convoy that has moved on: distribution and value of the joined routes, by enumeration."""

import math
from itertools import pairwise

import numpy as np
import pytest
from games import drawn_routes, ends_of, examples, hit_once, meets, plain_options
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner.game.game import GameOptions
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.occupancy import OccupancyMap, OccupancyOptions, risk_from_occupancy
from ambush_planner.planning.changed_ground import ChangedGround
from ambush_planner.planning.clear_ground import ClearGround
from ambush_planner.planning.moved_start import (
    REGION,
    joined_plan,
    other_rest,
    rest_strategy,
    whole_route,
)
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.plan import departure_path, draw_routes
from ambush_planner.planning.trip import plan_trip
from ambush_planner.planning.trip_under_way import Destination, trip_on

START, GOAL = (1.0, 3.0), (9.0, 3.0)


def ground_on(values, radius=0.0, stops=(), spacing=1.1, **strategy):
    """A plan across a map of 10 m x 6 m, in which -1 and 100 are obstacles."""
    grid = OccupancyMap(values, 0.25)
    options = PlanningOptions(network=plain_options(spacing=spacing),
                              game=GameOptions(ambush_radius=radius),
                              strategy=StrategyOptions(**strategy))
    plan = plan_trip(risk_from_occupancy(values, 0.25), START, GOAL, options, stops=stops)
    return ChangedGround(plan, grid, OccupancyOptions()), grid


def all_routes(strategy):
    """Each route as its nodes, with its probability."""
    network = strategy.network
    return {(network.source, *network.heads[list(route)].tolist()): chance
            for route, chance in drawn_routes(network, strategy.edge_probability).items()}


def onwards_by_hand(routes, node):
    """How the routes through a node go on from there, each with its conditional probability."""
    found = {}
    for route, chance in routes.items():
        if node in route:
            rest = route[route.index(node):]
            found[rest] = found.get(rest, 0.0) + chance
    total = sum(found.values())
    return {rest: chance / total for rest, chance in found.items()}


def losses_by_hand(strategy, risk_map):
    """Mean losses at the nodes, and with a reach also at the cells outside the secured area."""
    network, options, p = strategy.network, strategy.game.options, strategy.edge_probability
    if not options.reach:
        return network.alpha * np.bincount(network.heads, p, len(network.points))
    rows, columns = np.indices(risk_map.alpha.shape).reshape(2, -1)
    places = np.vstack((network.points, np.stack((columns, rows), axis=1) * 0.25 + 0.125))
    alpha = np.concatenate((network.alpha, risk_map.alpha.ravel()))
    apart = np.linalg.norm(places[:, None] - ends_of(network), axis=2)
    free = (apart > options.secured_distance).all(axis=1)
    hits = meets(network, places[free], options.reach, options.secured_distance - options.tube)
    return alpha[free] * hit_once(network, p, hits)


@examples(9)
@given(seed=st.integers(0, 2**31), angle=st.floats(0.0, 6.28), away=st.floats(0.05, 0.45),
       radius=st.sampled_from([0.0, 1.2]))
def test_distribution_and_value_are_those_of_the_joined_routes(seed, angle, away, radius):
    values = np.random.default_rng(seed).integers(0, 60, (24, 40), dtype=np.int8)
    ground, grid = ground_on(values, radius, spacing=1.9)
    network, distance = ground.plan.network, away * REGION * ground.plan.spacing
    place = (START[0] + distance * math.cos(angle), START[1] + distance * math.sin(angle))
    joined = joined_plan(ground, grid, (place, GOAL))
    if joined is None:
        assert not (0.0 < place[0] < 10.0 and 0.0 < place[1] < 6.0), 'nothing is in the way'
        return
    found = all_routes(joined.plan.strategy)
    begins = {}
    for route, chance in found.items():
        begins[route[1]] = begins.get(route[1], 0.0) + chance
    assert sum(begins.values()) == pytest.approx(1.0)
    planned = all_routes(ground.plan.strategy)
    expected = {(network.source, *rest): begins[node] * chance for node in begins
                for rest, chance in onwards_by_hand(planned, node).items()}
    assert found.keys() == expected.keys()
    assert all(found[each] == pytest.approx(expected[each], abs=1e-9) for each in found)
    risk_map, value = risk_from_occupancy(values, 0.25), joined.assessment.value
    losses = losses_by_hand(joined.plan.strategy, risk_map)
    assert value >= losses.max() * (1.0 - 1e-9)  # between centres, it may be more
    assert joined.assessment.lower_bound <= value
    mean = sum(chance * np.hypot(*np.diff(
        np.vstack((place, network.points[list(route)[1:]])), axis=0).T).sum()
        for route, chance in expected.items())
    assert joined.assessment.expected_length == pytest.approx(mean)


@pytest.mark.parametrize(('radius', 'stops'), [(0.0, ()), (1.2, ()), (1.2, ((5.0, 1.5),))])
def test_paths_begin_at_the_convoy_and_keep_clear(radius, stops):
    values = np.random.default_rng(1).integers(0, 60, (24, 40), dtype=np.int8)
    ground, grid = ground_on(values, radius, stops)
    newest = OccupancyMap(values.copy(), 0.25)
    newest.values[13:17, 10:13] = 100  # since the solve: on some of the ways to join
    field = ObstacleField(risk_from_occupancy(newest.values, 0.25))
    place, rng = (2.1, 2.6), np.random.default_rng(2)
    joined = joined_plan(ground, newest, (place, GOAL))
    for _ in range(10):
        (route,) = draw_routes(joined.plan, 1, rng)
        path = departure_path(joined.plan, route, 0.1, (place, GOAL))
        assert tuple(path[0, :2]) == place
        assert tuple(path[-1, :2]) == GOAL
        assert field.clear_segments(path[:-1, :2], path[1:, :2], 0.0).all()
        assert all(np.hypot(*(path[:, :2] - stop).T).min() < 1e-6 for stop in stops)


def test_no_clear_way():
    ground, grid = ground_on(np.full((24, 40), 20, np.int8))
    far = START[0] + 1.01 * REGION * ground.plan.spacing, START[1]
    assert joined_plan(ground, grid, (far, GOAL)) is None
    walled = OccupancyMap(grid.values.copy(), 0.25)
    walled.values[9:16, 7:10] = 100
    walled.values[10:15, 8] = 20
    assert joined_plan(ground, walled, ((2.125, 3.1), GOAL)) is None


@examples(9)
@given(seed=st.integers(0, 2**31), share=st.floats(0.1, 0.8), radius=st.sampled_from([0.0, 1.2]))
def test_another_rest_agrees_with_what_was_driven_and_is_clear(seed, share, radius):
    """Whatever comes into the way, the rest goes on along routes of the plan, clear of it."""
    rng = np.random.default_rng(seed)
    ground, grid = ground_on(rng.integers(0, 60, (24, 40), dtype=np.int8), radius, spacing=1.9)
    plan, network = ground.plan, ground.plan.network
    (route,) = draw_routes(plan, 1, rng)
    rows = departure_path(plan, route, 0.1)
    trip = trip_on(plan, route, rows, Destination(('map', 'robot'), GOAL, 0.25))
    at = int(share * len(rows))
    place = tuple(rows[at, :2].tolist())
    trip.follow(place)
    newest = OccupancyMap(grid.values.copy(), 0.25)
    column, row = np.floor(rows[min(at + 15, len(rows) - 5), :2] / 0.25).astype(int)
    newest.values[row - 1:row + 1, column - 1:column + 1] = 100
    leg, ahead = trip.nodes_ahead(place)
    found = other_rest(ground, newest, (place, GOAL), leg, ahead, [seed], 0.1)
    assume(found is not None)
    (rest,), path = found.route, found.poses
    assert rest[0] == network.source and rest[1] in ahead
    assert rest[-1] == network.target
    used = {(tail, head) for tail, head, p in zip(
        network.tails.tolist(), network.heads.tolist(), plan.strategy.edge_probability,
        strict=True) if p > 0.0}
    assert set(zip(rest[1:-1].tolist(), rest[2:].tolist(), strict=True)) <= used
    assert tuple(path[0, :2]) == place and tuple(path[-1, :2]) == GOAL
    field = ObstacleField(risk_from_occupancy(newest.values, 0.25))
    assert field.clear_segments(path[:-1, :2], path[1:, :2], 0.0).all()
    clear = ClearGround(newest, OccupancyOptions(), plan.options.network)
    assert clear.drivable_steps(path[:, :2]).all()
    assert_distribution_of_rests(ground, newest, route, (rest,))


def assert_distribution_of_rests(ground, newest, left, drawn):
    """The distribution of the whole route is that of the plan's routes, given how it began."""
    network, node = ground.plan.network, int(drawn[0][1])
    lost = {tuple(edge) for edge in network.edges[ground.compare(newest).lost].tolist()}
    expected, begin = {}, tuple(left[0][:left[0].tolist().index(node)].tolist())
    for route, chance in all_routes(ground.plan.strategy).items():
        rest = route[route.index(node):] if node in route else ()
        if rest and lost.isdisjoint(pairwise(rest)):
            expected[begin + rest] = expected.get(begin + rest, 0.0) + chance
    whole = whole_route(left, drawn)
    found = all_routes(rest_strategy(ground, newest, whole, drawn).legs[0])
    assert tuple(whole[0].tolist()) in found and found.keys() == expected.keys()
    total = sum(expected.values())
    assert all(found[each] == pytest.approx(expected[each] / total, abs=1e-9) for each in found)


def test_a_departure_that_joined_its_plan_and_was_diverted_has_a_strategy():
    """Its first step is no edge of the plan's network."""
    values, rng = np.full((24, 40), 20, np.int8), np.random.default_rng(3)
    ground, grid = ground_on(values, 1.2)
    place, known = (START[0] + 2.1, START[1] + 0.7), ground.plan.network.edges.tolist()
    joined = joined_plan(ground, grid, (place, GOAL)).plan
    left = next(nodes for nodes in (joined.strategy.sample_route(rng) for _ in range(100))
                if nodes[:2].tolist() not in known)
    rest = other_rest(ground, grid, (place, GOAL), 0, left[2:3], [3]).route
    (whole,) = whole_route((left,), rest)
    (strategy,) = rest_strategy(ground, grid, (whole,), rest).legs
    network, steps = strategy.network, set(pairwise(whole.tolist()))
    chances = zip(map(tuple, network.edges.tolist()), strategy.edge_probability, strict=True)
    assert {step for step, chance in chances if chance > 0.0} >= steps
    np.testing.assert_allclose(strategy.visit_probability[[network.source, network.target]], 1.0)
    assert strategy.sample_route(rng)[:3].tolist() == whole[:3].tolist()
