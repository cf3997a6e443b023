# SPDX-License-Identifier: Apache-2.0
"""Which lines are roads, in which direction and how fast: tables of attributes and formats."""

import json
import math
import re

import numpy as np
import pytest

pytest.importorskip('geopandas', reason='vector files need geopandas')
import geopandas
import networkx
from commands import heard, table_under
from shapely.geometry import LineString, MultiLineString, Point, Polygon

from ambush_planner import InvalidOption, NetworkOptions
from ambush_planner.maps import road_schemas as known
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.road_file import read_roads
from ambush_planner.maps.road_tags import ROUNDABOUT
from ambush_planner.network.road_network import in_map_frame
from ambush_planner.recordings.attachments import roads_file, roads_from_file

CRS = 'EPSG:32616'
# The way round is a road; whether the straight line is one, and in which direction, is asked.
ROUND = [(0.0, 0.0), (400.0, 400.0), (800.0, 0.0)]
STRAIGHT = [(0.0, 0.0), (400.0, 0.0), (800.0, 0.0)]
BOTH, AHEAD, BACK, NONE = {(0, 1), (1, 0)}, {(0, 1)}, {(1, 0)}, set()


def table(straight, around=None, shape=STRAIGHT, crs=CRS):
    """The two lines; the way round has the attributes of ``around``, by default none but a kind."""
    around = {'highway': 'primary'} if around is None else around
    names = dict.fromkeys([*straight, *around])
    return geopandas.GeoDataFrame(
        {name: [around.get(name), straight.get(name)] for name in names} or None,
        geometry=[LineString(ROUND), LineString(shape)], crs=crs)


def read(source, **options):
    """The directions of the straight line, its speed [m/s], and what was said."""
    roads, said = heard(read_roads, source, **options)
    flat = np.abs(roads.points[roads.pairs][:, :, 1]).max(axis=1) < 1e-3
    ahead = roads.points[roads.pairs[:, 0], 0] < roads.points[roads.pairs[:, 1], 0]
    found, speed = set(), math.nan
    for first, speeds in zip(ahead[flat], roads.speeds[flat], strict=True):
        there, back = speeds if first else speeds[::-1]
        found |= {way for way, value in (((0, 1), there), ((1, 0), back)) if value > 0.0}
        speed = max(there, back)
    return found, speed, said


@pytest.mark.parametrize(('tags', 'drivable', 'words'), [
    *(({key: value}, NONE, f'1 of 2 lines are no roads for vehicles: {key}={value} 1; they are')
      for key, value in (('waterway', 'river'), ('route', 'ferry'))),
    *(({'highway': kind}, NONE, f': {kind} 1') for kind in ('footway', 'construction', 'busway')),
    ({'name': 'a line'}, NONE, 'without highway 1'),
    *(({'highway': 'service', **tags}, NONE, f'{key}={value}') for tags, key, value in (
        ({'access': 'private'}, 'access', 'private'),
        ({'motor_vehicle': 'no', 'access': 'yes'}, 'access', 'no'),
        ({'motorcar': 'no'}, 'access', 'no'), ({'area': 'yes'}, 'area', 'yes'),
        ({'oneway': 'N'}, 'oneway', 'n'), ({'oneway': 'reversible'}, 'oneway', 'reversible'),
        ({'smoothness': 'impassable'}, 'smoothness', 'impassable'),
        ({'oneway': 'sometimes'}, 'oneway', 'sometimes'))),
    ({'highway': 'tertiary', 'construction': 'yes'}, NONE, 'construction 1'),
    *(({'highway': kind}, BOTH, '') for kind in (
        'secondary_link', 'track', "['path', 'residential']")),
    ({'highway': 'residential', 'railway': 'tram'}, BOTH, ''),
    ({'highway': 'service', 'access': 'no', 'motor_vehicle': 'yes'}, BOTH, ''),
    ({'highway': 'service', 'access': 'destination'}, BOTH, ''),
    ({'highway': 'primary', 'construction': 'minor'}, BOTH, ''),
    ({'highway': 'motorway'}, AHEAD, ''), ({'highway': 'motorway_link'}, AHEAD, ''),
    ({'highway': 'motorway', 'oneway': 'no'}, BOTH, ''),
    ({'highway': 'primary', 'junction': 'roundabout'}, AHEAD, ''),
    *(({'highway': 'primary', 'oneway': value}, drivable, '')
      for drivable, values in ((BACK, ('reverse', 'T', '-1.0')), (AHEAD, ('1', 'FT', 'True')),
                               (BOTH, ('no', 'B'))) for value in values),
    ({'highway': 'primary', 'oneway': 'no', 'oneway:motor_vehicle': 'yes'}, AHEAD, ''),
    ({'highway': 'primary', 'oneway:bicycle': 'yes'}, BOTH, ''),
    ({'HIGHWAY': 'primary', 'ONEWAY': '-1'}, BACK, ''),
    ({'highway': 'primary', 'One-Way': 'yes'}, AHEAD, "'One-Way' is read as oneway"),
    *(({'highway': 'service', key: value}, NONE, f'access={value} 1') for key, value in (
        ('motor_vehicle', 'agricultural;forestry'), ('vehicle', 'no|permit'))),
    ({'highway': 'service', 'vehicle': 'forestry;destination'}, BOTH, ''),
    ({'highway': 'primary', 'SPEED_LIM': 'F'}, BOTH, "'SPEED_LIM' is not read"),
])
def test_which_lines_are_roads_in_which_direction(tags, drivable, words):
    found, _, said = read(table(tags, {'HIGHWAY': 'primary'} if 'HIGHWAY' in tags else None),
                          two_way='not read' in words)
    assert found == drivable and words in said and bool(words) == bool(said)


@pytest.mark.parametrize(('data', 'schema'), [
    ('OpenStreetMap', known.OPENSTREETMAP), ("Geofabrik's extracts", known.GEOFABRIK),
    ('Overture', known.OVERTURE), ('TIGER', known.TIGER), ('Natural Earth', known.NATURAL_EARTH)])
def test_the_documented_values_are_those_of_roads(data, schema):
    _, columns, values, _ = next(
        row for row in table_under('docs/roads.md', 'What is a road') if row[0] == data)
    names, values = (re.findall('`([^`]+)`', each.lower()) for each in (columns, values))
    assert names[:len(schema)] == [*schema]
    assert frozenset().union(*schema.values()).issuperset(values)
    if data in ('TIGER', 'Natural Earth'):
        assert frozenset().union(*schema.values()) == {*values}


TWO_WAY, OVERTURE = 'no column says directions', {'subtype': 'road', 'class': 'residential'}


def rules(*given):
    return {**OVERTURE, 'access_restrictions': json.dumps([
        {'access_type': kind, 'when': when} for kind, when in given])}


@pytest.mark.parametrize(('tags', 'around', 'drivable', 'words'), [
    ({'fclass': 'footway'}, {'fclass': 'primary'}, NONE, 'footway'),
    ({'fclass': 'track_grade3'}, {'fclass': 'primary'}, BOTH, ''),
    ({'tags': '{"waterway": "river"}'}, {'tags': '{"highway": "road"}'}, NONE, 'waterway=river'),
    ({'tags': {'highway': 'track', 'oneway': '-1'}}, {'tags': {'highway': 'road'}}, BACK, ''),
    ({'all_tags': '"highway"=>"track", "name"=>"a \\"b\\", c", "x"=>NULL, "oneway"=>"yes"'},
     {'all_tags': '"highway"=>"road"'}, AHEAD, ''),
    ({**OVERTURE, 'subtype': 'rail'}, OVERTURE, NONE, 'rail 1'),
    ({**OVERTURE, 'class': 'steps'}, OVERTURE, NONE, 'steps 1'),
    (rules(('denied', {'heading': 'backward'})), OVERTURE, AHEAD, ''),
    (rules(('denied', {'heading': 'forward', 'mode': ['car', 'bus']})), OVERTURE, BACK, ''),
    (rules(('denied', {'mode': ['bicycle']}), ('denied', {'vehicle': [{'value': 4}]})), OVERTURE,
     BOTH, ''),
    (rules(('denied', None)), OVERTURE, NONE, 'access_restrictions 1'),
    (rules(('denied', None), ('allowed', {'mode': ['motor_vehicle']})), OVERTURE, BOTH, ''),
    (rules(('denied', None), ('allowed', {'mode': ['car'], 'using': ['as_customer']})), OVERTURE,
     NONE, 'access_restrictions 1'),
    ({'MTFCC': 'R1011'}, {'MTFCC': 'S1400'}, NONE, TWO_WAY),
    ({'MTFCC': 'S1500'}, {'MTFCC': 'S1400'}, BOTH, TWO_WAY),
    ({'featurecla': 'Road', 'type': 'Ferry, seasonal'},
     {'featurecla': 'Road', 'type': 'Track'}, NONE, TWO_WAY),
    ({'featurecla': 'Railroad'}, {'featurecla': 'Road', 'type': 'Bypass'}, NONE, TWO_WAY),
    ({'ID': 7}, {'ID': 8}, BOTH, 'its lines have no attributes'),
])
def test_roads_of_other_data(tags, around, drivable, words):
    found, _, said = read(table(tags, around))
    assert found == drivable and words in said and bool(words or found == NONE) == bool(said)


@pytest.mark.parametrize(('options', 'tags', 'around', 'drivable'), [
    ({'road_column': 'Klasse=strasse, Weg'}, {'klasse': 'Weg'}, {'klasse': 'Strasse'}, BOTH),
    ({'road_column': 'KLASSE=strasse'}, {'klasse': 'Weg'}, {'klasse': 'Strasse'}, NONE),
    ({'road_column': 'highway=footway,primary'}, {'highway': 'footway'}, None, BOTH),
    ({'road_column': 'Type=a', 'two_way': True}, {'Type': 'a', 'sens': '1'}, {'Type': 'b'}, BOTH),
    ({'all_lines_are_roads': True}, {'oneway': '-1'}, {'oneway': 'no'}, BACK),
    ({'all_lines_are_roads': True}, {'STATUS': 'open', 'AREA': 'N', 'vehicle': 'no'}, {}, NONE),
    ({'two_way': True}, {'highway': 'road', 'DIR_TRAVEL': 'T'}, None, BOTH),
    ({'two_way': True}, {'highway': 'road', 'DIR_TRAVEL': 'T', 'oneway': 'yes'}, None, AHEAD),
])
def test_what_the_caller_declares(options, tags, around, drivable):
    assert read(table(tags, around), **options)[0] == drivable


@pytest.mark.parametrize('name', [
    'DIR_TRAVEL', 'sens_de_circulation', 'RIJRICHTNG', 'reverse_cost', 'twoway', 'направление'])
def test_columns_that_may_say_directions_are_refused(name):
    with pytest.raises(InvalidOption, match=f'may say directions: {name} has .*--two-way'):
        read(table({'highway': 'primary', name: '2'}))


@pytest.mark.parametrize('tags', [
    {'PREDIR': 'N'}, {'sidewalk': 'both'}, {'turn:lanes:forward': 'left'}, {'license': 'none'},
    {'dirt': 'yes'}, {'travel_time': 4.0}, {'oneway': 'no', 'reversed': 'True'}])
def test_columns_that_say_no_directions_are_not(tags):
    assert read(table({'highway': 'primary', **tags}))[0] == BOTH


@pytest.mark.parametrize(('name', 'values', 'speed', 'words'), [
    ('SPEED_KPH', ('36', '36'), 10.0, ''), ('speed_mps', (7.5, 7.5), 7.5, ''),
    ('speed-kmh', (18, 18), 5.0, 'read as speed_kmh'),
    ('speed_kph', ('36 km/h', '10 mph'), 4.4704, ''),
    ('speed_kph', ('36', '10 knots'), None, 'must be numbers'),
    ('speed_kph', (36.0, None), None, '1 of 2 lines have no speed'),
    ('speed_kph', (36.0, 0.0), None, 'no speed above 0'), ('maxspeed', (50, 50), 1.0, 'not read'),
    ('speed', (50, 50), 1.0, "'speed' is not read"),
])
def test_speeds_and_their_units(name, values, speed, words):
    lines = table({'highway': 'primary'}).assign(**{name: values})
    if speed is None:
        with pytest.raises(InvalidOption, match=words):
            read(lines)
        return
    _, found, said = read(lines)
    assert found == pytest.approx(speed) and words in said and bool(words) == bool(said)


OSM = """<?xml version="1.0"?><osm version="0.6">
 <node id="1" version="1" lat="0.0" lon="3.0"/><node id="2" version="1" lat="0.003" lon="3.004"/>
 <node id="3" version="1" lat="0.0" lon="3.008"/><node id="4" version="1" lat="0.0" lon="3.004"/>
 <way id="11" version="1"><nd ref="1"/><nd ref="2"/><nd ref="3"/>
  <tag k="highway" v="primary"/></way>
 <way id="12" version="1"><nd ref="1"/><nd ref="4"/><nd ref="3"/>TAGS</way></osm>"""


@pytest.mark.parametrize(('tags', 'name'), [
    ({'name': 'Main  Street'}, 'Main Street'), ({'NAME': 'Main Street', 'Ref': 'B 55'},
                                                'B 55 Main Street'),
    ({'name': ['High Road', 'Low Road']}, 'High Road / Low Road'), ({'name': None}, ''),
    ({'other_tags': '"ref"=>"A 1","maxspeed"=>"80"'}, 'A 1'), ({'name': float('nan')}, ''),
    ({'name': 'Ring', 'junction': 'roundabout'}, ROUNDABOUT),
])
def test_names_of_roads(tags, name):
    roads = read_roads(table({'highway': 'track', **tags}))
    names = {roads.names[k] for k in roads.name.tolist()}
    assert names == {'', name}


def test_names_and_places_of_an_openstreetmap_file_are_those_of_its_plan(tmp_path):
    village = ('<node id="9" version="1" lat="0.001" lon="3.001"><tag k="place" v="village"/>'
               '<tag k="name" v="Ash"/></node><way id="11"')
    tags = '<tag k="highway" v="track"/><tag k="ref" v="T 7"/><tag k="name" v="Old Road"/>'
    (tmp_path / 'a.osm').write_text(OSM.replace('TAGS', tags).replace('<way id="11"', village))
    roads = in_map_frame(read_roads(tmp_path / 'a.osm'), 'EPSG:32631')
    again = roads_from_file(roads_file(roads))
    for each in (roads, again):
        assert {each.names[k] for k in each.name.tolist()} == {'', 'T 7 Old Road'}
        (x, y, name), = each.places
        assert each.names[int(name)] == 'Ash'
        assert Coordinates('EPSG:32631').to_lat_lon((x, y)) == pytest.approx((0.001, 3.001))


@pytest.mark.parametrize(('second', 'tags', 'count'), [
    ([(400.0, -50.0), (420.0, 50.0)], {}, 1), ([(200.0, 0.0), (200.0, 50.0)], {}, 1),
    ([(100.0, 50.0), (100.0, -50.0), (300.0, -50.0), (300.0, 50.0)], {}, 2),
    ([(400.0, -50.0), (400.0, 50.0)], {'bridge': 'yes'}, 0),
    ([(400.0, -50.0), (420.0, 50.0)], {'layer': '1'}, 0),
    ([(400.0, -50.0), (420.0, 50.0)], {'layer': '0', 'bridge': 'no'}, 1),
    ([(400.0, -50.0), (400.0, 0.0), (400.0, 50.0)], {}, 0),  # a junction
    ([(900.0, -50.0), (900.0, 50.0)], {}, 0), ([(0.0, 0.0), (0.0, -90.0)], {}, 0),
    ([(300.3, 80.0), (300.0, 0.03)], {}, 1), ([(300.3, 80.0), (300.0, 0.3)], {}, 0),
    ([(300.3, 80.0), (300.0, -0.02)], {}, 1), ([(800.03, 0.0), (900.0, 0.0)], {}, 1),
    ([(800.0, 0.0), (800.02, 0.0), (800.04, 0.0), (900.0, 50.0)], {}, 0),  # short pieces
])
def test_crossings_without_a_shared_vertex_are_counted_or_joined(second, tags, count):
    lines = table(tags, shape=second).assign(highway='primary')
    lines.geometry = [LineString(STRAIGHT), LineString(second)]
    *_, said = read(lines)
    assert (f'at {count} places' in said) == (count > 0)
    roads = read_roads(lines, node_crossings=True)
    graph = networkx.Graph(map(tuple, roads.pairs.tolist()))
    meets = count > 0 or {(400.0, 0.0), (0.0, 0.0), (800.0, 0.0)}.intersection(second)
    assert networkx.number_connected_components(graph) == (1 if meets else 2)
    assert networkx.cycle_basis(graph) == [] or count == 2
    length = np.hypot(*np.diff(roads.points[roads.pairs], axis=1)[:, 0].T).sum()
    assert length == pytest.approx(lines.length.sum(), rel=1e-3)
    assert read(lines, node_crossings=True)[2] == ''


@pytest.mark.parametrize(('heights', 'more', 'parts', 'words'), [
    ((300.0, 308.0), {}, 2, 'at different heights or levels do not meet, at 1 places'),
    ((300.0, 301.5), {}, 1, ''), ((0.0, -8.0), {}, 2, 'do not meet'),
    ((None, 308.0), {}, 1, ''),  # one of them has no heights
    ((None, None), {'bridge': ['yes', 'no']}, 2, 'do not meet'),
    ((None, None), {'F_ELEV': [0, 1], 'T_ELEV': [0, 1]}, 2, 'do not meet'),
    ((None, None), {'F_ELEV': [0, 1], 'T_ELEV': [0, 0], 'layer': [0, 0]}, 1, ''),
])
@pytest.mark.parametrize('vertex', [True, False])
def test_roads_at_different_heights_do_not_meet(heights, more, parts, words, vertex):
    shapes = []
    for z, line in zip(heights, (STRAIGHT, [(400.0, -50.0), (400.0, 0.0), (400.0, 50.0)]),
                       strict=True):
        line = line if vertex else [line[0], line[2]]
        shapes.append(LineString(line if z is None else [(*at, z) for at in line]))
    lines = geopandas.GeoDataFrame({'highway': ['road', 'road'], **more}, geometry=shapes, crs=CRS)
    roads, said = heard(read_roads, lines, node_crossings=True)
    graph = networkx.Graph(map(tuple, roads.pairs.tolist()))
    # Between its ends, a road that climbs meets others at their vertices only.
    assert networkx.number_connected_components(graph) == parts + (
        not vertex and 'layer' in more)
    assert (words in said) or not vertex


def test_lines_across_the_antimeridian_join():
    """A line cut at 180 degrees (RFC 7946) is one road."""
    cut = MultiLineString([[(179.99, 0.0), (180.0, 0.0)], [(-180.0, 0.0), (-179.99, 0.0)]])
    other = LineString([(-179.995, -0.01), (-179.995, 0.01)])
    lines = geopandas.GeoDataFrame(geometry=[cut, other], crs='EPSG:4326')
    roads = read_roads(lines, node_crossings=True)
    graph = networkx.Graph(map(tuple, roads.pairs.tolist()))
    assert networkx.number_connected_components(graph) == 1
    assert np.ptp(roads.points[:, 0]) == pytest.approx(0.02)


@pytest.mark.parametrize(('source', 'words'), [
    (42, 'a int is neither a file nor a GeoDataFrame'),
    (geopandas.GeoDataFrame(geometry=[Point(1, 1)]), 'no LineString in it, but 1 Point'),
    (networkx.DiGraph([(1, 2)]), r'a DiGraph is .*osmnx.graph_to_gdfs\(graph, nodes=False\)'),
    (table({'highway': 'path'}, {'highway': 'steps'}), '2 of 2 lines are no roads .*path 1'),
    (table({'highway': 'road', 'oneway': 'sometimes'}).iloc[1:],
     'known values of oneway are yes, true'),
])
def test_other_kinds_of_roads_are_refused(source, words):
    with pytest.raises(InvalidOption, match=words):
        NetworkOptions(method='graph', graph=source)


def test_features_of_other_kinds_are_counted(tmp_path):
    lines = table({'highway': 'track'})
    more = geopandas.GeoDataFrame({'highway': ['crossing', 'x', None]}, geometry=[
        Point(1, 1), Polygon([(0, 0), (1, 0), (1, 1)]), None], crs=CRS)
    geopandas.pd.concat((lines, more)).to_file(tmp_path / 'a.gpkg')
    found, _, said = read(tmp_path / 'a.gpkg')
    assert found == BOTH
    assert '3 of 5 features are left out: 1 Point, 1 Polygon, 1 without a geometry' in said
