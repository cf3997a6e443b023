# SPDX-License-Identifier: Apache-2.0
"""Places to hold next: held places against all routes, plans and every candidate; the command."""

import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest
from commands import run_here
from games import examples, plain_options, planar_network, reached, routes_of, value_by_routes
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import (
    AmbushPlannerWarning,
    GameOptions,
    InvalidOption,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    TimeLimit,
    places_to_hold,
    plan_trip,
    solve,
)
from ambush_planner.commands import hold
from ambush_planner.commands.inputs import options_of
from ambush_planner.game.revaluation import bound_if_secured
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.tables import InvalidFeatures
from ambush_planner.operations import hold as operation
from ambush_planner.planning.solving import Ground

START, GOAL, RADIUS, SLACK = (3.0, 10.0), (27.0, 10.0), 5.0, 0.01
OPTIONS = PlanningOptions(network=plain_options(spacing=3.0),
                          game=GameOptions(ambush_radius=2.0, secured_radius=6.0),
                          strategy=StrategyOptions(risk_slack=SLACK, time_limit=1000.0))
CANDIDATES = {'corner': (3.0, 18.0), 'north gate': (15.5, 15.0), 'south gate': (15.5, 5.0),
              'before it': (11.0, 5.0), 'mill': (22.0, 9.0)}


@pytest.fixture(scope='module')
def yard():
    """Open ground with a wall and two gates, the northern one dearer."""
    alpha, wall = np.ones((20, 30)), np.zeros((20, 30), dtype=bool)
    alpha[10:] = 3.0
    wall[:, 15] = True
    wall[[4, 5, 14, 15], 15] = False
    return RiskMap(alpha, wall, 1.0)


@pytest.fixture(scope='module')
def found(yard):
    return places_to_hold(yard, START, GOAL, RADIUS, 2, OPTIONS)


@examples(15)
@given(st.integers(0, 10**6), st.floats(0.3, 1.2), st.sampled_from((1.1, np.inf)))
def test_value_and_bound_enclose_the_value_over_all_routes(seed, reach, detour):
    """With held places; what the ambusher of the game without them proves is below, too."""
    network, rng = planar_network(seed), np.random.default_rng(seed)
    routes = routes_of(network)
    assume(len(routes) <= 1000)
    places = tuple((*rng.uniform(0.5, 3.5, 2), rng.uniform(0.3, 1.2)) for _ in range(2))
    options = StrategyOptions(max_detour=detour)
    before = solve(network, GameOptions(ambush_radius=reach, secured_radius=0.5), options)
    strategy = solve(network, GameOptions(ambush_radius=reach, secured_radius=0.5,
                                          secured_places=places), options)
    near = reached(network, reach, 0.5, held=places)
    limits = [(network.lengths, strategy.length_budget)]
    once = value_by_routes(network.alpha, near, routes, limits)
    assert strategy.lower_bound == pytest.approx(once, rel=2e-3, abs=1e-7)
    assert strategy.value >= once * (1.0 - 2e-6) - 1e-9
    assert bound_if_secured(before.as_trip, places) <= once * (1.0 + 1e-6) + 1e-9
    unchanged = bound_if_secured(before.as_trip, ())
    assert unchanged == pytest.approx(before.lower_bound, rel=1e-6, abs=1e-9)


def test_the_ambusher_of_a_trip_bounds_it_with_more_secured_area(yard):
    strategy = plan_trip(yard, START, GOAL, OPTIONS, stops=[(22.0, 16.0)]).trip
    assert bound_if_secured(strategy, ()) == pytest.approx(strategy.lower_bound, rel=1e-6)
    for place in ((15.5, 5.0, 5.0), (22.0, 10.0, 3.0)):  # a cut without this gate is none
        held = GameOptions(ambush_radius=2.0, secured_radius=6.0, secured_places=(place,))
        planned = plan_trip(yard, START, GOAL, PlanningOptions(network=OPTIONS.network, game=held),
                            stops=[(22.0, 16.0)]).trip
        assert bound_if_secured(strategy, (place,)) <= planned.value * (1.0 + 1e-9)


def test_each_step_is_the_plan_with_its_places_held_and_the_value_does_not_rise(yard, found):
    values = [each.value for each in found.strategies]
    assert len(values) == 3 and values[1] < 0.9 * values[0]
    assert values[2] <= values[1] * (1.0 + SLACK)
    for number, strategy in enumerate(found.strategies):
        places = tuple((*step.xy, RADIUS) for step in found.steps[:number])
        game = GameOptions(ambush_radius=2.0, secured_radius=6.0, secured_places=places)
        plan = plan_trip(yard, START, GOAL, PlanningOptions(network=OPTIONS.network, game=game))
        assert (strategy.value, strategy.lower_bound) == pytest.approx(
            (plan.strategy.value, plan.strategy.lower_bound), rel=1e-12)


@pytest.mark.parametrize(('games', 'steps'), [(0, 0), (3, 1)])
def test_when_the_time_is_up_it_is_the_best_so_far(yard, monkeypatch, games, steps):
    """The clock ends it after some games; each has the time that is left of one limit."""
    ends, begin = [], time.monotonic()

    class Until(Ground):
        def compare(self, networks, end, warm=None):
            if len(ends) == games:
                raise TimeLimit('the time is up')
            ends.append(end)
            return super().compare(networks, end, warm)

    monkeypatch.setattr(operation, 'Ground', Until)
    options = replace(OPTIONS, strategy=replace(OPTIONS.strategy, time_limit=1000.0))
    found = places_to_hold(yard, START, GOAL, RADIUS, 2, options)
    assert not found.complete and len(found.steps) == steps and len(ends) == games
    assert len({*ends}) <= 1 and max(ends, default=begin) <= time.monotonic() + 1000.0
    values = [each.value for each in found.strategies]
    assert values == sorted(values, reverse=True)
    for step in found.steps:
        assert step.strategy.value >= step.strategy.lower_bound > 0.0


def test_no_candidate_that_the_bounds_rule_out_is_better(yard):
    (step,) = places_to_hold(yard, START, GOAL, RADIUS, 1, OPTIONS, candidates=CANDIDATES).steps
    assert step.candidates == len(CANDIDATES) > step.solved
    held = {name: plan_trip(yard, START, GOAL, PlanningOptions(
        network=OPTIONS.network, game=GameOptions(ambush_radius=2.0, secured_radius=6.0,
                                                  secured_places=((*xy, RADIUS),)))).strategy.value
            for name, xy in CANDIDATES.items()}
    assert held[step.name] <= min(held.values()) * (1.0 + SLACK + 1e-5)
    assert step.others <= min(value for name, value in held.items() if name != step.name)


def test_ends_early_without_candidates_or_without_a_value(yard):
    two = {name: CANDIDATES[name] for name in ('north gate', 'south gate')}
    found = places_to_hold(yard, START, GOAL, RADIUS, 5, OPTIONS, candidates=two)
    assert sorted(step.name for step in found.steps) == sorted(two)
    assert found.steps[1].others == np.inf
    (step,) = places_to_hold(yard, START, GOAL, 30.0, 5, OPTIONS, candidates=two).steps
    assert step.strategy.value == 0.0


@pytest.mark.parametrize(('places', 'words'), [
    (((1.0, 2.0),), 'must each be x, y and a radius over 0'),
    (((1.0, 2.0, 0.0),), 'a radius over 0'), (((1.0, np.nan, 1.0),), 'a radius over 0'),
    ('here', 'a radius over 0'),
])
def test_secured_places_are_positions_with_a_radius(places, words):
    with pytest.raises(InvalidOption, match=f'secured_places .*{words}'):
        GameOptions(secured_places=places)


def test_old_names_of_the_secured_area_still_work(inputs):
    place = (1.0, 2.0, 3.0)
    game = GameOptions(held_places=[place])
    assert game == GameOptions(secured_places=(place,)) and replace(game) == game
    with pytest.warns(AmbushPlannerWarning, match=r'game\.held_places is now game\.secured_places'):
        assert options_of(['game.held_places=[[1, 2, 3]]'])[1].game == game
    done = run_here(hold, inputs / 'map.yaml', '--start', 3, 10, '--goal', 27, 10, '--held', 6,
                    '--radius', 0.5, '-o', inputs / 'hold.png')
    assert '--held is now --secured' in done.err and 'radius' in done.err


@pytest.fixture
def inputs(tmp_path, yard):
    values = np.where(yard.obstacles, 100, 11 * (yard.alpha - 1.0)).astype(np.int8)
    write_map(tmp_path / 'map.yaml', OccupancyMap(values, 1.0))
    (tmp_path / 'places.csv').write_text(
        'name,x,y\n' + ''.join(f'{name},{x},{y}\n' for name, (x, y) in CANDIDATES.items()))
    return tmp_path


def run(folder, *options):
    return run_here(hold, folder / 'map.yaml', '--start', 3, 10, '--goal', 27, 10, '--reach', 2,
                    '--secured', 6, '-o', folder / 'hold.png', '--set',
                    'network.spacing=4', 'network.refine=0', *options)


def test_the_command_writes_a_picture_and_names_the_places(inputs):
    pytest.importorskip('matplotlib', reason='pictures need matplotlib')
    done = run(inputs, '--radius', 5, '-k', 1, '--candidates', inputs / 'places.csv')
    assert done.code == 0, done.err
    assert ' gate' in done.out and 'the other 4 candidates stay above' in done.out
    assert (inputs / 'hold.png').stat().st_mode & 0o777 == 0o600
    value = float(re.search(r'gate +([\d.]+),', done.out)[1])
    places = done.out.partition("--set '")[2].partition("'")[0]
    done = run(inputs, places, '--radius', 5, '-k', 1, '--json')
    assert json.loads(done.out)['value'] == pytest.approx(value, rel=1e-3)


@pytest.mark.parametrize(('text', 'reason'), [
    ('name,x\na,1\n', 'the columns x and y'),
    ('name,x,y\n', 'no Point in it'),
    ('name,x,y\na,1,nan\nb,2,3\n', '1 of 2 features are left out'),
    ('name,x,y\na,1,2\na,3,4\n', "each place needs its own name, but 'a'"),
    ('x,y\n1,2\n', "no attribute 'name'"),
])
def test_unusable_places_are_refused(tmp_path, text, reason):
    (tmp_path / 'p.csv').write_text(text)
    pytest.importorskip('geopandas', reason='vector files take the extra "gis"')
    ground = RiskMap(np.ones((20, 30)), np.zeros((20, 30), bool), 1.0)
    with pytest.raises(InvalidFeatures, match=reason):
        hold.read_places(str(tmp_path / 'p.csv'), ground)
