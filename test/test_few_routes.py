# SPDX-License-Identifier: Apache-2.0
"""Few routes against all sets of the same candidates, and draws by hand against their shares."""

import math
import time
from dataclasses import replace
from itertools import combinations, count

import numpy as np
import pytest
from games import examples, plain_options
from hypothesis import given
from hypothesis import strategies as st
from test_path_mixtures import GOAL, OPTIONS, START, ground

from ambush_planner import (
    GameOptions,
    InvalidOption,
    PlanningOptions,
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
                         strategy=StrategyOptions(max_detour=1.1), drive=DriveOptions(tube=1.75))


@pytest.fixture(scope='module')
def plan():
    return plan_trip(ground(), START, GOAL, OPTIONS)


def lengths(paths):
    return np.array([np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in paths])


def best_by_trial(plan, seed, size):
    """The least value of all sets of the candidates that the seed draws."""
    drawn = plan.strategy.sample_routes(1000, np.random.default_rng(seed))
    routes = list({route.tobytes(): route for route in drawn}.values())
    paths = driven_paths(plan.corridors[0], routes, plan.spacing)
    costs, budget, least = lengths(paths), plan.strategy.length_budget, np.inf
    assert size <= len(paths) <= 20
    for some in map(list, combinations(range(len(paths)), size)):
        if costs[some].min() > budget:
            continue
        mixtures = PathMixtures(plan.risk_map, plan, [paths[k] for k in some])
        least = min(least, mixtures.best(costs[None, some] / budget).value)
    return least


@pytest.mark.parametrize('size', [1, 2])
def test_no_other_set_of_the_candidates_is_much_better(size):
    plan = plan_trip(ground(3), START, GOAL, COARSE)
    few = few_routes(plan, size, np.random.default_rng(5))
    assert few.value <= 1.03 * best_by_trial(plan, 5, size)


def test_a_mixture_is_what_it_says(plan):
    few = few_routes(plan, 5, np.random.default_rng(0))
    count = len(few.paths)
    assert 1 <= count <= 5 and few.shares.sum() == pytest.approx(1.0)
    assert len({path.tobytes() for path in few.paths}) == count
    judged = PathMixtures(plan.risk_map, plan, few.paths).judged(few.shares)
    assert few.value == pytest.approx(judged.value)
    np.testing.assert_allclose(few.costs, lengths(few.paths))
    assert few.shares @ few.costs <= plan.strategy.length_budget * (1.0 + 1e-6)
    sizes, values = zip(*few.curve, strict=True)
    assert sizes == tuple(sorted({min(k, count) for k in (1, 2, 4, 5)})) and values[-1] == few.value
    assert list(values) == sorted(values, reverse=True) and (np.diff(few.shares) <= 0.0).all()


@pytest.mark.parametrize('limit', [5, 40, 60, 90, 200])
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
    judged = PathMixtures(plan.risk_map, plan, few.paths).judged(few.shares)
    assert few.value == pytest.approx(judged.value)
    assert few.shares @ few.costs <= plan.strategy.length_budget * (1.0 + 1e-6)


def test_a_plan_and_its_few_routes_share_the_time_limit(monkeypatch):
    deadlines, run, begin = [], highs.run, time.monotonic()
    monkeypatch.setattr(highs, 'run', lambda lp, solver, deadline, *rest: (
        deadlines.append(deadline), run(lp, solver, deadline, *rest))[1])
    options = replace(OPTIONS, strategy=replace(OPTIONS.strategy, time_limit=3600.0))
    plan = plan_trip(ground(), START, GOAL, options, routes=3)
    assert plan.options == options
    latest = max(deadline for deadline in deadlines if math.isfinite(deadline))
    assert begin + 3500.0 < latest <= time.monotonic() + 3600.0


def test_trips_with_stops_have_no_few_routes():
    with pytest.raises(InvalidOption, match='plan each leg as a trip of its own'):
        plan_trip(ground(), START, GOAL, OPTIONS, routes=3, stops=[(20.0, 4.0)])


def test_a_plan_draws_from_its_few_routes():
    plan = plan_trip(ground(), START, GOAL, OPTIONS, routes=3)
    paths = plan.paths(300, np.random.default_rng(0))
    number = [[each is path for each in plan.few.paths].index(True) for path in paths]
    drawn = np.bincount(number, minlength=len(plan.few.paths)) / 300
    assert np.abs(drawn - plan.few.shares).max() < 0.12  # four standard deviations


@pytest.mark.parametrize('routes, game, words', [
    (0, {}, 'routes must be from 1 to .*got 0'), (101, {}, 'routes must be from 1 to .*got 101'),
    (3, {'ambush_radius': 0.0}, '--reach'),
])
def test_requests_without_an_answer_are_refused(routes, game, words):
    options = PlanningOptions(network=OPTIONS.network,
                              game=GameOptions(**{'ambush_radius': 2.0, **game}))
    with pytest.raises(InvalidOption, match=words):
        plan_trip(ground(), START, GOAL, options, routes=routes)


@given(st.lists(st.integers(0, 1000), min_size=1, max_size=30).filter(any), st.integers(1, 60))
@examples(30)
def test_counts_are_the_nearest(weights, total):
    shares = np.array(weights) / sum(weights)
    counts = nearest_counts(shares, total)
    assert counts.sum() == total and counts.min() >= 0
    error = counts - total * shares
    assert error.max() - error.min() <= 1.0 + 1e-6  # moving one outcome brings nothing nearer


def test_draws_by_hand_are_judged_and_cover_all_outcomes():
    plan = plan_trip(ground(), START, GOAL, OPTIONS, routes=6)
    for draw in random_draws(plan):
        outcomes = OUTCOMES[draw.name]
        assert len(set(outcomes)) == len(outcomes) == {'die': 6, 'two dice': 36, 'cards': 52}[
            draw.name]
        named = [end for text in draw.ranges if text != '-' for end in text.split('-')]
        assert (named[0], named[-1]) == (outcomes[0], outcomes[-1])
        mixtures = PathMixtures(plan.risk_map, plan, plan.few.paths)
        assert draw.value == pytest.approx(mixtures.judged(draw.counts / len(outcomes)).value)
