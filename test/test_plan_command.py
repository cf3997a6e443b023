# SPDX-License-Identifier: Apache-2.0
"""``ambush plan`` and ``export`` from maps to files, which other programs read; every mistake."""

import json
import re
import stat
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from commands import documented_keys, run_here

pytest.importorskip('geopandas', reason='routes in files take the extra "gis"')
pytest.importorskip('gpxpy', reason='GPX takes the extra "gis"')
pytest.importorskip('matplotlib', reason='pictures need matplotlib')

import geopandas
import gpxpy
import pyogrio
import shapely
from audit_samples import GOAL, START, parameters, record_drawn
from pyproj import CRS, Geod, Transformer
from rasters import write_geotiff

from ambush_planner import (
    InvalidOption,
    NetworkOptions,
    PlanningOptions,
    RiskMap,
    plan_trip,
    risk_from_terrain,
)
from ambush_planner.commands import draw, export, plan, risk, verify
from ambush_planner.game.ambusher import Ambusher, at_nodes
from ambush_planner.game.certificate.certificate import lower_bounds
from ambush_planner.game.strategy import make_strategies
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.risk_map_file import npz_bytes
from ambush_planner.planning import trip
from ambush_planner.recordings.plan_file import read_plan
from ambush_planner.words import of_departures

GEOD = Geod(ellps='WGS84')
FILES = ('r.gpx', 'r.gpkg', 'r.geojson', 'r.csv', 'r.png')
CELLS = 60


def write_dem(path, latitude, longitude, crs='EPSG:4326'):
    """Rolling hills of 60 x 60 cells of 3 seconds of arc, with a corner at a place."""
    row, column = np.mgrid[:CELLS, :CELLS]
    heights = 20.0 * np.sin(row / 7.0) + 15.0 * np.cos(column / 9.0) + 100.0
    step = 1 / 1200
    return write_geotiff(path, heights.astype(np.float32), crs,
                         (step, 0, longitude, 0, -step, latitude + CELLS * step))


def metres_between(one, other):
    """Distance [m] of two positions (longitude, latitude) on the ellipsoid."""
    return GEOD.inv(*one, *other)[2]


def degrees_in(folder, layer='routes'):
    """The ends (longitude, latitude) of each route by file, as other programs read them."""
    found = {}
    with open(folder / 'r.gpx') as file:
        gpx = gpxpy.parse(file)
    found['gpx tracks'] = [[(p.longitude, p.latitude) for p in track.segments[0].points]
                           for track in gpx.tracks]
    found['gpx routes'] = [[(p.longitude, p.latitude) for p in route.points]
                           for route in gpx.routes]
    found['gdal gpx'] = [line.geoms[0].coords for line in
                         pyogrio.read_dataframe(folder / 'r.gpx', layer='tracks').geometry]
    document = json.loads((folder / 'r.geojson').read_text())
    found['geojson'] = [each['geometry']['coordinates'] for each in document['features']
                        if each['properties']['layer'] == 'routes']
    table = pyogrio.read_dataframe(folder / 'r.gpkg', layer=layer)
    to_degrees = Transformer.from_crs(table.crs, 4326, always_xy=True).transform
    rows = pyogrio.read_dataframe(folder / 'r.csv', read_geometry=False)
    for name, lines in (('gpkg', table.geometry), ('csv', shapely.from_wkt(rows['WKT']))):
        found[name] = [np.transpose(to_degrees(*np.transpose(line.coords))) for line in lines]
    return found


@pytest.mark.parametrize(('latitude', 'longitude', 'zone', 'way'), [
    (36.5, -84.3, 32616, 'npz'), (-33.95, 18.5, 32734, 'yaml'), (-22.9, -43.4, 32723, 'tif'),
])
def test_the_whole_chain_is_exact_to_a_centimetre(tmp_path, latitude, longitude, zone, way):
    """From heights in degrees to files of all kinds: routes begin and end where they should."""
    dem = write_dem(tmp_path / 'dem.tif', latitude, longitude)
    ends = [(latitude + dy, longitude + dx) for dy, dx in ((0.02, 0.012), (0.033, 0.038))]
    done = run_here(risk, dem, '-o', tmp_path / 'map.yaml', '--weapon-range', 300)
    assert done.code == 0 and f'EPSG:{zone}' in done.err, done.err
    ground = tmp_path / f'map.{way}'
    if way == 'npz':
        ground.write_bytes(npz_bytes(risk_from_terrain(dem)))
    done = run_here(plan, ground, '-n', 3, '--json', '-o', *(tmp_path / f for f in FILES),
                    '--set', 'network.spacing=400',
                    '--start', '{:.9f},{:.9f}'.format(*ends[0]),
                    '--goal', '{:.9f},{:.9f}'.format(*ends[1]))
    assert done.code == 0, done.err
    for name, lines in degrees_in(tmp_path).items():
        assert len(lines) == 3, name
        for line in lines:
            assert metres_between(line[0][:2], ends[0][::-1]) < 0.01, name
            assert metres_between(line[-1][:2], ends[1][::-1]) < 0.01, name
    assert CRS(pyogrio.read_info(tmp_path / 'r.gpkg', layer='edges')['crs']).to_epsg() == zone
    result = json.loads(done.out)
    assert set(result) == documented_keys(plan) and result['lower_bound'] <= result['value']
    for name in FILES:
        assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o600
    assert (tmp_path / 'r.png').read_bytes().startswith(b'\x89PNG')
    routes = geopandas.read_file(tmp_path / 'r.gpkg', layer='routes')
    assert list(routes['departure']) == [1, 2, 3]
    np.testing.assert_allclose(routes['length'], routes.length)


@pytest.fixture
def plain(tmp_path):
    """A map without a coordinate system: 40 x 30 cells of 10 m, a block in the middle."""
    values = np.random.default_rng(0).integers(0, 60, (30, 40)).astype(np.int8)
    values[12:18, 15:25] = 100
    write_map(tmp_path / 'map.yaml', OccupancyMap(values, 10.0, (-200.0, -100.0, 0.0)))
    return tmp_path / 'map.yaml'


ENDS = ('--start', -195, -50, '--goal', 190, 105)


def test_a_map_without_a_system_keeps_its_own_metres(plain, tmp_path):
    files = [tmp_path / name for name in ('r.geojson', 'r.gpkg', 'r.csv')]
    options = ('--set', 'game.secured_radius=40', 'game.ambush_radius=30', 'network.spacing=30',
               'network.refine=0')
    done = run_here(plan, plain, *ENDS, '--via', -50, 95, '-n', 5, '-o', *files, *options)
    assert done.code == 0, done.err
    assert all(word in done.out for word in ('value', 'shortest', 'mean length', 'assumption'))
    document = json.loads(files[0].read_text())
    assert 'crs' not in document
    lines = {}
    for each in document['features']:
        lines.setdefault(each['properties'].pop('layer'), []).append(each)
    for each in lines['routes']:
        assert set(each['properties']) == {'departure', 'length', 'time'}
        along = each['geometry']['coordinates']
        assert (along[0], along[-1]) == ([-195.0, -50.0], [190.0, 105.0])  # exactly
        assert [-50.0, 95.0] in along
    layers = dict(pyogrio.list_layers(files[1]))
    assert set(layers) == set(lines) == {'routes', 'edges', 'sites', 'places', 'secured_area',
                                        'forbidden'}
    tables = {name: geopandas.read_file(files[1], layer=name) for name in layers}
    assert tables['sites']['probability'].sum() == pytest.approx(1.0, abs=1e-3)
    assert tables['forbidden'].area.sum() == 60 * 100.0
    secured = tables['secured_area'].union_all()
    inside = secured.buffer(-0.03 * 40.0)  # a site stands for places around it
    assert len(tables['secured_area']) == 3 and not inside.contains(tables['sites'].geometry).any()
    assert secured.distance(shapely.Point(-155.0, -50.0)) == pytest.approx(0.0, abs=1e-9)
    drawn_on = tables['edges'].union_all().buffer(0.3 * 40.0)  # tube and cut corners
    assert drawn_on.covers(tables['routes'].geometry).all()


FEW = ('--reach', 30, '--set', 'network.spacing=25', 'network.refine=0', '--crs', 'EPSG:32616',
       '--routes')


def test_few_routes_have_a_layer_each(plain, tmp_path):
    files = [tmp_path / name for name in FILES]
    done = run_here(plan, plain, *ENDS, *FEW, 3, '--json', '-o', *files)
    assert done.code == 0, done.err
    result = json.loads(done.out)
    few = result['few']
    count = len(few['shares'])
    assert set(result) == documented_keys(plan) and 1 < count <= 3
    assert [size for size, _ in few['curve']] == list(range(1, count + 1))
    assert few['lower_bound'] <= few['value'] == few['curve'][-1][1]
    assert set(few['draws']) == {'die', 'two dice', 'cards'} and 'path' not in done.out
    assert all(stat.S_IMODE(file.stat().st_mode) == 0o600 for file in files)
    layers = dict(pyogrio.list_layers(tmp_path / 'r.gpkg'))
    assert set(layers) == {*(f'route_{k + 1}' for k in range(count)), 'places',
                           'secured_area', 'forbidden'}
    for k, share in enumerate(few['shares'], start=1):
        row, = geopandas.read_file(tmp_path / 'r.gpkg', layer=f'route_{k}').itertuples()
        assert (row.route, row.share) == (k, share) and row.length == pytest.approx(
            row.geometry.length)
    gpx = gpxpy.parse(StringIO((tmp_path / 'r.gpx').read_text()))
    assert [track.name.split(',')[0] for track in gpx.tracks] == [
        f'Route {k + 1}' for k in range(count)]
    assert all(len(lines) == count for name, lines in degrees_in(tmp_path, layer='route_1').items()
               if name not in ('geojson', 'gpkg'))
    done = run_here(plan, plain, *ENDS, *FEW, 3, '-o', tmp_path / 'r.plan')
    assert done.code == 2 and 'leave out FILE.plan, or --routes' in done.err


def test_few_routes_of_each_leg_are_numbered_through(plain, tmp_path):
    files = [tmp_path / name for name in ('r.png', 'r.gpkg')]
    done = run_here(plan, plain, *ENDS, '--via', -50, 95, *FEW, 2, '--json', '-o', *files)
    assert done.code == 0, done.err
    few = json.loads(done.out)['few']
    layers = [name for name, _ in pyogrio.list_layers(tmp_path / 'r.gpkg') if 'route' in name]
    legs = [geopandas.read_file(tmp_path / 'r.gpkg', layer=name)['leg'][0] for name in layers]
    assert legs == few['legs'] == sorted(legs) and 2 <= len(legs) <= 4
    assert set(legs) == {1, 2} and sum(few['shares']) == pytest.approx(2.0)


SLOTS = ('--slots', '8:00', '09:30', '11:00', '--window', 2)


def test_departures_have_slots_and_files_name_them(plain, tmp_path):
    done = run_here(plan, plain, *ENDS, '--crs', 'EPSG:32616', '-n', 40, *SLOTS, '--json', '-o',
                    *(tmp_path / name for name in FILES))
    assert done.code == 0, done.err
    result = json.loads(done.out)
    slots = result['slots']
    assert set(result) == documented_keys(plan) and slots['shares'] == {
        '08:00': pytest.approx(0.5), '09:30': 0.0, '11:00': pytest.approx(0.5)}
    for name in ('value', 'lower_bound'):
        assert slots[name] == result[name], 'the number that the console prints'
    said = ' '.join(run_here(plan, plain, *ENDS, *SLOTS, '-o', tmp_path / 's.csv').out.split())
    hit = result['best_ambush']['hit']
    words = f'the best ambush hits {of_departures(hit)}, at '
    assert words in said and f'({of_departures(2 * hit)} if he' in said
    assert set(slots['drawn']) == {'08:00', '11:00'} and len(slots['drawn']) == 40
    assert list(geopandas.read_file(tmp_path / 'r.gpkg', layer='routes')['slot']) == slots['drawn']
    assert list(pyogrio.read_dataframe(tmp_path / 'r.csv')['slot']) == slots['drawn']
    names = [f'Departure {k}, {slot}' for k, slot in enumerate(slots['drawn'], start=1)]
    gpx = gpxpy.parse(StringIO((tmp_path / 'r.gpx').read_text()))
    assert [track.name for track in gpx.tracks] == names


def test_a_plan_file_draws_a_slot_too(plain, tmp_path):
    done = run_here(plan, plain, *ENDS, *FEW[:-1], *SLOTS, '-o', tmp_path / 'r.plan')
    assert done.code == 0 and re.search(r'slots +08:00 50 %, 09:30 0 %, 11:00 50 %', done.out)
    saved = read_plan(tmp_path / 'r.plan')
    assert saved.slots.times == ('08:00', '09:30', '11:00') and saved.slots.window == 2
    assert f'value           {saved.value:.4g}:' in done.out
    assert f'ambush draw {tmp_path}/r.plan' in done.out
    assert re.search(r', (08:00|11:00): [\d.]+ m', run_here(draw, tmp_path / 'r.plan').out)


def test_a_wide_gap_saves_no_plan_unless_it_is_accepted(plain, tmp_path, monkeypatch):
    """A plan whose ambusher proves little, as when the time is up."""
    def late(*arguments, **options):
        made = plan_trip(*arguments, **options)
        (leg,), legs = made.legs, made.trip.joint
        shares = np.ones(len(leg.game.sites))
        anywhere = Ambusher(at_nodes(leg.game, shares), (0.0,))
        weak = make_strategies(legs, leg.edge_probability, [leg.mixture], anywhere,
                               lower_bounds(legs, anywhere))
        return replace(made, trip=replace(weak, reason='time'))

    monkeypatch.setattr(trip, 'plan_trip', late)
    file, asked = tmp_path / 'r.plan', ('--set', 'network.refine=0', 'network.target_nodes=200')
    done = run_here(plan, plain, *ENDS, *asked, '-o', file, tmp_path / 'r.png')
    assert done.code == 1 and 'no plan was saved' in done.err
    assert 'more than 10% (strategy.max_gap); the time limit ended the search' in done.err
    assert (tmp_path / 'r.png').exists() and not file.exists()
    done = run_here(plan, plain, *ENDS, *asked, '-o', file, '--accept-gap')
    assert done.code == 1 and file.exists()
    done = run_here(draw, file)
    assert done.code == 1 and 'more than 10% (strategy.max_gap)' in done.err
    assert (tmp_path / 'r.departures').exists()
    done = run_here(verify, tmp_path / 'r.departures')
    assert done.code == 0 and 'and was accepted' in ' '.join(done.out.split()), done.out


def test_a_trip_says_what_it_adds_up_and_what_the_first_hit_costs(plain, tmp_path):
    here, there = (-195.0, -50.0), (190.0, 105.0)
    there_and_back = '--start', *here, '--goal', *here, '--via', *there
    done = run_here(plan, plain, *there_and_back, '--reach', 20, '--secured', 40, '--set',
                    'network.refine=0', 'network.target_nodes=200', '--json',
                    '-o', tmp_path / 'r.plan', tmp_path / 'r.png')
    assert done.code == 0, done.err
    result, made = json.loads(done.out), read_plan(tmp_path / 'r.plan').plan
    assert 0.5 * result['value'] <= result['first_hit_value'] < result['value']
    assert (made.value, made.trip.first_hit_value) == pytest.approx(
        (result['value'], result['first_hit_value']))
    assert len(made.legs) == 2 and made.ends_xy == (here, there, here)


def test_routes_are_fresh_unless_a_seed_is_given(plain, tmp_path):
    def run(*seed):
        done = run_here(plan, plain, *ENDS, '-n', 3, '-o', tmp_path / 'r.csv', *seed,
                        '--set', 'network.spacing=20')
        assert done.code == 0
        return (pyogrio.read_dataframe(tmp_path / 'r.csv', read_geometry=False)['WKT'].tolist(),
                'can predict' in done.err)

    assert run('--seed', 1) == run('--seed', 1) and run('--seed', 1)[1]
    one, other = run(), run()
    assert one[0] != other[0] and not one[1]


@pytest.mark.parametrize(('arguments', 'code', 'reason'), [
    (('--start', '36.5,-84.2'), 2, '36.5,-84.2 is a latitude and longitude, but the coordinate '
                                   'system of the map is unknown'),
    (('--start', 5000, 5), 2, 'start 5000 5 is outside the map'),
    (('--start', '36.6,-84.2', '--crs', 'EPSG:32616'), 2, r'36.6,-84.2 is outside .*\(latitude'),
    (('--crs', 'EPSG:4326', '-o', 'r.gpx'), 2, 'the unit of a map must be the metre'),
    (('--crs', 'EPSG:99'), 2, "not a coordinate system: 'EPSG:99'"),
    (('--start', 0, 50), 2, r'start .* lies in an obstacle; move it to \(-?\d'),
    (('--set', 'max_planning_time=5'), 2, 'strategy.time_limit'),
    (('--set', 'game.ambush_radius=far'), 2, "--reach must be a number, got 'far'"),
    (('-o', 'r.gpx'), 2, 'GPX holds latitude and longitude, but'),
    (('-o', 'r.shp'), 2, 'suffix must be one of .plan, .gpkg'),
    (('--start', 'here'), 2, r'--start: must be X Y .*LAT,LON .*MGRS.* got here'),
    (('--start', 1, 2, 3, 4), 2, '--start: must be one position'),
    (('--routes', 0), 2, 'must be a number from 1 to 100'),
    (('--routes', 3), 2, r'\(--reach\) must be over 0: paths are judged by what'),
    (('--routes', 100, '--reach', 30, '--detour', 1, '--set', 'network.spacing=60',
      'network.refine=0'), 2,
     r'routes must be from 1 to \d+: of 1000 drawn routes, \d+ are different; got 100'),
    (('--routes', 3, '-n', 3), 2, 'not allowed with argument'),
    (('--window', 2), 2, '--window needs --slots HH:MM'),
    (('--slots', '8:00', '7:00'), 2, '--slots must go forwards in time, but 07:00 follows 08:00'),
    (('--slots', 'noon'), 2, "argument --slots: must be HH:MM, got 'noon'"),
    (('--reach', '0.3furlongs'), 2, "--reach must be a number, got '0.3furlongs'"),
    (('--reach', -3), 2, '--reach must be'),
    (('--set', 'network.spacing=-1'), 2, '--set network.spacing must be'),
    (('--set', 'network.graph=a.gpkg'), 2, 'no effect without .*network.method=graph'),
    (('--node-crossings',), 2, '--node-crossings has no effect without roads'),
    (('--two-way',), 2, '--two-way has no effect without roads'),
    (('--reach', '0,5km'), 2, "--reach must be a number, with a decimal point, got '0,5km'"),
    (('--terrain',), 2, '--terrain was removed: make a risk map of the elevation model'),
])
def test_mistakes_are_named_and_nothing_is_written(plain, tmp_path, monkeypatch, arguments, code,
                                                   reason):
    monkeypatch.chdir(tmp_path)
    if '--start' in arguments:
        arguments = (*arguments, *ENDS[3:])
    else:
        arguments = (*ENDS, *arguments)
    before = sorted(tmp_path.iterdir())
    done = run_here(plan, plain, *(() if '-o' in arguments else ('-o', 'r.geojson')), *arguments)
    assert done.code == code and re.search(reason, done.err), done.err
    assert 'Traceback' not in done.err and sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize('start', ['18.5,-33.95', '33.95,18.5', '-18.5,33.95'])
def test_latitude_and_longitude_of_another_order_or_sign_get_a_hint(plain, tmp_path, start):
    datum = ('--crs', 'datum -33.95 18.5 0')
    done = run_here(plan, plain, '--start', start, *ENDS[3:], *datum, '-o', tmp_path / 'r.csv')
    assert done.code == 2 and 'did you mean -33.95,18.5?' in done.err, done.err
    assert done.err.count('\n') == 1


def test_a_position_can_be_an_mgrs_reference(tmp_path):
    grid = OccupancyMap(np.full((40, 40), 20), 10.0, (734800.0, 4046900.0, 0.0), 'EPSG:32616')
    write_map(tmp_path / 'm.yaml', grid)
    done = run_here(plan, tmp_path / 'm.yaml', '--start', '16S', 'GF', '34950', '47050', '--goal',
                    '16SGF3510047150', '-o', tmp_path / 'r.csv')
    assert done.code == 0, done.err
    first = (tmp_path / 'r.csv').read_text().splitlines()[1]
    x, y = map(float, re.search(r'\((\S+) ([^,]+)', first).groups())
    assert (x, y) == pytest.approx((734950.0, 4047050.0), abs=1.0)


def test_recorded_departures_are_exported(tmp_path):
    """Recorded paths with their times, in the coordinate system of the node or of --crs."""
    record_drawn(tmp_path / 'in', 3,
                 entries={'parameters': parameters(**{'map.crs': 'EPSG:32616'})})
    files = tmp_path / 'r.gpkg', tmp_path / 'r.png'
    done = run_here(export, tmp_path / 'in', '--json', '-o', *files)
    assert done.code == 0 and set(json.loads(done.out)) == documented_keys(export), done.err
    routes = geopandas.read_file(tmp_path / 'r.gpkg', layer='routes')
    assert routes.crs.to_epsg() == 32616
    assert [str(time)[:10] for time in routes['time']] == ['2023-11-15', '2023-11-16', '2023-11-17']
    for line in routes.geometry:
        assert (line.coords[0], line.coords[-1]) == (START, GOAL)
    done = run_here(export, tmp_path / 'in', '-o', tmp_path / 'r.gpx', '--crs', 'datum 60.4 5.3 0')
    assert done.code == 0
    point = gpxpy.parse(StringIO((tmp_path / 'r.gpx').read_text())).tracks[2].segments[0].points[0]
    assert metres_between((5.3, 60.4), (point.longitude, point.latitude)) == pytest.approx(
        np.hypot(*START), rel=5e-4)


def test_a_plan_saves_itself_and_the_routes_that_it_returns(tmp_path):
    ground = RiskMap(np.ones((20, 30)), np.zeros((20, 30), bool), 10.0)
    options = PlanningOptions(network=NetworkOptions(spacing=40.0))
    made = plan_trip(ground, (25.0, 95.0), (275.0, 95.0), options)
    paths = made.save(tmp_path / 'r.csv', str(tmp_path / 'r.png'), n=3)
    lines = pyogrio.read_dataframe(tmp_path / 'r.csv', read_geometry=False)['WKT']
    assert [shapely.from_wkt(line).coords[:] for line in lines] == [
        pytest.approx(path[:, :2], abs=1e-4) for path in paths]
    assert stat.S_IMODE((tmp_path / 'r.png').stat().st_mode) == 0o600
    with pytest.raises(InvalidOption, match=r'\.shp.*\.gpkg'):
        made.save(tmp_path / 'r.shp')
    straight = 250.0
    assert straight <= made.driven_length < made.strategy.expected_length
    for n in (-1, 1.5):
        with pytest.raises(InvalidOption, match='n must be a whole number'):
            made.paths(n)
    made.save(tmp_path / 'r.plan', n=0)
    assert read_plan(tmp_path / 'r.plan').plan.value == made.value
