# SPDX-License-Identifier: Apache-2.0
"""Few routes against all sets of the same candidates, and draws by hand against their shares."""

import math
import time
from dataclasses import replace
from itertools import chain, combinations, count, product

import numpy as np
import pytest
from games import examples, plain_options
from hypothesis import given
from hypothesis import strategies as st
from test_path_mixtures import GOAL, OPTIONS, START, ground, mixtures_of

from ambush_planner import (
    GameOptions,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    TimeLimit,
    plan_trip,
)
from ambush_planner.game.value import highs
from ambush_planner.operations.few_routes import few_routes
from ambush_planner.operations.path_mixtures import PathMixtures
from ambush_planner.operations.random_draws import OUTCOMES, nearest_counts, random_draws
from ambush_planner.planning.options import DriveOptions
from ambush_planner.routes.driven_path import driven_paths

# 16 different routes, so that all sets of two can be tried.
COARSE = PlanningOptions(network=plain_options(spacing=5.0), game=GameOptions(ambush_radius=2.5),
                         drive=DriveOptions(tube=1.75))


@pytest.fixture(scope='module')
def plan():
    return plan_trip(ground(), START, GOAL, OPTIONS)


def lengths(paths):
    return np.array([np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in paths])


def best_by_trial(plan, seed, size):
    """The least value of all sets of the candidates that the seed draws, ``size`` of each leg."""
    rng, paths, sets = np.random.default_rng(seed), [], []
    for leg, corridors in zip(plan.legs, plan.corridors, strict=True):
        drawn = leg.sample_routes(1000, rng)
        routes = list({route.tobytes(): route for route in drawn}.values())
        own = range(len(paths), len(paths) + len(routes))
        sets.append(list(combinations(own, min(size, len(own)))))
        paths += driven_paths(corridors, routes, plan.spacing)
    of = np.repeat(np.arange(len(sets)), [1 + max(each)[-1] - each[0][0] for each in sets])
    costs, least = lengths(paths) / np.array([leg.length_budget for leg in plan.legs])[of], np.inf
    assert math.prod(map(len, sets)) <= 200
    for some in (list(chain(*each)) for each in product(*sets)):
        if all(costs[some][of[some] == k].min() <= 1.0 for k in range(len(sets))):
            mixtures = PathMixtures(plan.risk_map, plan, [paths[k] for k in some], of[some])
            least = min(least, mixtures.best(costs[some]).value)
    return least


@pytest.mark.parametrize('size, detour, stops', [
    (2, 1.1, []), (1, 1.02, [(20.0, 17.0)])])
def test_no_other_set_of_the_candidates_is_much_better(size, detour, stops):
    options = replace(COARSE, strategy=StrategyOptions(max_detour=detour))
    plan = plan_trip(ground(3), START, GOAL, options, stops=stops)
    few = few_routes(plan, size, np.random.default_rng(5))
    assert few.value <= 1.03 * best_by_trial(plan, 5, size)
    assert few.lower_bound <= few.value


def test_a_mixture_is_what_it_says(plan):
    few = few_routes(plan, 5, np.random.default_rng(0))
    count = len(few.paths)
    assert 1 <= count <= 5 and few.shares.sum() == pytest.approx(1.0)
    assert len({path.tobytes() for path in few.paths}) == count
    judged = mixtures_of(plan.risk_map, plan, few.paths).judge(few.shares)
    assert few.value == pytest.approx(judged.value)
    np.testing.assert_allclose(few.costs, lengths(few.paths))
    assert few.shares @ few.costs <= plan.strategy.length_budget * (1.0 + 1e-6)
    sizes, values = zip(*few.curve, strict=True)
    assert sizes == tuple(sorted({min(k, count) for k in (1, 2, 4, 5)})) and values[-1] == few.value
    assert list(values) == sorted(values, reverse=True) and (np.diff(few.shares) <= 0.0).all()


@pytest.mark.parametrize('limit', [5, 60, 200])
def test_when_the_time_is_up_the_best_mixture_so_far_is_the_answer(plan, limit):
    """On a clock that goes on by a second whenever somebody looks at it; each LP looks."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(time, 'monotonic', count().__next__)
        try:
            few = few_routes(plan, 5, np.random.default_rng(0), limit)
        except TimeLimit as late:
            assert late.strategy is plan.strategy and limit == 5
            return
        assert limit > 5 and time.monotonic() <= limit + 20
    assert 1 <= len(few.paths) <= 5 and few.lower_bound <= few.value == few.curve[-1][1]
    judged = mixtures_of(plan.risk_map, plan, few.paths).judge(few.shares)
    assert few.value == pytest.approx(judged.value)
    assert few.shares @ few.costs <= plan.strategy.length_budget * (1.0 + 1e-6)


def test_a_plan_and_its_few_routes_share_the_time_limit(monkeypatch):
    deadlines, run, begin = [], highs.run, time.monotonic()
    monkeypatch.setattr(highs, 'run', lambda lp, solver, deadline, *rest: (
        deadlines.append(deadline), run(lp, solver, deadline, *rest))[1])
    options = replace(COARSE, strategy=replace(COARSE.strategy, time_limit=3600.0))
    plan = plan_trip(ground(), START, GOAL, options, routes=3)
    assert plan.options == options
    latest = max(deadline for deadline in deadlines if math.isfinite(deadline))
    assert begin + 3500.0 < latest <= time.monotonic() + 3600.0


@pytest.fixture(scope='module')
def round_trip():
    """Two ways round a wall, there and back."""
    alpha, obstacles = np.ones((20, 40)), np.zeros((20, 40), dtype=bool)
    obstacles[6:14, 8:32] = True
    game = GameOptions(ambush_radius=2.0, secured_radius=5.0)  # where the ways part
    return plan_trip(RiskMap(alpha, obstacles, 1.0), START, START, replace(OPTIONS, game=game),
                     stops=[GOAL])


@pytest.mark.parametrize('most', [1, 2])
def test_there_and_back_round_a_wall(round_trip, most):
    """Each way is hit once a trip: there on one side and back on the other, or at equal odds."""
    few = few_routes(round_trip, most, np.random.default_rng(0))
    assert few.value == pytest.approx(1.0, rel=1e-3)
    assert few.lower_bound == pytest.approx(1.0, rel=1e-2) and few.lower_bound <= few.value
    sides = np.array([path[len(path) // 2, 1] > 10.0 for path in few.paths])
    upper = np.bincount(few.leg, few.shares * sides)
    assert upper.sum() == pytest.approx(1.0, abs=1e-2), 'each side as often as the other'
    assert most > 1 or sorted(upper.tolist()) == [0.0, 1.0]


def test_few_routes_of_legs_are_drawn_one_by_one():
    plan = plan_trip(ground(), START, START, OPTIONS, stops=[GOAL], routes=3, rng=1)
    few, draws = plan.few, 20_000
    assert np.bincount(few.leg).max() <= 3 and len(few.paths) > 2
    assert plan.lower_bound <= plan.value == few.trip.value
    sums = np.zeros((2, len(few.paths)))
    np.add.at(sums, (few.leg, np.arange(len(few.paths))), few.shares)
    assert sums.sum(axis=1) == pytest.approx([1.0, 1.0])
    numbers = few.draw(draws, np.random.default_rng(0))
    table = np.zeros((len(few.paths), len(few.paths)))
    np.add.at(table, tuple(numbers.T), 1.0 / draws)
    assert np.abs(table - np.outer(sums[0], sums[1])).max() < 2.0 / math.sqrt(draws)
    path = few.path(numbers[0])
    assert path[[0, -1], :2].tolist() == [list(START)] * 2 and (path[:, :2] == GOAL).all(1).any()


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=30).filter(any), st.integers(1, 60))
@examples(30)
def test_counts_are_the_nearest(weights, total):
    shares = np.array(weights) / sum(weights)
    counts = nearest_counts(shares, total)
    assert counts.sum() == total and counts.min() >= 0
    error = counts - total * shares
    assert error.max() - error.min() <= 1.0 + 1e-6  # moving one outcome brings nothing nearer


def test_draws_by_hand_are_judged_and_cover_all_outcomes():
    plan = plan_trip(ground(), START, GOAL, COARSE, routes=6)
    for draw in random_draws(plan):
        outcomes = OUTCOMES[draw.name]
        assert len(set(outcomes)) == len(outcomes) == {'die': 6, 'two dice': 36, 'cards': 52}[
            draw.name]
        named = [end for text in draw.ranges if text != '-' for end in text.split('-')]
        assert (named[0], named[-1]) == (outcomes[0], outcomes[-1])
        mixtures = mixtures_of(plan.risk_map, plan, plan.few.paths)
        assert draw.value == pytest.approx(mixtures.judge(draw.counts / len(outcomes)).value)
