# SPDX-License-Identifier: Apache-2.0
"""Trips in a random order: a game solved by hand, all routes of all orders, laws."""

import math
from itertools import permutations

import numpy as np
import pytest
from games import examples, least_weight, plain_options, routes_of, value_by_routes
from hypothesis import assume, given
from hypothesis import strategies as st
from test_trip import FREE, GOAL, OPTIONS, START, STOPS, drawn_trips, roads_of, there_and_back
from test_trip import check_laws as check_laws_of_one_order

from ambush_planner import (
    GameOptions,
    InvalidNetwork,
    InvalidOption,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    plan_trip,
    solve,
)
from ambush_planner.game.game import make_game
from ambush_planner.network.trip_graph import TripGraph
from ambush_planner.planning.few_routes import few_routes
from ambush_planner.planning.plan import departure_path
from ambush_planner.planning.trip_under_way import Destination, trip_on


def two_doors():
    """A site before each of two stops; roads between them, of 2 m, and from each to the goal."""
    points = np.array([(-1, 1), (-1, -1), (-1, 0), (0, 1), (0, -1), (1, 0)], float)
    pairs = np.array([(2, 0), (2, 1), (0, 3), (1, 4), (3, 4), (3, 5), (4, 5)])
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    return TripGraph(points, np.array([1, 1, 0, 0, 0, 0], float), edges, (2, 3, 4, 5))


def test_a_coin_decides_which_stop_is_first():
    roads, options = two_doors(), StrategyOptions(max_detour=1.1, risk_slack=0.0)
    coin = solve(roads.network_in_any_order(), options=options)
    assert coin.value == pytest.approx(0.5, rel=1e-4)
    # In one order the budget lets few routes pass the second stop first, 2 m more and back again.
    one = solve(roads.network(roads.visits), options=options)
    assert one.value == pytest.approx(1.0 - 0.1 * (4.0 + math.sqrt(2.0)) / 2.0, rel=1e-4)


def test_with_one_stop_there_is_one_order():
    roads = there_and_back(1.0, 3.0)
    network, one = roads.network_in_any_order(), roads.network(roads.visits)
    assert np.array_equal(network.edges, one.edges) and np.array_equal(network.leg, one.leg)
    assert solve(network, options=FREE).value == pytest.approx(0.75, rel=0.011)


def all_orders(roads, options):
    """The networks of all orders, and their games' hits (places, M) and losses (places,)."""
    source, *stops, target = roads.visits
    for order in permutations(stops):
        network = roads.network((source, *order, target))
        game = make_game(network, options)
        loss = np.zeros(network.place_count)
        hits, at = np.zeros((len(loss), len(network.edges))), network.places[game.sites]
        hits[at], loss[at] = game.entering.toarray(), game.loss[game.sites]
        yield network, hits, loss


@examples(12)
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.0, 1.0, 2.5]),
       detour=st.sampled_from([1.05, 1.3, math.inf]))
def test_bound_and_value_enclose_that_of_all_routes_of_all_orders(seed, reach, detour):
    roads, options = roads_of(seed, 2, 2), GameOptions(
        ambush_radius=reach, secured_radius=0.5)
    network = roads.network_in_any_order()
    strategy = solve(network, options, StrategyOptions(max_detour=detour, risk_slack=0.001))
    check_laws(strategy, roads.visits)
    routes, hits, lengths, losses = [], [], [], []
    for one, entering, loss in all_orders(roads, options):
        routes += [[sum(map(len, lengths)) + edge for edge in route] for route in routes_of(one)]
        assume(len(routes) < 50_000)
        hits.append(entering)
        lengths.append(one.lengths)
        losses.append(loss)
    limits = [(np.concatenate(lengths), strategy.length_budget * (1.0 + 1e-12))]
    least = value_by_routes(np.max(losses, axis=0), np.hstack(hits), routes, limits)
    assert strategy.lower_bound <= least * (1.0 + 1e-6) + 1e-9
    assert least * (1.0 - 1e-6) - 1e-9 <= strategy.value
    if strategy.reason != 'stalled':
        assert strategy.value <= least * 1.00101 + 1e-9


def check_laws(strategy, visits):
    """Each stop is visited once, in some order, and not passed before."""
    network = strategy.network
    assert network.places[network.stops].tolist() == list(visits[1:-1])
    for place, at, _ in drawn_trips(strategy, visits):
        for stop, first in zip(place[at], at, strict=True):
            assert stop not in place[:first]


@examples(6)
@given(seed=st.integers(0, 10**6), stops=st.integers(2, 3), reach=st.sampled_from([0.0, 0.7]),
       detour=st.sampled_from([1.1, 1.5, math.inf]))
def test_laws_of_any_order(seed, stops, reach, detour):
    roads, options = roads_of(seed, stops), GameOptions(ambush_radius=reach)
    strategy = solve(roads.network_in_any_order(), options,
                     StrategyOptions(max_detour=detour, risk_slack=0.001))
    check_laws(strategy, roads.visits)
    assert strategy.lower_bound <= strategy.value
    one = solve(roads.network(roads.visits), options, StrategyOptions(
        max_detour=max(1.0, strategy.length_budget / shortest(roads)), risk_slack=0.001))
    check_laws_of_one_order(one, roads.visits)
    assert strategy.lower_bound <= one.value
    assert one.reason == 'stalled' or one.value <= one.lower_bound * (1.0 + 0.00101)


def shortest(roads):
    network = roads.network(roads.visits)
    return least_weight(network, network.lengths)


@pytest.fixture(scope='module')
def risk_map():
    """Even ground, on which no stop comes first for a reason."""
    return RiskMap(np.ones((30, 30)), np.zeros((30, 30), bool), 10.0)


GAME = PlanningOptions(network=plain_options(spacing=45.0),
                       game=GameOptions(ambush_radius=25.0, secured_radius=40.0))
CORNERS = ((150.0, 270.0), (150.0, 30.0))


@pytest.fixture(scope='module')
def plan(risk_map):
    return plan_trip(risk_map, (15.0, 150.0), (285.0, 150.0), GAME, stops=CORNERS, order='random')


def test_the_value_is_at_most_that_of_the_best_order(risk_map, plan):
    best = plan_trip(risk_map, (15.0, 150.0), (285.0, 150.0), GAME, stops=CORNERS, order='best')
    assert plan.order_found == 'random' and plan.stops_xy == CORNERS
    assert plan.value < 0.95 * best.value
    assert plan.strategy.length_budget == pytest.approx(best.strategy.length_budget)


def test_orders_are_drawn_as_often_as_published(plan):
    network, p, n = plan.network, plan.strategy.edge_probability, 4000
    routes = plan.strategy.sample_routes(n, np.random.default_rng(1))
    drawn = np.mean([network.visited(route)[1][0] for route in routes])
    second = network.places[network.heads] == network.places[network.stops[1]]
    first_leg = network.leg[network.tails] == 0
    share = p[first_leg & second].sum()
    assert 0.3 < share < 0.7
    assert abs(drawn - share) < 4.0 * math.sqrt(share * (1.0 - share) / n)


def test_the_trip_under_way_knows_the_order_of_its_route(plan):
    orders = set()
    for seed in range(12):
        route = plan.strategy.sample_route(np.random.default_rng(seed))
        path = departure_path(plan, route, 5.0)
        at = [int(np.flatnonzero((path[:, :2] == stop).all(axis=1))[0]) for stop in CORNERS]
        trip = trip_on(plan, route, path, Destination(('map', 'robot'), plan.goal_xy, 1.0, CORNERS))
        assert trip.visits.tolist() == np.argsort(at).tolist()
        orders.add(tuple(trip.visits.tolist()))
        left = CORNERS[trip.visits[1]]  # the other stop has been passed
        half = tuple(path[(at[trip.visits[0]] + at[trip.visits[1]]) // 2, :2])
        assert trip.continues(Destination(('map', 'robot'), plan.goal_xy, 1.0, (left,)), half, 0.0)
    assert len(orders) == 2


def test_few_routes_in_both_orders(risk_map, plan):
    few = few_routes(plan, 6, False, np.random.default_rng(1))
    visits = [[int(np.hypot(*(path[:, :2] - stop).T).argmin()) for stop in CORNERS]
              for path in few.paths]
    assert len({first < second for first, second in visits}) == 2
    assert few.value < 0.65  # in the best order, 2/3


@pytest.mark.parametrize(('stops', 'options', 'error', 'words'), [
    ([*STOPS, (100.0, 100.0), (50.0, 50.0)], OPTIONS, InvalidOption, 'at most 4 stops, got 5'),
    ([STOPS[0], STOPS[1], STOPS[0]], OPTIONS, InvalidNetwork, 'position of another'),
    ([STOPS[0], START, STOPS[1]], OPTIONS, InvalidNetwork, 'position of another'),
])
def test_what_has_no_random_order_is_refused(risk_map, stops, options, error, words):
    with pytest.raises(error, match=words):
        plan_trip(risk_map, START, GOAL, options, stops=stops, order='random')
