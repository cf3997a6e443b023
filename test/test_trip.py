# SPDX-License-Identifier: Apache-2.0
"""Trips with stops: laws of legs that are drawn one by one, trips by hand, all mixtures of routes.
"""

import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from games import (
    check_unit_flow,
    drawn_routes,
    examples,
    hit_once,
    least_weight,
    neighbours,
    reached,
    routes_of,
    trip_value,
)
from hypothesis import given, reject
from hypothesis import strategies as st

from ambush_planner import (
    GameOptions,
    InvalidNetwork,
    InvalidOption,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    RiskMap,
    StopBlocked,
    StrategyOptions,
    plan_trip,
    solve,
)
from ambush_planner.arrays import ROUNDING
from ambush_planner.game.game import make_games
from ambush_planner.game.proof import _leg_targets
from ambush_planner.game.solver import solve_legs
from ambush_planner.network.construction import build_trip_graph
from ambush_planner.network.trip_graph import TripGraph
from ambush_planner.planning.options import DriveOptions
from ambush_planner.planning.plan import departure_path, draw_routes

# The tolerance of a certificate, and as much again.
NEAR = 2e-5
FREE = StrategyOptions(max_detour=math.inf, risk_slack=0.0)
OPTIONS = PlanningOptions(network=NetworkOptions(spacing=30.0),
                          game=GameOptions(secured_radius=20.0))
START, GOAL = (15.0, 15.0), (285.0, 150.0)
STOPS = ((45.0, 250.0), (240.0, 255.0), (255.0, 45.0))


def roads_of(seed, stops, count=14, crossing=False):
    """Random places, joined as Delaunay does; start, stops and goal are the last ones.

    ``crossing``: two roads are one-way, and three more cross others.
    """
    rng = np.random.default_rng(seed)
    points = rng.random((count + stops + 2, 2)) * 10.0
    alpha = rng.uniform(0.5, 4.0, len(points))
    alpha[count:] = 0.0
    pairs = neighbours(points)
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    if crossing:
        edges = np.delete(edges, rng.integers(0, len(edges), 2), axis=0)
        more = rng.integers(0, count, (3, 2))
        edges = np.unique(np.concatenate((edges, more[more[:, 0] != more[:, 1]])), axis=0)
    return TripGraph(points, alpha, edges, tuple(range(count, count + stops + 2)))


def solved(roads, game=None, options=FREE):
    """The strategies of the legs."""
    return solve_legs(make_games(roads.networks(), game or GameOptions()), options)


def mixed_routes(strategy):
    """The whole routes of a leg as edges, and their shares, if it is not a chain."""
    return (strategy.mixture.routes, strategy.mixture.shares) if strategy.mixture else ([], [])


def hits_of(trip, visits):
    """Which edges (legs, S, M) hit each node, around whose ends nobody waits."""
    options = trip.game.options
    return [reached(leg.network, options.reach, options.secured_distance, visits)
            for leg in trip.legs]


def check_laws(trip, visits):
    """Flows, budgets, routes; the value is the largest sum over the legs, and q proves the bound.

    Hits are counted by an own pass over the routes, and the best responses found by listing all
    routes, or by Dijkstra if each entry is a hit.
    """
    mean, proved = np.zeros(len(trip.game.network.points)), 0.0
    for leg, hits, ends in zip(trip.legs, hits_of(trip, visits), itertools.pairwise(visits),
                               strict=True):
        network, p, price = leg.network, leg.edge_probability, leg.length_price
        check_unit_flow(network, p)
        assert leg.expected_length <= leg.length_budget * (1.0 + 1e-6)
        for route in leg.sample_routes(20, np.random.default_rng(0)):
            assert (route[0], route[-1]) == ends and len(set(route.tolist())) == len(route)
        if leg.mixture is None:
            mean += hit_once(network, p, hits)
        for route, chance in zip(*mixed_routes(leg), strict=True):
            mean += chance * hits[:, route].any(axis=1)
        site_prices = trip.ambusher.q * trip.game.network.alpha
        if trip.game.reach > 0.0:
            least = min(site_prices @ hits[:, route].any(axis=1)
                        + price * network.lengths[route].sum() for route in routes_of(network))
        else:
            least = least_weight(network, site_prices[network.heads] + price * network.lengths)
        proved += least - (price * leg.length_budget if price else 0.0)
    losses = trip.game.network.alpha * mean
    assert trip.value == pytest.approx(losses.max(), rel=1e-9, abs=1e-12)
    assert trip.lower_bound <= min(proved + 1e-9 * (1.0 + proved), trip.value)


def test_each_leg_is_to_prove_the_losses_of_its_own():
    """Not a share of all: legs that lose nothing were to prove as much as the others."""
    trip = solved(roads_of(3, 2), GameOptions(ambush_radius=1.0, secured_radius=0.5))
    losses = trip.hits @ (trip.ambusher.q * trip.game.loss)[trip.game.sites]
    assert np.ptp(losses) > 0.1 * trip.value
    assert _leg_targets(trip.joint, trip.law, trip.ambusher, trip.value) == pytest.approx(losses)


# Laws.

@examples(40)
@given(seed=st.integers(0, 10**6), stops=st.integers(0, 2),
       reach=st.sampled_from([0.0, 1.0, 2.5]), detour=st.sampled_from([1.0, 1.05, 1.2, math.inf]),
       crossing=st.booleans())
def test_bound_and_value_enclose_that_of_all_mixtures_of_each_leg(seed, stops, reach, detour,
                                                                  crossing):
    """No leg alone costs more, and all legs together no more than solved apart."""
    roads, slack = roads_of(seed, stops, 4, crossing), 0.001
    game = GameOptions(ambush_radius=reach, secured_radius=0.5)
    options = StrategyOptions(max_detour=detour, risk_slack=slack)
    try:
        trip = solved(roads, game, options)
    except NoRoute:  # the roads are one-way
        reject()
    check_laws(trip, roads.visits)
    alpha = roads.alpha
    least = trip_value(alpha, [leg.network for leg in trip.legs], hits_of(trip, roads.visits),
                       [leg.length_budget * (1.0 + 1e-12) for leg in trip.legs])
    assert trip.lower_bound <= least * (1.0 + 1e-6) + 1e-9
    assert trip.value >= least * (1.0 - 1e-6) - 1e-9
    assert trip.lower_bound >= least * (1.0 - 5e-3) - 1e-9
    alone = [solve_legs((leg.game,), options) for leg in trip.legs]
    assert trip.lower_bound <= sum(each.value for each in alone) * (1.0 + 1e-6)
    for k, each in enumerate(alone):
        assert trip.value >= each.lower_bound * (1.0 - 1e-6)
        assert trip.legs[k].value <= trip.value * (1.0 + 1e-9)
    assert max(leg.value for leg in trip.legs) - 1e-9 <= trip.value
    assert trip.first_hit_value <= trip.value * (1.0 + 1e-9)


def test_legs_are_drawn_one_by_one():
    """The frequency of each (way out, way back) is the product of both, and mean losses add up."""
    roads = roads_of(4, 1, 8)
    roads = replace(roads, visits=(8, 9, 8))
    trip, draws = solved(roads, GameOptions(ambush_radius=1.0, secured_radius=0.5)), 4000
    rng = np.random.default_rng(7)
    drawn = [[tuple(route.tolist()) for route in leg.sample_routes(draws, rng)]
             for leg in trip.legs]
    names = [{route: k for k, route in enumerate(sorted(set(each)))} for each in drawn]
    table = np.zeros([len(each) for each in names])
    np.add.at(table, tuple([names[leg][route] for route in each]
                           for leg, each in enumerate(drawn)), 1.0)
    expected = np.outer(table.sum(axis=1), table.sum(axis=0)) / draws
    assert min(table.shape) > 1
    common = expected > 5.0
    surprise = (table - expected)[common] / np.sqrt(expected[common])
    assert np.square(surprise).sum() < common.sum() + 5.0 * math.sqrt(2.0 * common.sum())
    # And each leg's routes have the odds of its own law.
    for leg, each in zip(trip.legs, drawn, strict=True):
        for route, chance in drawn_routes(leg.network, leg.edge_probability).items():
            nodes = (leg.network.source, *leg.network.heads[list(route)].tolist())
            assert each.count(nodes) == pytest.approx(
                draws * chance, abs=5.0 * math.sqrt(draws * chance) + 3.0)


# By hand.

def there_and_back(first, second):
    """A stop with two sites on all ways from the start and to the goal."""
    points = np.array([(1, 1), (1, -1), (0, 0), (2, 0), (0, 0.1)], float)
    pairs = np.array([(2, 0), (2, 1), (0, 3), (1, 3), (0, 4), (1, 4)])
    edges = np.concatenate((pairs, pairs[:, ::-1]))
    return TripGraph(points, np.array([first, second, 0, 0, 0], float), edges, (2, 3, 4))


def test_a_site_that_two_legs_pass_costs_both():
    """Each leg passes one of two sites, of losses 1 and 3, the first with probability 3/4."""
    roads = there_and_back(1.0, 3.0)
    trip = solved(roads)
    assert trip.value == pytest.approx(1.5, rel=NEAR) and trip.lower_bound == pytest.approx(1.5)
    # The first hit ends the trip: 1 - (1/4)^2 and 3 (1 - (3/4)^2).
    out, back = (leg.visit_probability[:2] for leg in trip.legs)
    assert out + back == pytest.approx([1.5, 0.5], rel=1e-3)
    assert trip.first_hit_value == pytest.approx(((1 - (1 - out) * (1 - back)) * (1, 3)).max())
    assert solve(roads.networks()[0], options=FREE).value == pytest.approx(0.75, rel=NEAR)


def test_legs_that_share_ground_leave_it_to_each_other():
    """Each leg has its own site and one that both may pass: apart both would use that by half."""
    points = np.array([(1, 0), (1, 2), (1, -2), (0, 0), (2, 0), (2.5, 0)], float)
    shared, out, back = 0, 1, 2
    start, stop, goal = 3, 4, 5
    edges = np.array([(start, shared), (shared, stop), (start, out), (out, stop), (stop, shared),
                      (shared, goal), (stop, back), (back, goal)])
    trip = solved(TripGraph(points, np.array([1.0, 1, 1, 0, 0, 0]), edges, (start, stop, goal)))
    assert trip.value == pytest.approx(2.0 / 3.0, rel=1e-3)
    assert trip.lower_bound == pytest.approx(2.0 / 3.0, rel=1e-3)
    alone = [solve_legs((leg.game,), FREE).value for leg in trip.legs]
    assert alone == pytest.approx([0.5, 0.5], rel=NEAR)


def test_two_gates_within_the_reach_are_whole_routes_drawn_with_their_shares():
    """An ambush on either side reaches the ways before and after the bridge between them.

    So routes stay on their side: a chain, which forgets it, would be hit in 3 of 4 trips.
    """
    points = [(-2, 0), (1.5, 2), (1.5, -2), (2, 0), (2.5, 2), (2.5, -2), (6, 0)]
    pairs = np.array([(0, 1), (0, 2), (1, 3), (2, 3), (3, 4), (3, 5), (4, 6), (5, 6)])
    roads = TripGraph(np.array(points, float), np.array([0, 1, 1, 0, 1, 1, 0], float),
                      np.concatenate((pairs, pairs[:, ::-1])), (0, 6))
    trip = solved(roads, GameOptions(ambush_radius=1.2, secured_radius=0.0), StrategyOptions())
    assert trip.lower_bound == pytest.approx(0.5, rel=1e-3) and trip.reason == 'complete'
    assert trip.value <= 0.50501
    check_laws(trip, roads.visits)
    (leg,) = trip.legs
    assert leg.mixture.shares == pytest.approx([0.5, 0.5], abs=0.01)
    assert leg.route_entropy == pytest.approx(math.log(2.0), abs=1e-3)
    routes = leg.sample_routes(400, np.random.default_rng(3))
    assert np.mean([1 in route for route in routes]) == pytest.approx(0.5, abs=0.1)
    assert all((1 in route) == (4 in route) for route in routes)


# Plans.

@pytest.fixture(scope='module')
def risk_map():
    rng = np.random.default_rng(5)
    alpha = 1.0 + 6.0 * np.kron(rng.random((6, 6)), np.ones((5, 5)))
    obstacles = np.zeros((30, 30), bool)
    obstacles[12:18, 9:20] = True
    return RiskMap(alpha, obstacles, 10.0, (0.0, 0.0, 0.0))


@pytest.fixture(scope='module')
def made(risk_map):
    return plan_trip(risk_map, START, GOAL, OPTIONS, stops=STOPS)


def test_a_plan_keeps_the_laws_of_legs(made):
    check_laws(made.trip, (made.network.source, *(leg.network.target for leg in made.legs)))
    assert made.stops_xy == STOPS and (made.start_xy, made.goal_xy) == (START, GOAL)


@pytest.mark.parametrize('turning_radius', [0.0, 12.0])
def test_the_path_meets_each_stop_and_keeps_to_the_corridors_of_its_leg(made, turning_radius):
    drive = DriveOptions(turning_radius=turning_radius)
    plan = replace(made, options=replace(made.options, drive=drive))
    for route in draw_routes(plan, 5, np.random.default_rng(1)):
        path = departure_path(plan, route, 5.0)
        at = [np.flatnonzero((path[:, :2] == stop).all(axis=1)).tolist() for stop in STOPS]
        assert all(len(each) == 1 for each in at) and at == sorted(at)
        assert path[0, :2].tolist() == list(START) and path[-1, :2].tolist() == list(GOAL)
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        assert steps.max() <= 5.0 + 1e-9 and steps.min() > 0.0
        moved = (START[0] + 3.0, START[1]), (GOAL[0], GOAL[1] - 3.0)
        shifted = departure_path(plan, route, 5.0, moved)
        assert (tuple(shifted[0, :2]), tuple(shifted[-1, :2])) == moved


def test_a_round_trip(risk_map):
    plan = plan_trip(risk_map, START, START, OPTIONS, stops=STOPS[:1])
    assert plan.goal_xy == START and plan.stops_xy == STOPS[:1]
    source, stop = plan.network.source, plan.network.target
    check_laws(plan.trip, (source, stop, source))
    # The way back is no secret of the way out: it costs twice what the way out alone does.
    alone = plan_trip(risk_map, START, STOPS[0], OPTIONS)
    assert plan.value == pytest.approx(2.0 * alone.value, rel=0.02)


@pytest.mark.parametrize('method', ['uniform_grid8', 'random_delaunay'])
def test_stops_are_nodes_of_every_network(risk_map, method):
    """Two are in one cell of the lattice, and one is at the start."""
    stops = [(50.0, 250.0), (52.0, 251.0), START, (54.0, 252.0)]
    roads = build_trip_graph(
        risk_map, START, GOAL, NetworkOptions(method=method, spacing=25.0), stops)
    assert roads.points[list(roads.visits[1:-1])].tolist() == [list(stop) for stop in stops]
    assert (roads.alpha[list(roads.visits)] == 0.0).all()
    assert solved(roads, GameOptions(secured_radius=20.0), StrategyOptions()).value > 0.0


def test_a_stop_behind_a_door_that_the_lattice_misses():
    """Passages to all ends have nodes, not only those to the goal."""
    obstacles = np.zeros((40, 40), bool)
    obstacles[:, 13] = obstacles[:, 26] = True
    obstacles[7, 13] = obstacles[31, 26] = False
    risk_map = RiskMap(np.ones((40, 40)), obstacles, 1.0, (0.0, 0.0, 0.0))
    roads = build_trip_graph(
        risk_map, (20.0, 20.0), (22.0, 5.0), NetworkOptions(spacing=6.0),
        [(5.0, 30.0), (35.0, 5.0)])
    assert len(make_games(roads.networks(), GameOptions())) == 3


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


class Clock:
    """Time that passes by operations: each look at it takes a second.

    So no solver that has a clock of its own ends early.
    """

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


@pytest.mark.filterwarnings('ignore::ambush_planner.AmbushPlannerWarning')
def test_a_plan_is_never_worse_than_that_of_the_plain_network_in_the_same_time(
        risk_map, monkeypatch):
    """However short the time is: what is returned is the best plan that is finished."""
    values, refined = [], 0
    for limit in (10.0, 100.0, 1000.0, 3000.0):
        for refine in (0, 2):
            monkeypatch.setattr(time, 'monotonic', Clock())
            options = PlanningOptions(
                network=NetworkOptions(spacing=30.0, refine=refine), max_gap=math.inf,
                game=GameOptions(ambush_radius=25.0), strategy=StrategyOptions(time_limit=limit))
            plan = plan_trip(risk_map, START, GOAL, options)
            values.append(plan.value)
        refined += plan.network.refined is not None
        assert values[-1] <= values[-2] * (1.0 + ROUNDING)
    assert refined and min(values[1::2]) < min(values[::2])
