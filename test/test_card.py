# SPDX-License-Identifier: Apache-2.0
"""``ambush card``: legs of a path, and a page that tells of one departure only."""

import os
import re
import shutil
import subprocess
from base64 import b64decode
from datetime import datetime
from io import BytesIO
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from audit_samples import drawn, parameters, record_drawn, sample_plan
from commands import run_here
from games import examples, plain_options
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from ambush_planner import GameOptions, PlanningOptions, plan_trip
from ambush_planner.commands import card, card_page, draw
from ambush_planner.commands.card_map import card_map
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.maps.road_file import RoadGraph
from ambush_planner.recordings.plan_file import plan_bytes, saved_plan
from ambush_planner.routes.legs import (
    MAX_LEGS,
    bearings,
    corners_of_legs,
    distances_along,
    secured_stretches,
)
from ambush_planner.routes.way_points import WayPoint

FRAME = 'datum 36.6 -84.3 0.2'
BINARY = next(filter(None, map(shutil.which, (
    'chromium', 'chromium-browser', 'google-chrome'))), None)
NO_STOPS = np.empty((0, 2))
PLACES = st.tuples(*2 * [st.integers(-50, 50)])


@examples(40)
@given(st.lists(PLACES, min_size=2, max_size=40, unique=True), st.integers(0, 39))
def test_legs_add_up_and_pass_the_stops(path, stop):
    path = np.array(path, float)
    at = corners_of_legs(path, path[[stop % len(path)]])
    assert {0, stop % len(path), len(path) - 1} <= set(at) and len(at) <= MAX_LEGS + 1
    lengths = np.diff(distances_along(path)[at])
    assert np.all(lengths > 0.0)
    assert lengths.sum() == pytest.approx(np.hypot(*np.diff(path, axis=0).T).sum())


def test_corners_are_way_points_and_bearings_are_clockwise_from_y():
    path = np.array([(0, 0), (0, 5), (0, 10), (5, 10), (10, 10), (10, 0)], float)
    at = corners_of_legs(path, NO_STOPS)
    assert at.tolist() == [0, 2, 4, 5] and distances_along(path)[at].tolist() == [0, 10, 20, 30]
    assert bearings(path[at]).tolist() == [0, 90, 180]


def test_the_secured_area_is_where_the_path_is_near_a_place():
    path = np.array([(0, 0), (100, 0)], float)
    stretches = secured_stretches(path, np.array([(0, 0), (50, 6), (100, 0)], float), 10.0)
    np.testing.assert_allclose(stretches, [(0, 10), (42, 58), (90, 100)], atol=0.05)


@pytest.fixture(scope='module')
def runs(tmp_path_factory):
    """Recordings of three departures, the first one also in a known frame, and their paths."""
    plan, folder = sample_plan(), tmp_path_factory.mktemp('runs')
    record_drawn(folder / 'plain', 3)
    record_drawn(folder / 'known', 1, entries={'parameters': parameters(**{'map.crs': FRAME})})
    return folder, [plan.network.points[route] for route in drawn(plan, 3)]


def written(recording, folder, *options):
    """The text of a card, and its table: a list of cells for each way point."""
    done = run_here(card, recording, '-o', folder / 'card.html', *options)
    assert done.code == 0, done.err
    page = (folder / 'card.html').read_text()
    return page, rows_of(page)


def rows_of(page):
    rows = re.findall(r'<tr>(<td.*?)</tr>', page)
    return [re.findall('<td[^>]*>(.*?)</td>', row) for row in rows]


def test_a_card_tells_of_its_departure_only(runs, tmp_path):
    folder, routes = runs
    page, rows = written(folder / 'plain/run_1.mcap', tmp_path, '--speed', 3.6, '--start-time',
                         '23:59')
    assert (tmp_path / 'card.html').stat().st_mode & 0o777 == 0o600
    places = np.array([row[1].split() for row in rows], float)
    assert all(np.hypot(*(routes[1] - place).T).min() < 0.1 for place in places)
    others = {f'{x:.1f} {y:.1f}' for k in (0, 2) for x, y in routes[k]}
    assert others - {f'{x:.1f} {y:.1f}' for x, y in routes[1]}
    text = re.sub('base64,[^"]*', '', page)
    assert not any(place in text for place in others - {row[1] for row in rows})
    assert not re.search(r'probab|ambush|\bvalue|loss|run_|strategy', text, re.IGNORECASE)
    # One metre a second: legs add up to the length, and times pass midnight.
    length = round(np.hypot(*np.diff(routes[1], axis=0).T).sum())
    assert sum(int(row[3]) for row in rows[:-1]) == int(rows[-1][4]) == pytest.approx(length, abs=1)
    assert '23:59 to 00:0' in page and 'local time' in page
    assert rows[0][5] == '23:59' and rows[-1][5] == f'00:0{round(length / 60) - 1}'
    assert 'Secured area (circles), 40 m around start and goal: 0 to 4' in page


def test_grid_references_agree_with_pyproj(runs, tmp_path):
    pyproj = pytest.importorskip('pyproj', reason='coordinate systems take the extra "gis"')
    mgrs = pytest.importorskip('mgrs', reason='MGRS takes the extra "gis"')
    _, rows = written(runs[0] / 'known/run_0.mcap', tmp_path, '--speed', 36)
    degrees = pyproj.Transformer.from_crs('EPSG:4326', 'EPSG:32616')
    path = np.transpose(degrees.transform(*Coordinates(FRAME).to_lat_lon(runs[1][0]).T))
    for _, square, lat_lon, *_ in rows:
        latitude, longitude = map(float, lat_lon.split(', '))
        place = degrees.transform(latitude, longitude)
        assert np.hypot(*(path - place).T).min() < 1.5  # rounded
        np.testing.assert_allclose(mgrs.MGRS().toLatLon(square.replace(' ', '')),
                                   (latitude, longitude), atol=3e-5)
    # True bearings differ from those of the grid by the convergence of the meridians.
    grid = bearings(path[corners_of_legs(path, NO_STOPS)])
    turned = (np.array([int(row[3][:-1]) for row in rows[:-1]]) - grid + 180.0) % 360.0 - 180.0
    assert np.ptp(turned) < 1.5 and rows[-1][-1] == f'{float(rows[-1][-2]) / 600.0:.1f}'


@pytest.fixture
def road_plan(tmp_path):
    """A plan on one road of 1 km at 18 km/h, and 1 km at 72 km/h after a crossing, as a file."""
    north = 4_000_000.0
    points = 500_000.0 + np.array([(100.0, 0.0), (1100.0, 0.0), (2100.0, 0.0), (1100.0, 300.0),
                                   (1100.0, -300.0)])
    points[:, 1] += north - 500_000.0
    roads = RoadGraph(points, np.array([(0, 1), (1, 2), (1, 3), (1, 4)]),
                      np.array([(5.0, 5.0), (20.0, 20.0), (9.0, 9.0), (9.0, 9.0)]), True, '',
                      ('Slow & Old', 'Fast', 'Side', 'Elm'), np.array([0, 1, 2, 2]),
                      np.array([(500_400.0, north + 100.0, 3)]))
    ground = RiskMap(np.ones((70, 230)), np.zeros((70, 230), bool), 10.0,
                     (500_000.0, north - 350.0, 0.0), 'EPSG:32631')
    plan = plan_trip(ground, points[0], points[2], PlanningOptions(
        network=plain_options(method='graph', graph=roads, spacing=100.0),
        game=GameOptions(ambush_radius=50.0)))
    file = tmp_path / 'road.plan'
    file.write_bytes(plan_bytes(saved_plan(plan, names=('Depot', 'Camp <1>'))))
    return file


def test_a_card_on_roads_has_turns_names_and_the_times_of_the_roads(road_plan, tmp_path):
    pytest.importorskip('pyproj', reason='coordinate systems take the extra "gis"')
    gpxpy = pytest.importorskip('gpxpy', reason='GPX takes the extra "gis"')
    drawn = run_here(draw, road_plan, '-o', tmp_path / 'c.html', tmp_path / 'c.gpx', '--date',
                     '2030-07-01', '--slot', '6:00')
    assert drawn.code == 0, drawn.err
    page = (tmp_path / 'c.html').read_text()
    assert 'Departure 1, 2030-07-01' in page and 'TRAINING' not in page
    zone = f'{datetime(2030, 7, 1, 6).astimezone():%z}'
    assert f'06:00 to 06:04 local time, UTC{zone[:3]}:{zone[3:]}' in page
    assert 'Start 316 m from Elm, goal' in page and 'do not look for another one' in page
    table = rows_of(page)
    assert [row[:2] for row in table] == [
        ['1 start Depot', 'east: Slow &amp; Old'], ['2', 'straight on: Fast'],
        ['3 goal Camp &lt;1&gt;', '']]
    assert [row[-1] for row in table] == ['06:00', '06:03', '06:04'], '200 s and 250 s'
    # The receiver has the same points; the path keeps within a metre of the road.
    file = gpxpy.parse((tmp_path / 'c.gpx').read_text())
    names = ['01 start Depot, east: Slow & Old', '02 straight on: Fast', '03 goal Camp <1>']
    for found in (file.waypoints, [each for each in file.routes[0].points if each.name]):
        assert [each.name for each in found] == names
        for each, row in zip(found, table, strict=True):
            degrees = next(cell for cell in row if ', ' in cell and '.' in cell)
            assert [each.latitude, each.longitude] == pytest.approx(
                [*map(float, degrees.split(', '))], abs=6e-6)
    again = run_here(card, *(tmp_path / 'road.departures').iterdir(), '-o', tmp_path / 'd.html')
    assert again.code == 0 and rows_of((tmp_path / 'd.html').read_text()) == table


def test_the_map_of_a_card_is_true_to_scale_and_shows_its_ground():
    """Places of the picture are those of the world, also on a turned map."""
    obstacles, alpha = np.zeros((40, 60), bool), np.ones((40, 60))
    obstacles[:4, 50:], alpha[30:] = True, 5.0
    ground = RiskMap(alpha, obstacles, 10.0, (100.0, 200.0, 0.1))
    path = ground.to_world([(50.0, 50.0), (300.0, 60.0), (500.0, 330.0)])
    departure = card_page.Card(path, ground, path[[0, -1]], 40.0, [
        WayPoint(xy, 0.0, name) for xy, name in zip(path, ('start', '', 'goal'), strict=True)],
        None, None, None, 'Test')
    made = card_map(departure, 100.0)
    root = ElementTree.fromstring(made.svg)
    tag = '{http://www.w3.org/2000/svg}'
    (line,) = (each for each in root.iter(f'{tag}polyline') if each.get('class') == 'route')
    drawn = np.array([pair.split(',') for pair in line.get('points').split()], float)
    metres = float(made.scale.removeprefix('1:').replace(' ', '')) / 1000.0
    np.testing.assert_allclose(np.diff(drawn, axis=0) * (metres, -metres), np.diff(path, axis=0),
                               atol=0.02 * metres)
    radii = [float(each.get('r')) for each in root.iter(f'{tag}circle')
             if each.get('class') == 'secured']
    assert radii == pytest.approx([40.0 / metres] * 2, abs=0.01)
    names = {each.text for each in root.iter(f'{tag}text')}
    assert {'1 start', '2', '3 goal', '400 m'} <= names and 'N' not in names, names
    picture = root.find(f'{tag}image')
    pixels = np.asarray(Image.open(BytesIO(b64decode(picture.get('href').partition(',')[2])))
                        .convert('L'))
    dots = len(pixels) / float(picture.get('height'))

    def shade(uv):
        """The mean shade of the ground around a place."""
        x, y = ((drawn[0] + (ground.to_world(uv) - path[0]) / (metres, -metres)) * dots).astype(int)
        return pixels[y - 9:y + 9, x - 9:x + 9].mean()

    assert shade((550.0, 20.0)) < 60.0 < 120.0 < shade((300.0, 350.0)) < 140.0
    assert shade((200.0, 100.0)) == 255.0


def test_a_dry_run_is_a_training_on_card_and_receiver(road_plan, tmp_path):
    done = run_here(draw, road_plan, '-o', tmp_path / 'c.html', tmp_path / 'c.gpx', '--dry-run',
                    '--speed', 36)
    assert done.code == 0, done.err
    page, file = (tmp_path / 'c.html').read_text(), (tmp_path / 'c.gpx').read_text()
    assert '<span>TRAINING</span>' in page and 'Training: do not drive this' in page
    assert '<name>TRAINING 20' in file
    assert rows_of(page)[1][-1] == '1.7', 'minutes at 36 km/h'


@pytest.mark.skipif(BINARY is None, reason='no Chromium here; on Debian: apt install chromium')
@pytest.mark.parametrize(('turns', 'tables'), [(12, 1), (32, 2)])
def test_a_card_fits_one_page_of_a4_and_of_letter(turns, tables, tmp_path):
    """Stairs of named roads: a turn at each corner, and a road that goes straight on there."""
    corners = [(300.0 * ((k + 1) // 2), 300.0 * (k // 2)) for k in range(turns + 2)]
    beyond = [tuple(2 * np.array(b) - a) for a, b in pairwise(corners)]
    points = np.array([*corners, *beyond]) + (500_500.0, 4_000_500.0)
    pairs = [*pairwise(range(turns + 2)), *((k, k + turns + 1) for k in range(1, turns + 1))]
    names = tuple(f'B {k} Valley Road' for k in range(turns + 1))
    roads = RoadGraph(points, np.array(pairs), np.ones((len(pairs), 2)), False, '', names,
                      np.r_[np.arange(turns + 1), np.arange(turns)])
    ground = RiskMap(np.ones((130, 130)), np.zeros((130, 130), bool), 50.0,
                     (500_000.0, 4_000_000.0, 0.0), 'EPSG:32631')
    made = plan_trip(ground, points[0], points[turns + 1], PlanningOptions(
        network=plain_options(method='graph', graph=roads, spacing=300.0),
        game=GameOptions(ambush_radius=50.0)))
    plan = tmp_path / 'stairs.plan'
    plan.write_bytes(plan_bytes(saved_plan(made, names=('Depot', 'Camp'))))
    done = run_here(draw, plan, '--date', '2030-07-01', '--slot', '6:00', '--speed', 30, '-o',
                    tmp_path / 'card.html')
    assert done.code == 0, done.err
    page = (tmp_path / 'card.html').read_text()
    assert page.count('<table>') == tables and len(rows_of(page)) == turns + 2
    for size in ('A4', 'Letter'):
        file = tmp_path / f'{size}.html'
        file.write_text(page.replace('@page {', f'@page {{ size: {size};'))
        subprocess.run([BINARY, '--headless', '--no-sandbox', '--disable-gpu', '--no-first-run',
                        '--disable-background-networking', '--no-pdf-header-footer',
                        f'--user-data-dir={tmp_path / "profile"}',
                        f'--print-to-pdf={tmp_path / "card.pdf"}', file.as_uri()],
                       check=True, capture_output=True, timeout=120,
                       env={k: v for k, v in os.environ.items() if k != 'LD_LIBRARY_PATH'})
        assert re.findall(rb'/Count (\d+)', (tmp_path / 'card.pdf').read_bytes()) == [b'1'], size
