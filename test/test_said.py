# SPDX-License-Identifier: Apache-2.0
"""Messages in Python and of commands; suffixes in upper case; files across 180 degrees."""

import re
import shlex
import warnings
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from commands import run_here
from games import plain_options

from ambush_planner import (
    AmbushPlannerWarning,
    GameOptions,
    InvalidCoordinates,
    Network,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    plan_trip,
    read_risk_map,
    solve,
)
from ambush_planner.commands import hold, plan
from ambush_planner.commands.inputs import as_typed
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.risk_map_file import npz_bytes
from ambush_planner.planning.concerns import concerns, wide_gap
from ambush_planner.planning.one_place import find_one_place
from ambush_planner.planning.options import DriveOptions
from ambush_planner.recordings.verify import gap_problems

START, GOAL = (10.0, 50.0), (190.0, 50.0)


def ground(crs=None, corner=(0.0, 0.0)):
    alpha = 1.0 + 0.01 * np.mgrid[:20, :40][0]
    return RiskMap(alpha, np.zeros((20, 40), bool), 5.0, (*corner, 0.0), crs)


def test_a_length_budget_that_seems_to_be_a_percentage_is_named():
    made = plan_trip(ground(), START, GOAL, PlanningOptions(network=plain_options(spacing=20.0)))
    for detour, named in ((1.2, False), (20.0, True), (np.inf, False)):
        strategy = replace(made.options.strategy, max_detour=detour)
        asked = replace(made, options=replace(made.options, strategy=strategy))
        assert any('is a ratio' in text for text in concerns(asked)) == named


def test_a_wide_gap_says_what_the_plan_is_worth_and_how_to_allow_more_time():
    made = plan_trip(ground(), START, GOAL, PlanningOptions(
        network=replace(plain_options(spacing=20.0), refine=None)))
    for share, reason, words in (
            (0.905, 'time', 'so the plan can be used; the time limit'),  # and a slack of 1 %
            (0.8, 'time', 'more than 10% (strategy.max_gap); the time limit'),
            (0.8, 'stalled', 'and more time would not help')):
        certificate = replace(made.trip.certificate, bound=share * made.lower_bound)
        late = replace(made, trip=replace(made.trip, certificate=certificate, reason=reason))
        text = as_typed(wide_gap(late))
        assert words in text and 'above the best on this network' in text
        assert text.endswith('(--set strategy.time_limit=SECONDS)') == (reason == 'time')
        assert late.gap_is_wide == (share < 0.9)
        assert bool(gap_problems(late.trip, late.options)) == ((share, reason) == (0.8, 'time'))


@pytest.mark.parametrize(('reach', 'spacing', 'words'), [
    (100.0, 20.0, 'the value is 0: nobody can wait within'),
    (60.0, 20.0, 'one place covers every'), (15.0, 10.0, r'is decided at \d nodes'),
])
def test_python_warns_in_the_sentences_of_the_command(reach, spacing, words, tmp_path):
    (tmp_path / 'MAP.NPZ').write_bytes(npz_bytes(ground()))
    options = PlanningOptions(network=plain_options(spacing=spacing),
                              game=GameOptions(ambush_radius=reach))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter('always')
        plan_trip(read_risk_map(tmp_path / 'MAP.NPZ'), START, GOAL, options)
    texts = [str(each.message) for each in said if each.category is AmbushPlannerWarning]
    assert [each.filename for each in said] == [__file__] * len(said)
    done = run_here(plan, tmp_path / 'MAP.NPZ', '--start', *START, '--goal', *GOAL,
                    '--reach', reach, '--set', f'network.spacing={spacing}', 'network.refine=0',
                    '-o', tmp_path / 'R.CSV', tmp_path / 'R.PNG')
    names = {'--secured': 'game.secured_radius', '--detour': 'strategy.max_detour'}  # as typed
    said_there = re.sub('|'.join(names), lambda found: names[found[0]], done.err)
    assert re.findall(r'Warning: (.*)\.\n', said_there) == texts, done.err
    assert re.search(words, ' '.join(texts))
    assert (tmp_path / 'R.CSV').stat().st_size > 100 and (tmp_path / 'R.PNG').stat().st_size > 1000


@pytest.mark.parametrize('tolerance', [0.0, np.inf])
def test_by_default_no_place_covers_every_way_out(tolerance):
    """The secured area is as wide as the reach, tube and start tolerance."""
    made = plan_trip(ground(), START, GOAL, PlanningOptions(
        network=plain_options(spacing=10.0), game=GameOptions(ambush_radius=20.0),
        drive=DriveOptions(start_tolerance=tolerance)))
    assert made.strategy.game.options.secured_distance == 22.0 and made.value < 0.9
    assert not any('covers every way' in text for text in concerns(made))


def gate(at, rows=(9, 11)):
    """Open ground with a wall at a column, and a gate in it."""
    wall = np.zeros((20, 40), bool)
    wall[:, at] = True
    wall[slice(*rows), at] = False
    return RiskMap(np.ones(wall.shape), wall, 5.0)


@pytest.mark.parametrize('at', [5, 8, 33])
def test_the_secured_area_that_is_proposed_helps(at):
    """A gate near the start or the goal: with that radius, no place hits every route any more."""
    options = PlanningOptions(network=plain_options(spacing=10.0), game=GameOptions(
        ambush_radius=10.0, secured_radius=10.0))
    made = plan_trip(gate(at), START, GOAL, options)
    (text,) = concerns(made)
    found = re.search(r'secure \d+ m around start and goal \(game.secured_radius=(\d+)\), hold',
                      text)
    x, y = map(float, re.search(r', at \((.*?)\), ', text)[1].split(', '))
    assert np.hypot(x - 5.0 * at, y - 50.0) < 25.0
    better = plan_trip(gate(at), START, GOAL, replace(options, game=replace(
        options.game, secured_radius=float(found[1]))))
    assert better.value < 0.8 * made.value and not find_one_place(better)


def test_a_way_around_is_proposed_if_it_helps():
    """On the shortest ways only, all pass the gate; the other one is 1.2 times as long."""
    wall = gate(20, (0, 2)).obstacles & gate(20, (9, 11)).obstacles
    made = plan_trip(RiskMap(np.ones(wall.shape), wall, 5.0), START, GOAL, PlanningOptions(
        network=plain_options(spacing=5.0), game=GameOptions(ambush_radius=10.0),
        strategy=StrategyOptions(max_detour=1.0)))
    (text,) = concerns(made)
    assert re.search(r'or drive around it \(strategy.max_detour=1\.[12]\)$', text), text


def test_the_command_writes_the_place_as_asked_and_the_call_of_hold(tmp_path):
    pytest.importorskip('pyproj', reason='coordinate systems take the extra "gis"')
    area = replace(gate(20), crs='EPSG:32616', origin=(735_000.0, 4_050_000.0, 0.0))
    file = tmp_path / 'my map.npz'
    file.write_bytes(npz_bytes(area))
    ends = Coordinates('EPSG:32616').to_lat_lon(np.add((START, GOAL), area.origin[:2]))
    one, other = (f'{lat:.6f},{lon:.6f}' for lat, lon in ends)
    done = run_here(plan, file, '--start', one, '--goal', other, '--reach', 10, '--set',
                    'network.spacing=10', 'network.refine=0', '-o', tmp_path / 'r.csv')
    assert done.code == 0 and re.search(r'every route, at 36\.\d{5},-84\.\d{5}, ', done.err)
    line = re.search('To find what to hold: (.*)', done.err)[1]
    words = shlex.split(line.replace('-o hold.png', f'-o {tmp_path}/h.png'))
    assert words[:3] == ['ambush', 'hold', str(file)] and '--reach 10' in line
    held = run_here(hold, *words[2:], '-k', 1)
    assert held.code == 0 and (tmp_path / 'h.png').exists(), held.err


def test_an_ambush_that_misses_one_route_of_300_is_not_certain():
    network = Network([(0, 0), (50, 9), (50, -9), (99, 0)], [0, 1, 300, 0],
                      [(0, 1), (0, 2), (1, 3), (2, 3)], 0, 3)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = solve(network, options=StrategyOptions(risk_slack=0.0))
    assert found.visit_probability[1] == pytest.approx(300 / 301)


def test_geojson_across_180_degrees_is_refused(tmp_path):
    geopandas = pytest.importorskip('geopandas', reason='GeoJSON takes the extra "gis"')
    import shapely

    from ambush_planner.route_files import Drawn, write_routes

    crs = 'EPSG:32760'
    east, north = shapely.get_coordinates(geopandas.GeoSeries([shapely.Point(180.0, -16.6)],
                                                              crs=4326).to_crs(crs))[0]
    risk_map = ground(crs, (east - 100.0, north - 50.0))
    start, goal = (tuple(np.add(at, risk_map.origin[:2])) for at in (START, GOAL))
    made = plan_trip(risk_map, start, goal, PlanningOptions(
        network=plain_options(spacing=20.0), game=GameOptions(ambush_radius=20.0)))
    drawn = Drawn(made.trip, risk_map, made.paths(3, 0), [datetime.now(timezone.utc)] * 3)
    with pytest.raises(InvalidCoordinates, match='crosses 180 degrees; write .gpkg'):
        write_routes([tmp_path / 'A.GeoJSON'], drawn)
    write_routes([tmp_path / 'A.GPKG'], drawn)
    whole = geopandas.read_file(tmp_path / 'A.GPKG', layer='routes')
    assert whole.length.sum() == pytest.approx(drawn.routes.length.sum())


@pytest.mark.parametrize(('alpha', 'edges', 'words'), [
    ([0, 1, 0, 0], [(0, 1), (0, 2), (1, 3), (2, 3)], 'the value is 0'),
    ([0, 3, 0, 0], [(0, 1), (1, 3)], 'an ambush at node 1 hits every route.*costs 3'),
])
def test_solve_warns_of_no_loss_and_of_a_certain_one(alpha, edges, words):
    network = Network(points=[(0, 0), (1, 1), (1, -1), (2, 0)], alpha=alpha, edges=edges, source=0,
                      target=3)
    with pytest.warns(AmbushPlannerWarning, match=words):
        solve(network)
