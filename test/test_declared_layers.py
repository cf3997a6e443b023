# SPDX-License-Identifier: Apache-2.0
"""Lines that layers and tracks leave out are counted, or refused where it matters: tables."""

import numpy as np
import pytest

pytest.importorskip('geopandas', reason='vector files need geopandas')
import geopandas
from commands import heard
from rasters import write_geotiff
from shapely.geometry import LineString, MultiPoint, Point, box

from ambush_planner import AmbushPlannerError, RiskMap
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.risk_layers import risk_from_layers
from ambush_planner.maps.track_file import read_tracks

CRS = 'EPSG:32633'
WEST, SOUTH = 455000.0, 5410000.0
GRID = {'crs': CRS, 'resolution': 10.0, 'bounds': [WEST, SOUTH, WEST + 400, SOUTH + 400]}
FIELD = box(WEST + 50, SOUTH + 50, WEST + 150, SOUTH + 150)  # 100 cells
RING = LineString([(WEST + 205, SOUTH + 205), (WEST + 345, SOUTH + 205), (WEST + 345, SOUTH + 345),
                   (WEST + 205, SOUTH + 205)])
ROAD = LineString([(WEST + 5, SOUTH + 255), (WEST + 395, SOUTH + 255)])
MINE = Point(WEST + 305, SOUTH + 105)


def made(folder, shapes, layer, top=None, crs=CRS, **attributes):
    """The risk map of one layer of shapes, and what was said."""
    frame = geopandas.GeoDataFrame(attributes or None, geometry=list(shapes), crs=crs)
    frame.to_file(folder / 'x.gpkg')
    (kind,) = (key for key in ('polygons', 'roads', 'incidents') if key in layer)
    layers = {**(top or GRID), 'layers': [{**layer, kind: 'x.gpkg'}]}
    found, said = heard(risk_from_layers, layers, folder)
    return found.risk_map, said


AREA, STREETS = {'polygons': ''}, {'roads': ''}


@pytest.mark.parametrize(('shapes', 'layer', 'tags', 'words'), [
    ([FIELD, ROAD, RING, MINE], {**AREA, 'forbidden': True}, {}, 'layer 1 .polygons.: x.gpkg: 3 of '
     r'4 shapes are no polygons \(2 LineString, 1 Point\); .* buffer'),
    ([FIELD, RING], {**AREA, 'loss': 3}, {}, '1 of 2 shapes'),
    ([MultiPoint([MINE, Point(WEST, SOUTH)]), FIELD], AREA, {}, '2 of 3 shapes .*2 Point'),
    ([FIELD, MINE], {**AREA, 'forbidden': True, 'buffer': 'far'}, {'far': [9.0, 0.0]},
     '1 of 2 shapes'),
    ([FIELD, None], {**AREA, 'secured': 'barred'}, {'barred': [1, 1]},
     'secured ground must be whole'),
    ([ROAD, FIELD], {**STREETS, 'forbidden': True}, {}, '1 of 2 features .*1 Polygon; forbidden'),
    ([ROAD, RING], {**STREETS, 'forbidden': True}, {'highway': ['track', 'footway']},
     'forbidden ground must be whole; put lines that are no roads'),
    ([ROAD], {**STREETS, 'passable': True}, {'waterway': ['river']}, 'or --all-lines-are-roads'),
    ([ROAD], {**STREETS, 'road_column': 'a=c'}, {'a': ['b']}, 'road_column .* of a has b 1'),
])
def test_what_would_open_forbidden_or_held_ground_is_refused(shapes, layer, tags, words, tmp_path):
    with pytest.raises(AmbushPlannerError, match=words):
        made(tmp_path, shapes, layer, **tags)


@pytest.mark.parametrize(('shapes', 'layer', 'tags', 'words', 'cells'), [
    ([MINE], {**AREA, 'forbidden': True, 'buffer': 14.0}, {}, '', 9),
    ([RING], {**AREA, 'forbidden': True, 'buffer': 1.0}, {}, '', 68),
    ([FIELD, MINE], {**AREA, 'forbidden': True, 'buffer': 'FAR'}, {'far': [0.0, 4.0]}, '', 101),
    ([FIELD, None], AREA, {}, '1 of 2 features are left out: 1 without a geometry', 0),
    ([ROAD, MINE, FIELD], STREETS, {}, '2 of 3 features are left out: 1 Point, 1 Polygon', 0),
    ([MINE, FIELD], {'incidents': '', 'bandwidth': 50}, {}, '1 of 2 features .*1 Polygon', 0),
])
def test_what_is_left_out_elsewhere_is_counted(shapes, layer, tags, words, cells, tmp_path):
    risk_map, said = made(tmp_path, shapes, layer, **tags)
    assert risk_map.obstacles.sum() == cells
    assert words.split('.*')[0] in said and bool(words) == bool(said)


@pytest.mark.parametrize(('name', 'text'), [
    ('a.csv', 'lat,lon,kind\n{0},{1},bomb\n,,none\n0,0,none\n'),
    ('A.CSV', 'Latitude,Longitude\n{0},{1}\n'),
    ('a.csv', 'x,y\n{2},{3}\n'), ('a.csv', 'Y;X\n'),
    ('a.gpx', '<gpx xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="{0}" lon="{1}"/>'
     '<trk><trkseg><trkpt lat="1" lon="1"/></trkseg></trk></gpx>'),
])
def test_incidents_from_csv_and_gpx(name, text, tmp_path):
    x, y = WEST + 205.0, SOUTH + 105.0
    degrees = Coordinates(CRS).to_lat_lon((x, y))
    (tmp_path / name).write_text(text.format(*degrees, x, y))
    layers = {**GRID, 'layers': [{'incidents': name, 'bandwidth': 50}]}
    if ';' in text:
        with pytest.raises(AmbushPlannerError, match='are separated by ";"'):
            risk_from_layers(layers, tmp_path)
        return
    found, said = heard(risk_from_layers, layers, tmp_path)
    alpha = found.risk_map.alpha
    assert np.unravel_index(alpha.argmax(), alpha.shape) == (10, 20)
    assert ('2 of 3 features are left out: 2 without a geometry' in said) == ('none' in text)


def test_the_system_at_the_top_is_that_of_files_without_one(tmp_path):
    heights = 300.0 + np.mgrid[:40, :40][0]
    write_geotiff(tmp_path / 'dem.tif', heights, None, (10, 0, WEST, 0, -10, SOUTH + 400))
    geopandas.GeoDataFrame(geometry=[FIELD]).to_file(tmp_path / 'bare.gpkg')
    geopandas.GeoDataFrame(geometry=[FIELD], crs=CRS).to_crs(4326).to_file(tmp_path / 'f.geojson')
    terrain = {'terrain': 'dem.tif', 'weapon_range': 60}
    area = {'polygons': 'bare.gpkg', 'forbidden': True}
    for layers in ([terrain, area], [terrain, {**area, 'polygons': 'f.geojson'}], [area]):
        top = {'crs': CRS} if terrain in layers else GRID
        risk_map = risk_from_layers({**top, 'layers': layers}, tmp_path).risk_map
        assert risk_map.crs == CRS and 100 <= risk_map.obstacles.sum() < 150
    with pytest.raises(AmbushPlannerError, match='coordinate system'):
        risk_from_layers({'layers': [terrain, {**area, 'polygons': 'f.geojson'}]}, tmp_path)


@pytest.mark.parametrize('yaw', [0.0, 0.5])
def test_a_datum_is_the_frame_of_the_grid(yaw, tmp_path):
    frame = f'datum {48.84} {14.387} {yaw}'
    system = Coordinates(frame)
    place = system.to_lat_lon((105.0, 55.0))[::-1]
    top = {'crs': frame, 'resolution': 10.0, 'bounds': [0, 0, 400, 400]}
    risk_map, _ = made(tmp_path, [Point(*place)], {**AREA, 'forbidden': True, 'buffer': 4e-5},
                       top, 'EPSG:4326')
    assert risk_map.crs == frame and np.argwhere(risk_map.obstacles).tolist() == [[5, 10]]


# Six days on one way, in tracks of one file; the times and positions of receivers.
GROUND = RiskMap(np.ones((40, 40)), np.zeros((40, 40), bool), 10.0, (WEST, SOUTH, 0.0), CRS)
DEGREES = Coordinates(CRS).to_lat_lon(np.stack((WEST + np.arange(0, 400, 20.0),
                                                np.full(20, SOUTH + 9.0)), axis=1))


def gpx(begins, places=DEGREES, step=10):
    tracks = []
    for begin in begins:
        times = ['' if begin is None else f'<time>{np.datetime64(begin) + step * k}Z</time>'
                 for k in range(len(places))]
        tracks.append(''.join(f'<trkpt lat="{lat}" lon="{lon}">{time}</trkpt>\n'
                              for (lat, lon), time in zip(places, times, strict=True)))
    return ('<gpx xmlns="http://www.topografix.com/GPX/1/1">'
            + ''.join(f'<trk><trkseg>{each}</trkseg></trk>' for each in tracks) + '</gpx>')


@pytest.mark.parametrize(('begin', 'step', 'timed'), [
    ('2005-08-01T08:00:00', 10, True), (None, 10, False), ('1970-01-01T08:00:00', 10, False),
    ('2026-03-01T08:00:00', 0, False), ('1999-08-22T00:00:05', 10, False),
])
def test_times_that_say_nothing_are_ignored(begin, step, timed, tmp_path):
    (tmp_path / 'a.gpx').write_text(gpx([begin] * 6, step=step))
    tracks, said = heard(read_tracks, str(tmp_path / 'a.gpx'), GROUND)
    assert len(tracks) == 6 and all((each.times is not None) == timed for each in tracks)
    assert ('the times of 6 of 6 tracks are ignored' in said) == (not timed and begin is not None)


@pytest.mark.parametrize('bad', [
    (0.0, -0.0), (91.0, 0.0), (48.0, 400.0), ('', 14.0), ('nan', 'nan'), ('x', 14.0),
])
def test_positions_without_a_fix_are_counted(bad, tmp_path):
    places = [*DEGREES.tolist()]
    places[3:5] = [bad, bad]
    (tmp_path / 'a.gpx').write_text(gpx([None], places))
    rows = ''.join(f'{lat},{lon}\n' for lat, lon in places)
    (tmp_path / 'a.csv').write_text('lat,lon\n' + rows)
    for name in ('a.gpx', 'a.csv'):
        (track,), said = heard(read_tracks, str(tmp_path / name), GROUND)
        assert len(track.xy) == 18 and '2 of 20 positions have no fix' in said
        assert len(said) < 300


@pytest.mark.parametrize(('cut', 'words'), [
    (lambda text: text[: len(text) // 2], 'ends early, at line .*gpsbabel'),
    (lambda text: text[:600] + '\0\0' + text[602:], 'damaged'),
    (lambda text: text + '\n<trk>', 'damaged'), (lambda text: '', 'an empty file'),
    (lambda text: 'hello', 'damaged'), (lambda text: '<gpx></gpx>', 'there is no track in it'),
])
def test_files_that_end_early_are_refused(cut, words, tmp_path):
    (tmp_path / 'a.gpx').write_text(cut(gpx([None])))
    with pytest.raises(AmbushPlannerError, match=words) as refused:
        read_tracks(str(tmp_path / 'a.gpx'), GROUND)
    assert '\n' not in str(refused.value) and len(str(refused.value)) < 250
