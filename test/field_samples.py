# SPDX-License-Identifier: Apache-2.0
"""Roads, tracks and incidents as people have them, by their names in docs/roads.md, tables.md."""

import json
import sqlite3
import warnings
import zipfile
from contextlib import closing

import geopandas
import numpy as np
from commands import heard
from shapely.geometry import LineString
from test_declared_roads import OSM

from ambush_planner import RiskMap
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.risk_layers import risk_from_layers
from ambush_planner.maps.road_file import read_roads
from ambush_planner.maps.track_file import read_tracks
from ambush_planner.network.road_network import roads_on_map
from ambush_planner.operations.judge import find_trips

CRS, CORNER = 'EPSG:32633', np.array((455000.0, 5410000.0))
GROUND = RiskMap(np.ones((40, 40)), np.zeros((40, 40), bool), 10.0, (*CORNER, 0.0), CRS)
ROUND = CORNER + [(10.0, 10.0), (10.0, 390.0), (390.0, 390.0), (390.0, 10.0)]
STRAIGHT = CORNER + [(10.0, 10.0), (200.0, 10.0), (390.0, 10.0)]
WAY = CORNER + np.stack((np.arange(10.0, 391.0, 20.0), np.full(20, 10.0)), axis=1)


def lines(*shapes, crs=CRS, **columns):
    shapes = shapes or (STRAIGHT, ROUND)
    return geopandas.GeoDataFrame(columns or None, geometry=[*map(LineString, shapes)], crs=crs)


def save(frame, file, **options):
    """Write a table; GDAL warns of what a shapefile cuts, and of a missing system."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        frame.to_file(file, **options)


def roads(name='roads.gpkg', frame=None, text=None, **options):
    """Read roads of a table or a text from a file, and lay them on the map."""
    def say(folder):
        if isinstance(text, str | bytes):
            (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
        elif frame is not None:
            save(frame, folder / name)
        given, said = heard(read_roads, str(folder / name), **options)
        roads_on_map(given, GROUND)
        return said
    return say


def short_side_road():
    end = CORNER + (100.0, 10.03)
    shapes = [Coordinates(CRS).to_lat_lon(each)[:, ::-1] for each in (
        WAY[[0, -1]], np.stack((end, end + (0.0, 50.0))))]
    return lines(*shapes, crs='EPSG:4326', highway=['road', 'road'])


def without_dbf(folder):
    lines(highway=['footway', 'road']).to_file(folder / 'a.shp')
    (folder / 'a.dbf').unlink()
    return roads('a.shp')(folder)


def fewer_rows(folder):
    for name, count in (('cut', 2), ('one', 1)):
        lines(highway=['footway', 'road']).iloc[:count].to_file(folder / f'{name}.shp')
    (folder / 'one.dbf').replace(folder / 'cut.dbf')
    return roads('cut.shp')(folder)


def undefined_system(folder):
    lines(highway=['road', 'road']).to_crs(4326).to_file(folder / 'a.gpkg')
    with closing(sqlite3.connect(folder / 'a.gpkg')) as file:
        file.create_function('ST_IsEmpty', 1, lambda _: 0)
        for table in ('gpkg_contents', 'gpkg_geometry_columns'):
            file.execute(f'UPDATE {table} SET srs_id = 0')
        file.commit()
    return roads('a.gpkg')(folder)


def table_by_name(folder):
    lines(highway=['road', 'road']).to_file(folder / 'a.gpkg', layer='roads')
    with closing(sqlite3.connect(folder / 'a.gpkg')) as file:
        file.execute('CREATE TABLE names (fid INTEGER PRIMARY KEY, name TEXT)')
        file.execute("INSERT INTO gpkg_contents (table_name, data_type, identifier, srs_id) "
                     "VALUES ('names', 'attributes', 'names', 0)")
        file.commit()
    return roads('a.gpkg|layername=names')(folder)


def route_graph(*frames):
    nodes = [{'type': 'Feature', 'properties': {'id': k, 'frame': frame},
              'geometry': {'type': 'Point', 'coordinates': each.tolist()}}
             for k, (frame, each) in enumerate(zip(frames, STRAIGHT, strict=False))]
    edge = {'type': 'Feature', 'properties': {'id': 9, 'startid': 0, 'endid': 1},
            'geometry': {'type': 'LineString', 'coordinates': [[0, 0], [1, 1]]}}
    return json.dumps({'type': 'FeatureCollection', 'features': [*nodes, edge]})


DRAWING = ('0\nSECTION\n2\nENTITIES\n0\n'
           'LINE\n8\nROADS\n10\n0\n20\n0\n11\n9\n21\n9\n0\nENDSEC\n0\nEOF\n')
KLASSE = lines(klasse=['path', 'street'])
IN_DEGREES = lines(highway=['road', 'road']).to_crs(4326)
TAGS = ', '.join(f'"name:{k}"=>"a long name"' for k in range(20))
NAMES = {'highway': ['track', 'road']}
ROADS = {
    'roads of a city, `klasse` says what they are': roads(frame=KLASSE),
    'footways of TIGER': roads('a.shp', lines(MTFCC=['S1710', 'S1400'])),
    'a drawing, its layers are `Layer`': roads(frame=lines(Layer=['POWER', 'ROADS'])),
    'a drawing as `.dxf`': roads('a.dxf', text=DRAWING),
    'a map of lanelet2': roads('a.osm', text=OSM.replace('highway', 'type').replace(
        'TAGS', '<tag k="type" v="line_thin"/>')),
    '`--all-lines-are-roads` for data that are known': roads(
        frame=lines(**NAMES), all_lines_are_roads=True),
    'direction by `FAHRTRICHT`': roads('a.shp', lines(**NAMES, FAHRTRICHT=['G', None])),
    'direction by values only': roads(
        frame=lines(fclass=['track', 'road'], flag=['Two Way', 'One Way'])),
    'bridges by `POS_SOL`, as in BD TOPO': roads(frame=lines(
        **NAMES, oneway=['no', 'no'], POS_SOL=['1', '0'])),
    'a road that is closed by two values, as osmnx merges them': roads(frame=lines(
        **NAMES, access=['["no", "private"]', None])),
    'tags of OpenStreetMap in JSON, next to columns': roads(frame=lines(
        **NAMES, tags=['{"vehicle": "no", "name": "A"}', None])),
    '`other_tags` cut by a shapefile': roads('a.shp', lines(**NAMES, other_tags=[TAGS, None])),
    '`construction` cut to `constructi`': roads('a.shp', lines(**NAMES, constructi=['yes', None])),
    'a shapefile with fewer rows than shapes': fewer_rows,
    'a shapefile without `.dbf`': without_dbf,
    'a side road that ends 3 cm short, in degrees': roads('a.geojson', short_side_road()),
    'levels at the ends of roads, `F_ZLEV`': roads('a.shp', lines(
        **NAMES, oneway=['no', 'no'], F_ZLEV=[0, 1])),
    'roads of Overture': roads(frame=lines(**{
        'subtype': ['road', 'rail'], 'class': ['track', ''], 'access_restrictions': ['[]', '[]']})),
    'a way with `visible="false"`': roads('a.osm', text=OSM.replace(
        'TAGS', '<tag k="highway" v="road"/>').replace(
            '<way id="12"', "<way id='12' visible = 'false'")),
    'GeoJSON in metres': roads('a.geojson', text=lines(**NAMES, crs=None).to_json()),
    'latitude before longitude': roads('a.geojson', lines(
        *(np.array(each.coords)[:, ::-1] for each in IN_DEGREES.geometry), **NAMES, crs=4326)),
    'a GeoPackage with the undefined geographic system': undefined_system,
    'a route graph of two frames': roads('a.geojson', text=route_graph('map', 'odom')),
    'a table of a GeoPackage, by its name': table_by_name,
    'an answer of Overpass that ran out of time': roads('a.osm', text=OSM.replace(
        '</osm>', '<remark> runtime error: Query timed out </remark></osm>')),
    'the page of a login': roads('a.geojson', text='<!DOCTYPE html><html>Sign in</html>'),
    'a ford, and a bridge with `maxweight`': roads(frame=lines(
        **NAMES, ford=['yes', None], maxweight=[None, '3.5'])),
    'an extract as `.osm.gz`': roads('a.osm.gz', text=b'\x1f\x8b'),
    'GraphML': roads('a.graphml', text='<graphml>'),
    'a file that ends early': roads('a.geojson', text=lines(**NAMES).to_json()[:-50]),
}


def written(folder, name, text):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(folder / name)


def tracks(text, name='a.csv'):
    """Read tracks, and find trips along ``WAY`` in them."""
    def say(folder):
        found, said = heard(read_tracks, written(folder, name, text), GROUND)
        trips, left_out = find_trips(found, WAY[0], WAY[-1], 25.0, 20.0)
        assert len(trips) + len(left_out) >= 1
        return ' '.join((said, *map(str, left_out)))
    return say


def incidents(text, name='i.csv', **layer):
    def say(folder):
        written(folder, name, text)
        top = {'crs': CRS, 'resolution': 20.0, 'bounds': [*CORNER, *(CORNER + 400.0)]}
        made, said = heard(risk_from_layers, {**top, 'layers': [
            {'incidents': name, 'half_life': 90, 'bandwidth': 60, **layer}]}, folder)
        return ' '.join((said, *made.remarks))
    return say


def rows(header, *columns, each='{0},{1}'):
    """A table with a position of ``WAY`` in each row."""
    cells = zip(WAY.tolist(), *columns, strict=False) if columns else ((at,) for at in WAY.tolist())
    return header + '\n' + ''.join(
        ','.join((each.format(*at), *map(str, more))) + '\n' for at, *more in cells)


def dated(*dates):
    return 'x,y,date\n' + ''.join(
        f'{x},{y},{date}\n' for (x, y), date in zip(WAY.tolist(), dates, strict=False))


def three_vehicles(header, names='ABC', moment='2025-03-03T06:{:02}:00Z'):
    return header + '\n' + ''.join(
        f'{moment.format(k)},{name},{x:.1f},{y + 2.0 * lane:.1f}\n'
        for k in range(20) for lane, name in enumerate(names)
        for x, y in [WAY[(k + 7 * lane) % 20].tolist()])


def packed(folder):
    with zipfile.ZipFile(folder / 'a.gpx', 'w') as file:
        file.writestr('a.gpx', '<gpx/>')
    return read_tracks(str(folder / 'a.gpx'), GROUND)


DEGREES = Coordinates(CRS).to_lat_lon(WAY)
TIMES = [f'2025-03-03T06:{k:02}:00Z' for k in range(20)]
TABLES = {
    'tracks of three vehicles, in time, apart by `driver`': tracks(
        three_vehicles('time,driver,x,y')),
    'the newest position first, with times': tracks(
        'x,y,time\n' + '\n'.join(rows('x,y,time', TIMES).splitlines()[:0:-1]) + '\n'),
    'times in `recorded`': tracks(rows('x,y,recorded', TIMES)),
    'tracks by `Device ID`, times in `fixTime`': tracks(three_vehicles('fixTime,Device ID,x,y')),
    'tracks by `vehicle` and `trip`': tracks(rows('x,y,vehicle,trip', 'A' * 20, [1] * 20)),
    'times as milliseconds since 1970': tracks(rows('x,y,timestamp', range(
        1741000000000, 1741000020000, 1000))),
    'dates such as 07.04.2026': incidents(dated('07.04.2026', '2026-04-07')),
    '`easting` and `northing` in `zone` 34': tracks(
        rows('easting,northing,zone', ['34'] * 20)),
    'degrees and minutes in `lat`': tracks('lat,lon\n48 50.5,14 23.1\n'),
    'a row with one field less': incidents(dated('2025-03-31') + '455100,5410100\n'),
    'a comma at the end of each row, and of none in the header': incidents(
        dated('2025-03-31,', '2025-03-30,')),
    'fields separated by `;`': tracks(rows('x,y').replace(',', ';')),
    'decimal commas between quotes': incidents('x,y,date\n"455205,5","5410105,5",2025-03-31\n'),
    '`Lat` and `LAT`': tracks('Lat,LAT,lon\n48.8,48.8,14.3\n'),
    'a blank cell in `trip`': tracks(rows('x,y,trip', ['1'] * 5 + [''] + ['1'] * 14)),
    '`lat` and `lon` swapped': tracks('lon,lat\n' + ''.join(
        f'{lat},{lon}\n' for lat, lon in DEGREES)),
    '`lat` and `lon` swapped, beyond 90 degrees': tracks('lat,lon\n138.7,35.1\n138.8,35.2\n'),
    'degrees in `x` and `y`': incidents('x,y,date\n14.389,48.842,2025-03-31\n'),
    'a line of two points': tracks('x,y\n{},{}\n{},{}\n'.format(*WAY[0], *WAY[-1]), 'two.csv'),
    'a log of a receiver in NMEA': tracks('$GNRMC,120000,A,4850,N,01438,E\n', 'drive.log'),
    'a TCX file of a watch': tracks('<?xml version="1.0"?>\n<TrainingCenterDatabase>', 'a.gpx'),
    'a GPX file in a zip': packed,
    'an empty file': tracks('', 'a.gpx'),
    'a track in metres, in GeoJSON without a system': tracks(
        lines(WAY, crs=None).to_json(), 'a.geojson'),
    'UTF-16, as spreadsheets write it': tracks(rows('x,y').encode('utf-16')),
}
