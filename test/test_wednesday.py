# SPDX-License-Identifier: Apache-2.0
"""The ground changes in the middle of the week, and two people share a plan."""

import json
import os
import shutil
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run_here
from rasters import write_geotiff
from test_path_mixtures import GOAL, START, ground
from test_week import OPTIONS, copy_of, plans, roads  # noqa: F401 (a fixture)

from ambush_planner import plan_trip
from ambush_planner.commands import audit, draw, report, risk, verify
from ambush_planner.commands import plan as plan_command
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.occupancy import OccupancyMap, OccupancyOptions, risk_from_occupancy
from ambush_planner.maps.risk_map_file import npz_bytes
from ambush_planner.planning.changed_ground import ChangedGround
from ambush_planner.planning.new_ground import NewGround
from ambush_planner.recordings.plan_file import plan_bytes, read_plan, saved_plan
from ambush_planner.recordings.recorded_departure import read_departure

pytest.importorskip('matplotlib', reason='cards and reports have pictures')


def drawn_from(plans, name, folder, days=6, plan_name='week'):  # noqa: F811
    """The plan's file in a folder, and its departures on as many days."""
    file = folder / f'{plan_name}.plan'
    file.write_bytes(plans[name][1].read_bytes())
    done = run_here(draw, file, '--days', days, '--date', '2040-01-01')
    assert done.code == 0, done.err
    return file, sorted((folder / f'{plan_name}.departures').iterdir())


@pytest.mark.parametrize('name', ['routes', 'stops', 'roads'])
def test_on_its_own_ground_a_plan_is_clear_and_costs_the_same(plans, name):  # noqa: F811
    plan, file = plans[name]
    before = NewGround(plan.own_map, read_plan(file).parameters.planning.network.roads)
    found = replace(before).assess(plan.drawn_from, before, plan.options)
    assert (found.value, found.clear_share) == pytest.approx((plan.value, 1.0), rel=1e-9)
    for path in plan.paths(20, 1):
        assert replace(before).blocked(path, before, plan.options.network) is None


@pytest.mark.parametrize('reach', [0.0, 2.5])
def test_new_losses_cost_what_they_do_on_a_changed_map_and_new_obstacles_block_routes(reach):
    values = np.rint(10.0 * (ground().alpha - 1.0)).astype(np.int8)
    options = replace(OPTIONS, game=replace(OPTIONS.game, ambush_radius=reach))
    plan = plan_trip(risk_from_occupancy(values, 1.0), START, GOAL, options)
    changed, before = values.copy(), NewGround(plan.own_map)
    changed[0:10, 28:34] = 90
    wanted = ChangedGround(plan, OccupancyMap(values, 1.0), OccupancyOptions()).assess(
        OccupancyMap(changed, 1.0))
    found = NewGround(risk_from_occupancy(changed, 1.0)).assess(plan.trip, before, options)
    assert (found.value, found.lower_bound, found.clear_share) == pytest.approx(
        (wanted.value, wanted.lower_bound, 1.0))
    assert found.value > 1.05 * plan.value
    changed[4:16, 18:20] = 100
    now = NewGround(risk_from_occupancy(changed, 1.0))
    share, field = now.assess(plan.trip, before, options).clear_share, ObstacleField(
        now.risk_map)
    routes = [plan.network.points[route] for route in plan.strategy.sample_routes(400, 1)]
    clear = [field.clear_segments(points[:-1], points[1:], 0.0).all() for points in routes]
    assert np.mean(clear) == pytest.approx(share, abs=0.1) and 0.02 < share < 0.98
    for path in plan.paths(30, 1):
        blocked = now.blocked(path, NewGround(plan.own_map), options.network)
        clear = field.clear_segments(path[:-1, :2], path[1:, :2], 0.0)
        assert (blocked is None) == clear.all()
        if blocked:
            assert abs(blocked.xy[0] - 19.0) < 4.0 and 5.0 < blocked.along < 60.0


def test_verify_says_which_departures_are_not_clear_on_a_new_map(plans, tmp_path):  # noqa: F811
    file, found = drawn_from(plans, 'routes', tmp_path, 12)
    wall = ground().obstacles.copy()
    wall[10:, 20] = True
    (tmp_path / 'new.npz').write_bytes(npz_bytes(replace(ground(), obstacles=wall)))
    done = run_here(verify, tmp_path / 'week.departures', '--map', tmp_path / 'new.npz', '--json')
    rows = json.loads(done.out)['departures']
    crossing = [(np.diff(read_departure(path).path_poses[:, 0] > 20.5) != 0) & (
        read_departure(path).path_poses[1:, 1] > 9.9) for path in found]
    assert [row['now']['clear'] for row in rows] == [not each.any() for each in crossing]
    assert done.code == 1 and all(row['holds'] for row in rows)
    assert len({row['now']['clear'] for row in rows}) == 2, 'some are'
    assert len({row['now']['value'] for row in rows}) == 1
    text = run_here(verify, tmp_path / 'week.departures', '--map', tmp_path / 'new.npz').out
    assert 'now: clear; value ' in text and 'now: BLOCKED at (20.' in text
    blocked = sum(not row['now']['clear'] for row in rows)
    assert f'{blocked} of 12 departures: not clear on the new ground' in text
    done = run_here(verify, file, '--map', tmp_path / 'new.npz')
    assert done.code == 1 and 'plan of 20' in done.out and 'of the routes of its plan' in done.out
    done = run_here(verify, file)
    assert done.code == 0 and '1 plan: all hold' in done.out


def ladder(pairs):
    """Roads in the directions of pairs of places, as a graph of nav2_route in the map's metres."""
    points = roads().points
    lines = [('Point', {'id': k}, each) for k, each in enumerate(points.tolist())]
    lines += [('MultiLineString', {'id': 100 + k, 'startid': a, 'endid': b},
               [points[[a, b]].tolist()]) for k, (a, b) in enumerate(pairs)]
    return json.dumps({'type': 'FeatureCollection', 'features': [
        {'type': 'Feature', 'properties': properties,
         'geometry': {'type': kind, 'coordinates': coordinates}}
        for kind, properties, coordinates in lines]})


@pytest.mark.parametrize('closed', ['away', 'one-way'])
def test_verify_says_which_departures_are_not_clear_on_new_roads(plans, closed,  # noqa: F811
                                                                 tmp_path):
    pytest.importorskip('geopandas', reason='roads in files need the extra "gis"')
    file, found = drawn_from(plans, 'roads', tmp_path, 12)
    gone = 11, 12  # in the uppermost row, from left to right
    pairs = {each for a, b in roads().pairs.tolist() for each in ((a, b), (b, a))} - {gone}
    (tmp_path / 'r.geojson').write_text(ladder(sorted(
        pairs - {gone[::-1]} if closed == 'away' else pairs)))
    done = run_here(verify, tmp_path / 'week.departures', '--roads', tmp_path / 'r.geojson',
                    '--json')
    assert done.out, done.err
    rows = json.loads(done.out)['departures']
    middle = roads().points[[*gone]].mean(axis=0)
    use = [np.hypot(*(read_departure(path).path_poses[:, :2] - middle).T).min() < 3.0
           for path in found]
    assert [not row['now']['clear'] for row in rows] == use and len(set(use)) == 2
    share = rows[0]['now']['clear_share']
    assert 0.0 < share < 1.0 and done.code == 1
    done = run_here(verify, file, '--roads', tmp_path / 'r.geojson', '--json')
    assert json.loads(done.out)['departures'][0]['now']['clear_share'] == share


def planned(folder, *more):
    """A plan of the command on a map of ``ambush risk`` in a folder."""
    heights = np.random.default_rng(1).normal(0.0, 1.0, (40, 60)).cumsum(axis=0)
    write_geotiff(folder / 'dem.tif', heights, None, (10.0, 0.0, 0.0, 0.0, -10.0, 400.0))
    assert run_here(risk, folder / 'dem.tif', '-o', folder / 'maps/m.yaml').code == 0
    return run_here(plan_command, folder / 'maps/m.yaml', '--start', 50, 200, '--goal', 550, 200,
                    '--reach', 40, '--set', 'network.refine=0', 'network.spacing=30', '-o',
                    folder / 'week/w.plan', *more)


@pytest.fixture
def week(tmp_path):
    """A folder with a map, and a plan in another folder."""
    for name in ('maps', 'week'):
        (tmp_path / name).mkdir()
    done = planned(tmp_path)
    assert done.code in (0, 1), done.err
    return tmp_path


def test_draw_says_what_changed_or_is_gone_and_draws_nothing(week):
    file = week / 'week/w.plan'
    assert run_here(draw, file, '--dry-run').code == 0
    sources = {each.name: each.role for each in read_plan(file).sources}
    assert sources == {'../maps/m.yaml': 'map', '../maps/m.pgm': 'map', '../dem.tif': 'layer'}
    # Neither the plan nor its departures tell where they were made.
    assert run_here(draw, file).code == 0
    for path in (file, *(week / 'week/w.departures').iterdir()):
        assert str(week.parent) not in str(read_departure_entries(path))
    for name, change, words in (
            ('maps/m.pgm', lambda path: path.write_bytes(path.read_bytes()[:-1] + b'\0'),
             'm.pgm has changed, the map'),
            ('dem.tif', lambda path: path.write_bytes(b'new heights'), 'dem.tif has changed, the '
             'layer'),
            ('maps/m.yaml', Path.unlink, 'm.yaml is gone, the map')):
        whole = (week / name).read_bytes()
        change(week / name)
        before = sorted(week.rglob('*.mcap'))
        done = run_here(draw, file, '--date', '2040-01-01')
        assert done.code == 1 and words in done.err and 'Nothing was drawn' in done.err
        assert sorted(week.rglob('*.mcap')) == before
        done = run_here(draw, file, '--dry-run', '--ground-unchanged')
        assert done.code == 0 and f'{words}' in done.err
        (week / name).write_bytes(whole)
    (week / 'maps').rename(week / 'elsewhere')
    assert run_here(draw, file, '--dry-run').code == 1
    assert run_here(draw, file, '--dry-run', '--map', week / 'elsewhere/m.yaml').code == 0


def read_departure_entries(path):
    from ambush_planner.recordings.recording_file import read_recording

    return read_recording(path).entries


def test_a_plan_with_departures_is_not_overwritten(week):
    assert run_here(draw, week / 'week/w.plan').code == 0
    before = (week / 'week/w.plan').read_bytes()
    done = planned(week)
    assert done.code == 2 and 'a plan with 1 departure (' in done.err and '--overwrite' in done.err
    assert (week / 'week/w.plan').read_bytes() == before
    assert planned(week, '--overwrite').code in (0, 1)
    assert (week / 'week/w.plan').read_bytes() != before


def test_two_departures_of_one_plan_for_one_day_are_named(plans, tmp_path):  # noqa: F811
    """Drawn from copies elsewhere, whose folders are then put together."""
    day, both = ('--date', '2040-01-01', '--slot', '8:00'), tmp_path / 'both'
    for name in ('anna', 'ben'):
        (tmp_path / name).mkdir()
        file = copy_of(plans, 'routes', tmp_path / name)
        assert run_here(draw, file, *day).code == 0
        assert name == 'ben' or run_here(draw, file, '--days', 4, '--date', '2040-01-02').code == 0
        shutil.copytree(tmp_path / name / 'week.departures', both / f'{name}.departures')
    for command, code in ((verify, 1), (audit, 1)):
        done = run_here(command, both)
        text = ' '.join(done.out.split())
        assert done.code == code and 'departures of one plan for 2040-01-01' in text
        assert 'copies of the plan' in text
    again = run_here(draw, tmp_path / 'anna/week.plan', *day, '--earlier', 'driven')
    assert again.code == 0, again.err
    done = run_here(verify, tmp_path / 'anna/week.departures')
    text = ' '.join(done.out.split())
    assert done.code == 0 and 'was said to have been driven, too' in text


def test_a_new_plan_strikes_departures_of_the_old_one_and_says_why(plans, tmp_path):  # noqa: F811
    drawn_from(plans, 'routes', tmp_path, 3)
    slot = read_departure(tmp_path / 'week.departures/0002_2040-01-02.mcap').metadata.day.slot
    other = tmp_path / 'new.plan'
    other.write_bytes(plan_bytes(saved_plan(plans['held'][0])))
    day = (other, '--date', '2040-01-02', '--slot', slot)
    done = run_here(draw, *day)
    assert done.code == 2 and 'was drawn at' in done.err and '--earlier unused' in done.err
    assert run_here(draw, *day, '--earlier', 'driven', '--why', 'x').code == 2
    done = run_here(draw, *day, '--earlier', 'unused', '--why', 'the bridge is out')
    assert done.code == 0, done.err
    for command, more in ((verify, ()), (report, ('-o', tmp_path / 'out'))):
        done = run_here(command, tmp_path, *more, '--json')
        assert list(json.loads(done.out)['struck'].values()) == ['the bridge is out']
    text = ' '.join(run_here(verify, tmp_path).out.split())
    assert 'Struck as unused: 0002_2040-01-02 (the bridge is out) (1 of 4).' in text
    assert 'until he likes' not in text


def test_a_shared_folder_is_shared_and_a_closed_file_is_no_forgery(plans, tmp_path,  # noqa: F811
                                                                   monkeypatch):
    shared = tmp_path / 'shared'
    shared.mkdir()
    shared.chmod(0o2770)
    mask = os.umask(0o077)
    try:
        file, found = drawn_from(plans, 'routes', shared, 2)
        done = run_here(draw, file, '--date', '2041-01-01', '-o', shared / 'card.html')
    finally:
        os.umask(mask)
    assert f'secret, so only the group {shared.group()} can read them' in done.out
    for path in (*found, shared / 'card.html'):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    assert stat.S_IMODE((shared / 'week.departures').stat().st_mode) == 0o2770
    read = Path.read_bytes

    def closed(path):
        if path == found[0]:
            raise PermissionError(13, 'Permission denied')
        return read(path)

    monkeypatch.setattr(Path, 'read_bytes', closed)
    done = run_here(verify, shared / 'week.departures')
    assert done.code == 3 and f'CLOSED  {found[0].name}' in done.out.replace('CLOSED ', 'CLOSED ')
    assert '1 of 3 departures: no permission to read' in done.out
    assert '2 of 3 departures: all hold' in done.out and 'not consistent' not in done.out
