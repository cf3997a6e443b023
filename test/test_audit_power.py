"""The audit's error rates: false alarms as stated, and the failures it is there to find."""

from __future__ import annotations

import numpy as np
import pytest
from games import paper_example, terrain_network

from ambush_planner import Network, solve
from ambush_planner.game.route_sampler import RouteSampler
from ambush_planner.network.shortest_paths import shortest_path
from ambush_planner.recordings.audit_departures import TESTS, Driven, audit
from ambush_planner.recordings.audit_draws import ManyRoutes

# Chance that a correct audit fails one of these tests; all seeds are fixed.
FALSE_ALARM = 1e-6
RUNS = 60
RATE = 0.05

pytestmark = pytest.mark.usefixtures('fewer_draws')


@pytest.fixture(scope='module')
def terrain():
    return solve(terrain_network(5, cells=20))


def run(strategy, routes, rate=0.01):
    return audit([Driven(strategy, route) for route in routes], rate)


def drawn(sampler, count, seed):
    rng = np.random.default_rng(seed)
    return [sampler.draw(rng) for _ in range(count)]


def sampler_of(strategy, weight=None):
    p = strategy.edge_probability if weight is None else weight
    return RouteSampler(strategy.network, p)


def likeliest_route(strategy):
    network, p = strategy.network, strategy.edge_probability
    used = np.flatnonzero(p > 0.0)
    surprise = -np.log(np.minimum(ManyRoutes(network, p).choice[used], 1.0)) + 1e-12
    return shortest_path(
        network.edges[used], surprise, len(network.points), network.source, network.target
    )


@pytest.mark.slow
@pytest.mark.parametrize('name, departures', [('paper', 5), ('paper', 24), ('terrain', 8)])
def test_false_alarms_are_as_rare_as_stated(name, departures):
    """Each p-value is at most u with probability at most u, and any finding as rare as stated."""
    from scipy.stats import binom  # takes long to import
    strategy = solve(paper_example() if name == 'paper' else terrain_network(3, cells=12))
    sampler, rng = sampler_of(strategy), np.random.default_rng(departures)
    results = [
        run(strategy, [sampler.draw(rng) for _ in range(departures)], RATE) for _ in range(RUNS)
    ]
    alarms = sum(bool(result.findings) for result in results)
    assert alarms <= binom.isf(FALSE_ALARM, RUNS, RATE)
    for test in TESTS:
        p_values = np.array([result.tests[test].p_value for result in results])
        for level in (0.01, 0.05, 0.2, 0.5):
            assert (p_values <= level).sum() <= binom.isf(FALSE_ALARM, RUNS, level)
    if name == 'terrain':
        # Where statistics take many values the rate is used up, not only kept.
        for test in ('frequency', 'surprise', 'order'):
            p_values = np.array([result.tests[test].p_value for result in results])
            assert (p_values <= 0.2).sum() >= binom.ppf(FALSE_ALARM, RUNS, 0.2)


def test_always_the_likeliest_route_is_found_from_the_fewest_departures_on(terrain):
    route = likeliest_route(terrain)
    result = run(terrain, [route] * 5)
    assert set(result.findings) >= {'frequency', 'repeats'}
    assert result.different == 1


def test_a_stuck_seed_is_found(terrain):
    sampler = sampler_of(terrain)
    routes = [sampler.draw(np.random.default_rng(7)) for _ in range(6)]
    assert set(run(terrain, routes).findings) >= {'frequency', 'repeats'}


def test_a_repeated_route_every_fifth_departure_is_found(terrain):
    routes = drawn(sampler_of(terrain), 25, 1)
    for k in range(5, 25, 5):
        routes[k] = routes[0]
    assert 'repeats' in run(terrain, routes).findings


def test_a_few_routes_in_rotation_are_found(terrain):
    few = drawn(sampler_of(terrain), 3, 2)
    findings = run(terrain, [few[k % 3] for k in range(18)]).findings
    assert set(findings) >= {'frequency', 'order', 'repeats'}


@pytest.mark.parametrize('power, sign', [(0.0, 1), (2.0, -1)])
def test_wrong_weights_are_found(terrain, power, sign):
    """All choices alike (the weights forgotten), and choices that are too bold."""
    p = terrain.edge_probability
    choice = ManyRoutes(terrain.network, p).choice
    routes = drawn(sampler_of(terrain, np.where(p > 0.0, choice**power, 0.0)), 20, 3)
    result = run(terrain, routes)
    assert 'surprise' in result.findings
    assert np.sign(result.mean_surprise - terrain.route_entropy) == sign


def test_a_small_bias_is_found_with_many_departures(terrain):
    """A driver who prefers turning left a little: each left turn 1.5 times as likely."""
    network, p = terrain.network, terrain.edge_probability
    up = (network.points[network.heads] - network.points[network.tails])[:, 1] > 0.1
    choice = ManyRoutes(network, p).choice
    weight = np.where(p > 0.0, choice * np.where(up, 1.5, 1.0), 0.0)
    routes = drawn(sampler_of(terrain, weight), 150, 4)
    assert 'frequency' in run(terrain, routes).findings


def two_roads():
    """Two roads far apart; on each, four parallel choices at each of four places."""
    points, edges, alpha = [(0.0, 0.0)], [], [0.0]
    last = {}
    for side in (1.0, -1.0):
        before = [0]
        for step in range(1, 5):
            here = []
            for lane in range(4):
                points.append((step * 10.0, side * (30.0 + lane)))
                alpha.append(1.0)
                here.append(len(points) - 1)
            edges += [(a, b) for a in before for b in here]
            before = here
        last[side] = before
    points.append((50.0, 0.0))
    alpha.append(0.0)
    target = len(points) - 1
    edges += [(a, target) for before in last.values() for a in before]
    return Network(np.array(points), np.array(alpha), np.array(edges), 0, target)


def by_side(strategy, pattern, seed):
    """Independent routes but for the side, which follows the pattern."""
    sampler, rng = sampler_of(strategy), np.random.default_rng(seed)
    routes = []
    for side in pattern:
        while True:
            route = sampler.draw(rng)
            if (strategy.network.points[route[1], 1] > 0.0) == bool(side):
                break
        routes.append(route)
    return routes


@pytest.mark.parametrize(
    'pattern', [[0, 1] * 15, [0] * 15 + [1] * 15, [0, 0, 1] * 10, [0, 1, 1, 0, 1] * 6],
    ids=['alternating', 'changed once', 'every third', 'every fifth'],
)
def test_patterns_of_roads_are_found_though_no_route_repeats(pattern):
    """Seen by the order alone: each lane of each road is still driven as often as published."""
    strategy = solve(two_roads())
    result = run(strategy, by_side(strategy, pattern, 5))
    assert 'order' in result.findings
    if pattern == [0, 1] * 15:
        assert result.findings == ('order',)
        assert result.order.by_lag[0] < result.order.mean < result.order.by_lag[1]


def test_roads_by_chance_show_no_pattern():
    strategy = solve(two_roads())
    pattern = np.random.default_rng(8).integers(0, 2, 30)
    assert run(strategy, by_side(strategy, pattern, 5)).findings == ()


def moving_starts(count, seed):
    """A strategy for each departure: the start moves by centimetres, as one from TF does."""
    rng = np.random.default_rng(seed)
    network = terrain_network(5, cells=20)
    for _ in range(count):
        points = network.points.copy()
        points[network.source] += 0.01 * rng.standard_normal(2)
        yield solve(Network(points, network.alpha, network.edges, network.source, network.target))


def test_a_stuck_source_is_found_though_the_start_moves():
    stuck = [
        Driven(each, each.sample_route(np.random.default_rng(5))) for each in moving_starts(12, 1)
    ]
    result = audit(stuck)
    assert result.strategies == 12
    assert {'frequency', 'repeats'} <= set(result.findings)


def test_fresh_draws_pass_though_the_start_moves():
    """One audit of a hundred may find something where all is well; of three, two do by a fault."""
    alarms = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng([seed, 9])
        fresh = [Driven(each, each.sample_route(rng)) for each in moving_starts(12, seed)]
        alarms += [seed] if audit(fresh).findings else []
    assert len(alarms) < 2
