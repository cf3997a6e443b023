# SPDX-License-Identifier: Apache-2.0
"""Trips with stops: laws, a trip solved by hand, all mixtures of trips, all orders."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from games import (
    examples,
    hit_once,
    least_weight,
    neighbours,
    routes_of,
    unbalanced,
    value_by_routes,
)
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import (
    GameOptions,
    InvalidNetwork,
    InvalidOption,
    Network,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    StopBlocked,
    StrategyOptions,
    build_network,
    plan_trip,
    solve,
)
from ambush_planner.network.trip_graph import TripGraph
from ambush_planner.planning.options import DriveOptions
from ambush_planner.planning.plan import departure_path
from ambush_planner.planning.trip import trip_network
from ambush_planner.routes.corridors import make_corridors
from ambush_planner.routes.driven_path import driven_paths

# The tolerance of a certificate, and as much again.
NEAR = 2e-5
FREE = StrategyOptions(max_detour=math.inf, risk_slack=0.0)
OPTIONS = PlanningOptions(network=NetworkOptions(spacing=30.0),
                          game=GameOptions(secured_radius=20.0))
START, GOAL = (15.0, 15.0), (285.0, 150.0)
STOPS = ((45.0, 250.0), (240.0, 255.0), (255.0, 45.0))


def roads_of(seed, stops, count=14):
    """Random places, joined as Delaunay does; start, stops and goal are the last ones."""
    rng = np.random.default_rng(seed)
    points = rng.random((count + stops + 2, 2)) * 10.0
    alpha = rng.uniform(0.5, 4.0, len(points))
    alpha[count:] = 0.0
    pairs = neighbours(points)
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    return TripGraph(points, alpha, edges, tuple(range(count, count + stops + 2)))


def drawn_trips(strategy, visits):
    """The places of drawn routes, where their stops are, and which; all are visited, once each."""
    network = strategy.network
    assert unbalanced(network, strategy.edge_probability) < 1e-9
    for route in strategy.sample_routes(20, np.random.default_rng(0)):
        (at, which), place = network.visited(route), network.places[route]
        assert len(set(route.tolist())) == len(route)
        assert (place[0], place[-1]) == (visits[0], visits[-1])
        assert sorted(which) == list(range(len(visits) - 2))
        assert place[at].tolist() == [visits[1 + k] for k in which]
        yield place, at, which.tolist()


def check_laws(strategy, visits):
    """Conservation, stops in their order, one value over all legs."""
    network, p = strategy.network, strategy.edge_probability
    node = network.places * network.legs + network.leg  # nodes of a stop share its visits
    visited = np.bincount(node, strategy.visit_probability)
    assert np.allclose(visited[node[network.stops]], 1.0)
    assert all(which == sorted(which) for _, _, which in drawn_trips(strategy, visits))
    if strategy.game.reach == 0.0:
        entered = np.arange(network.place_count)[:, None] == network.places[network.heads]
        losses = strategy.game.loss[network.representatives] * hit_once(network, p, entered)
        assert strategy.value == pytest.approx(losses.max())


def there_and_back(first, second):
    """A stop with two sites on all ways from the start and to the goal."""
    points = np.array([(1, 1), (1, -1), (0, 0), (2, 0), (0, 0.1)], float)
    pairs = np.array([(2, 0), (2, 1), (0, 3), (1, 3), (0, 4), (1, 4)])
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    return TripGraph(points, np.array([first, second, 0, 0, 0], float), edges, (2, 3, 4))


def test_a_site_that_two_legs_pass_counts_once():
    """Each leg passes one of two sites, of losses 1 and 3, the first with probability f."""
    roads = there_and_back(1.0, 3.0)
    strategy = solve(roads.network(roads.visits), options=FREE)
    # Legs drawn independently of each other would cost 1 - 1/16 and 3 (7/16) with f = 3/4. Legs
    # that agree with each other reach what one leg alone costs, 1 / (1 + 1/3).
    assert strategy.value == pytest.approx(0.75, rel=0.011)
    assert strategy.lower_bound == pytest.approx(0.75, rel=NEAR) and strategy.reason != 'stalled'
    assert solve(roads.network((2, 3)), options=FREE).value == pytest.approx(0.75, rel=NEAR)


@pytest.fixture(scope='module')
def risk_map():
    rng = np.random.default_rng(5)
    alpha = 1.0 + 6.0 * np.kron(rng.random((6, 6)), np.ones((5, 5)))
    obstacles = np.zeros((30, 30), bool)
    obstacles[12:18, 9:20] = True
    return RiskMap(alpha, obstacles, 10.0, (0.0, 0.0, 0.0))


@pytest.fixture(scope='module')
def as_given(risk_map):
    return plan_trip(risk_map, START, GOAL, OPTIONS, stops=STOPS)


def test_the_network_of_a_trip_can_be_built_again(risk_map, as_given):
    again = trip_network(risk_map, START, GOAL, OPTIONS, as_given.stops_xy,
                         as_given.network.refined)
    assert np.array_equal(again.points, as_given.network.points[: len(again.points)])
    assert np.array_equal(again.edges, as_given.network.edges[: len(again.edges)])


@pytest.mark.parametrize('turning_radius', [0.0, 12.0])
def test_the_path_meets_each_stop_and_keeps_to_the_corridors_of_its_leg(as_given, turning_radius):
    drive = DriveOptions(turning_radius=turning_radius)
    plan = replace(as_given, options=replace(as_given.options, drive=drive))
    routes = [plan.strategy.sample_route(np.random.default_rng(seed)) for seed in range(5)]
    paths = driven_paths(plan.corridors, routes, 5.0, turning_radius)
    for route, path in zip(routes, paths, strict=True):
        assert np.array_equal(path, departure_path(plan, route, 5.0))
        at = [np.flatnonzero((path[:, :2] == stop).all(axis=1)).tolist() for stop in STOPS]
        assert all(len(each) == 1 for each in at) and at == sorted(at)
        assert path[0, :2].tolist() == list(START) and path[-1, :2].tolist() == list(GOAL)
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        assert steps.max() <= 5.0 + 1e-9 and steps.min() > 0.0
        moved = (START[0] + 3.0, START[1]), (GOAL[0], GOAL[1] - 3.0)
        shifted = departure_path(plan, route, 5.0, moved)
        assert (tuple(shifted[0, :2]), tuple(shifted[-1, :2])) == moved


def test_corridors_are_as_wide_as_those_of_each_leg(risk_map):
    trip = plan_trip(risk_map, START, GOAL, OPTIONS, stops=STOPS[:1])
    network = trip.network
    place, first = network.places, network.representatives
    leg = Network(network.points[first], network.alpha[first],
                  np.unique(place[network.edges[network.leg[network.tails] == 0]], axis=0),
                  network.source,
                  int(place[network.stops[0]]))
    alone = make_corridors(leg, risk_map)
    for name in ('uv', 'links', 'widths', 'beyond'):
        assert np.array_equal(getattr(trip.corridors, name), getattr(alone, name))


def test_a_round_trip(risk_map):
    plan = plan_trip(risk_map, START, START, OPTIONS, stops=STOPS[:2])
    assert plan.goal_xy == START and plan.stops_xy == STOPS[:2]
    check_laws(plan.strategy, [
        *plan.network.places[[plan.network.source, *plan.network.stops, plan.network.target]]])


def test_without_stops_a_trip_is_the_plain_game(risk_map):
    plain = solve(build_network(risk_map, START, GOAL, OPTIONS.network), OPTIONS.game)
    plan = plan_trip(risk_map, START, GOAL, OPTIONS)
    assert plan.network.legs == 1
    assert np.array_equal(plan.strategy.edge_probability, plain.edge_probability)


@pytest.mark.parametrize('method', ['uniform_grid8', 'random_delaunay'])
def test_stops_are_nodes_of_every_network(risk_map, method):
    """Two are in one cell of the lattice, and one is at the start."""
    stops = [(50.0, 250.0), (52.0, 251.0), START, (54.0, 252.0)]
    network = build_network(
        risk_map, START, GOAL, NetworkOptions(method=method, spacing=25.0), stops)
    assert network.points[network.stops].tolist() == [list(stop) for stop in stops]
    assert (network.alpha[network.ends] == 0.0).all()
    assert solve(network, GameOptions(secured_radius=20.0)).value > 0.0


def test_a_stop_behind_a_door_that_the_lattice_misses():
    """Passages to all ends have nodes, not only those to the goal."""
    obstacles = np.zeros((40, 40), bool)
    obstacles[:, 13] = obstacles[:, 26] = True
    obstacles[7, 13] = obstacles[31, 26] = False
    risk_map = RiskMap(np.ones((40, 40)), obstacles, 1.0, (0.0, 0.0, 0.0))
    network = build_network(
        risk_map, (20.0, 20.0), (22.0, 5.0), NetworkOptions(spacing=6.0),
        [(5.0, 30.0), (35.0, 5.0)])
    assert network.legs == 3


@pytest.mark.parametrize(('stops', 'error', 'words'), [
    ([(150.0, 150.0)], StopBlocked, 'stop 1 .* lies in an obstacle'),
    ([STOPS[0], (500.0, 1.0)], StopBlocked, 'stop 2 .* is outside the map'),
    ([STOPS[0], (math.nan, 1.0)], StopBlocked, 'stop 2 must be finite'),
    ([(1.0, 2.0, 3.0)], StopBlocked, 'stop 1 must be a position'),
    ([STOPS[0], STOPS[0]], InvalidNetwork, 'stop 1 and stop 2 are the same position'),
    ([START, STOPS[0]], InvalidNetwork, 'start and stop 1 are the same position'),
])
def test_invalid_stops_are_refused(risk_map, stops, error, words):
    with pytest.raises(error, match=words):
        plan_trip(risk_map, START, GOAL, OPTIONS, stops=stops)


def test_options_of_the_game_alone_are_refused(risk_map):
    with pytest.raises(InvalidOption, match='must be PlanningOptions, got GameOptions'):
        plan_trip(risk_map, START, GOAL, GameOptions())


def value_of_all_routes(game, network, budget):
    """The least value of any mixture of routes, whose legs may depend on each other."""
    return value_by_routes(game.loss[game.sites], game.entering.toarray(), routes_of(network),
                           [(network.lengths, budget * (1.0 + 1e-12))])


def legs_of(game):
    """The games of the legs of a trip, each on all places, with the sites of the trip."""
    network, place, first = game.network, game.network.places, game.network.representatives
    playable = game.without_layers().playable
    at = [network.source, *network.stops.tolist(), network.target]
    for leg, (source, target) in enumerate(itertools.pairwise(at)):
        own = playable & (network.leg[network.tails] == leg)
        layer = Network(network.points[first], network.alpha[first], place[network.edges[own]],
                        int(place[source]), int(place[target]))
        yield replace(game, network=layer, loss=game.loss[first], playable=playable[own],
                      known_rows=game.entering[:, np.flatnonzero(own)])


@examples(15)
@given(seed=st.integers(0, 10**6), reach=st.sampled_from([0.0, 1.0, 2.5]),
       detour=st.sampled_from([1.05, 1.2, math.inf]))
def test_bound_and_value_enclose_that_of_all_mixtures_of_trips(seed, reach, detour):
    """And no leg alone costs more."""
    roads = roads_of(seed, 1, 4)
    network = roads.network(roads.visits)
    options = GameOptions(ambush_radius=reach, secured_radius=0.5)
    strategy = solve(network, options, StrategyOptions(max_detour=detour, risk_slack=0.001))
    check_laws(strategy, roads.visits)
    all_trips = value_of_all_routes(strategy.game, network, strategy.length_budget)
    assert strategy.lower_bound <= all_trips * (1.0 + 1e-6) + 1e-9
    assert strategy.value >= all_trips * (1.0 - 1e-6) - 1e-9
    # All of the trip's budget for one leg, the others on their shortest ways.
    for leg in legs_of(strategy.game):
        slack = strategy.length_budget - strategy.shortest_length
        shortest = least_weight(leg.network, leg.network.lengths)
        alone = value_of_all_routes(leg, leg.network, shortest + slack)
        assert strategy.value >= alone * (1.0 - 1e-6) - 1e-9
