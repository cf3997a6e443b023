# SPDX-License-Identifier: Apache-2.0
"""Which lines are roads, in which direction and how fast: tables of attributes and formats."""

import math

import numpy as np
import pytest

pytest.importorskip('geopandas', reason='vector files need geopandas')
import geopandas
import networkx
from commands import heard
from shapely.geometry import LineString, MultiLineString, Point, Polygon

from ambush_planner import InvalidOption, NetworkOptions
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
    around = {'highway': 'primary', **(around or {})} if around is not False else {}
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
      for key, value in (('waterway', 'river'), ('power', 'line'), ('railway', 'rail'),
                         ('boundary', 'administrative'), ('route', 'ferry'), ('barrier', 'fence'),
                         ('man_made', 'pipeline'), ('aeroway', 'runway'),
                         ('aerialway', 'cable_car'))),
    *(({'highway': kind}, NONE, f': {kind} 1') for kind in (
        'footway', 'path', 'cycleway', 'steps', 'pedestrian', 'bridleway', 'construction',
        'proposed', 'platform', 'raceway', 'busway', 'corridor', 'rest_area')),
    ({'name': 'a line'}, NONE, 'without highway 1'),
    *(({'highway': 'service', **tags}, NONE, f'{key}={value}') for tags, key, value in (
        ({'access': 'no'}, 'access', 'no'), ({'access': 'private'}, 'access', 'private'),
        ({'motor_vehicle': 'no', 'access': 'yes'}, 'access', 'no'),
        ({'vehicle': 'forestry'}, 'access', 'forestry'), ({'motorcar': 'no'}, 'access', 'no'),
        ({'area': 'yes'}, 'area', 'yes'), ({'oneway': 'N'}, 'oneway', 'n'),
        ({'smoothness': 'impassable'}, 'smoothness', 'impassable'),
        ({'oneway': 'reversible'}, 'oneway', 'reversible'),
        ({'oneway': 'alternating'}, 'oneway', 'alternating'),
        ({'oneway': 'sometimes'}, 'oneway', 'sometimes'))),
    ({'highway': 'tertiary', 'construction': 'yes'}, NONE, 'construction 1'),
    *(({'highway': kind}, BOTH, '') for kind in (
        'trunk', 'secondary_link', 'unclassified', 'residential', 'living_street', 'service',
        'track', 'road', "['path', 'residential']")),
    ({'highway': 'residential', 'railway': 'tram'}, BOTH, ''),
    ({'highway': 'service', 'access': 'no', 'motor_vehicle': 'yes'}, BOTH, ''),
    ({'highway': 'service', 'access': 'destination'}, BOTH, ''),
    ({'highway': 'primary', 'construction': 'minor'}, BOTH, ''),
    ({'highway': 'motorway'}, AHEAD, ''), ({'highway': 'motorway_link'}, AHEAD, ''),
    ({'highway': 'motorway', 'oneway': 'no'}, BOTH, ''),
    ({'highway': 'primary', 'junction': 'roundabout'}, AHEAD, ''),
    ({'highway': 'primary', 'junction': 'circular'}, AHEAD, ''),
    *(({'highway': 'primary', 'oneway': value}, BACK, '')
      for value in ('-1', 'reverse', 'T', 'TF', '-1.0')),
    *(({'highway': 'primary', 'oneway': value}, AHEAD, '')
      for value in ('yes', 'true', '1', 'F', 'FT', 'True')),
    *(({'highway': 'primary', 'oneway': value}, BOTH, '') for value in ('no', 'B', '0', 'False')),
    ({'highway': 'primary', 'oneway': 'no', 'oneway:motor_vehicle': 'yes'}, AHEAD, ''),
    ({'highway': 'primary', 'oneway:bicycle': 'yes'}, BOTH, ''),
    ({'HIGHWAY': 'primary', 'ONEWAY': '-1'}, BACK, ''),
    ({'highway': 'primary', 'Oneway': 'yes'}, AHEAD, ''),
    *(({'highway': 'primary', name: 'yes'}, AHEAD, f'{name!r} is read as oneway')
      for name in ('one_way', 'ONE_WAY', 'OneWay_', 'One-Way')),
    *(({'highway': 'primary', name: 'F'}, BOTH, f'{name!r} is not read')
      for name in ('DIR_TRAVEL', 'direction', 'sens', 'one_way_street', 'SPEED_LIM')),
])
def test_which_lines_are_roads_in_which_direction(tags, drivable, words):
    found, _, said = read(table(tags, {'HIGHWAY': 'primary'} if 'HIGHWAY' in tags else None))
    assert found == drivable and words in said and bool(words) == bool(said)


@pytest.mark.parametrize(('tags', 'drivable', 'words'), [
    ({'waterway': 'canal'}, NONE, 'waterway=canal'), ({'railway': 'rail'}, NONE, 'railway=rail'),
    ({'fclass': 'footway'}, NONE, 'footway'), ({'fclass': 'track_grade3'}, BOTH, ''),
    ({'fclass': 'motorway', 'oneway': 'F'}, AHEAD, ''), ({'ROUTE': 'US 27'}, BOTH, ''),
    ({'STATUS': 'open', 'AREA': 'North', 'LAYER': 'Roads'}, BOTH, ''), ({}, BOTH, ''),
])
def test_lines_without_the_tags_of_openstreetmap(tags, drivable, words):
    around = {'fclass': 'primary'} if 'fclass' in tags else {}
    lines = table(tags, around).drop(columns='highway')
    found, _, said = read(lines)
    assert found == drivable and words in said and bool(words) == bool(said)


@pytest.mark.parametrize(('name', 'values', 'speed', 'words'), [
    ('speed_kph', (36.0, 36.0), 10.0, ''), ('SPEED_KPH', ('36', '36'), 10.0, ''),
    ('speed_mph', (10, 10), 4.4704, ''), ('speed_mps', (7.5, 7.5), 7.5, ''),
    ('SpeedKPH', (36, 36), 10.0, 'read as speed_kph'), ('speed-kmh', (18, 18), 5.0, 'speed_kmh'),
    ('speed_kph', ('36 km/h', '10 mph'), 4.4704, ''),
    ('speed_kph', ('36', '10 knots'), None, 'must be numbers'),
    ('speed_kph', (36.0, None), None, '1 of 2 lines have no speed'),
    ('speed_kph', (36.0, 0.0), None, 'no speed above 0'), ('maxspeed', (50, 50), 1.0, 'not read'),
    ('speed', (50, 50), 1.0, "'speed' is not read"),
])
def test_speeds_and_their_units(name, values, speed, words):
    lines = table({}, False).assign(**{name: values})
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


@pytest.mark.parametrize(('tags', 'drivable'), [
    ({'waterway': 'river'}, NONE), ({'power': 'line'}, NONE), ({'railway': 'rail'}, NONE),
    ({'highway': 'footway'}, NONE), ({'highway': 'primary', 'motor_vehicle': 'no'}, NONE),
    ({'boundary': 'administrative'}, NONE), ({'route': 'ferry'}, NONE),
    ({'highway': 'primary', 'oneway': '-1'}, BACK), ({'highway': 'motorway'}, AHEAD),
    ({'highway': 'primary', 'oneway': 'reversible'}, NONE), ({'highway': 'track'}, BOTH),
])
def test_openstreetmap_files(tags, drivable, tmp_path):
    text = ''.join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
    (tmp_path / 'A.OSM').write_text(OSM.replace('TAGS', text))
    found, _, said = read(tmp_path / 'A.OSM')
    assert found == drivable and bool(said) == (drivable == NONE)


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
    ([(400.0, -50.0), (420.0, 50.0)], {'tunnel': 'yes'}, 0),
    ([(400.0, -50.0), (420.0, 50.0)], {'layer': '1'}, 0),
    ([(400.0, -50.0), (420.0, 50.0)], {'layer': '0', 'bridge': 'no'}, 1),
    ([(400.0, -50.0), (400.0, 0.0), (400.0, 50.0)], {}, 0),  # a junction
    ([(900.0, -50.0), (900.0, 50.0)], {}, 0), ([(0.0, 0.0), (0.0, -90.0)], {}, 0),
])
@pytest.mark.parametrize('crs', [CRS, 'EPSG:4326'])
def test_crossings_without_a_shared_vertex_are_counted_or_joined(second, tags, count, crs):
    scale = 1.0 if crs == CRS else 1e-5
    lines = table(tags, shape=second).assign(highway='primary')
    lines.geometry = [LineString(STRAIGHT), LineString(second)]
    lines = lines.set_geometry(lines.scale(scale, scale, origin=(0, 0))).set_crs(
        crs, allow_override=True)
    *_, said = read(lines)
    assert (f'at {count} places' in said) == (count > 0)
    roads = read_roads(lines, node_crossings=True)
    graph = networkx.Graph(map(tuple, roads.pairs.tolist()))
    meets = count > 0 or (400.0, 0.0) in second or (0.0, 0.0) in second
    assert networkx.number_connected_components(graph) == (1 if meets else 2)
    length = np.hypot(*np.diff(roads.points[roads.pairs], axis=1)[:, 0].T).sum()
    assert length == pytest.approx(lines.length.sum() if crs == CRS else length)
    assert read(lines, node_crossings=True)[2] == ''


def graph_of(**attributes):
    graph = networkx.MultiDiGraph(crs=CRS)
    for node, (x, y) in enumerate([*ROUND, STRAIGHT[1]]):
        graph.add_node(node, x=x, y=y)
    for tail, head in ((0, 1), (1, 2), (2, 1), (1, 0)):
        graph.add_edge(tail, head, highway='primary')
    graph.add_edge(0, 3, **attributes)
    graph.add_edge(3, 2, geometry=LineString([(800.0, 0.0), (600.0, 0.0), (400.0, 0.0)]),
                   **attributes)  # drawn the other way round
    return graph


def test_graphs_of_networkx():
    for attributes, drivable in (({'highway': 'primary', 'oneway': True}, AHEAD),
                                 ({'highway': 'footway'}, NONE), ({'highway': ['track']}, AHEAD)):
        graph = graph_of(**attributes)
        assert read(graph)[0] == drivable
        for *_, tags in graph.edges(data=True):
            tags.update({key: str(value) for key, value in tags.items()})  # as in GraphML
        assert read(graph)[0] == drivable
    assert read(graph_of(highway='primary').to_undirected())[0] == BOTH
    simple = networkx.Graph([(0, 1)])
    simple.nodes[0]['pos'], simple.nodes[1]['pos'] = (0.0, 0.0), (9.0, 0.0)
    assert read(simple)[0] == BOTH
    options = NetworkOptions(method='graph', graph=graph_of(highway='primary'))
    assert len(options.roads.pairs) == 5


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
    (42, 'a int is neither a file, a GeoDataFrame nor a graph'),
    (geopandas.GeoDataFrame(geometry=[Point(1, 1)]), 'no LineString in it, but 1 Point'),
    (networkx.DiGraph([(1, 2)]), 'node 1 has no numbers x and y'),
    (table({'highway': 'path'}, {'highway': 'steps'}), '2 of 2 lines are no roads .*path 1'),
    (table({'oneway': 'sometimes'}).iloc[1:], 'known values of oneway are yes, true'),
])
def test_other_kinds_of_roads_are_refused(source, words):
    with pytest.raises(InvalidOption, match=words):
        NetworkOptions(method='graph', graph=source)


def test_files_of_other_drivers_and_damaged_ones_are_refused(tmp_path):
    (tmp_path / 'a.geojson').write_text(
        '<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>b.gpkg</SrcDataSource>'
        '</OGRVRTLayer></OGRVRTDataSource>')
    table({}).to_file(tmp_path / 'b.gpkg')
    table({}).to_file(tmp_path / 'whole.shp')
    data = (tmp_path / 'b.gpkg').read_bytes()
    (tmp_path / 'c.gpkg').write_bytes(data[:3000])
    (tmp_path / 'd.graphml').write_text('<graphml>')
    for name, words in (('a.geojson', 'GeoJSON'), ('c.gpkg', 'damaged, or end early'),
                        ('d.graphml', r'save_graph_geopackage\(')):
        with pytest.raises(InvalidOption, match=words) as refused:
            read_roads(tmp_path / name)
        assert '\n' not in str(refused.value)
    assert read(tmp_path / 'whole.shp')[0] == NONE  # it has no highway


def test_features_of_other_kinds_are_counted(tmp_path):
    lines = table({'highway': 'track'})
    more = geopandas.GeoDataFrame({'highway': ['crossing', 'x', None]}, geometry=[
        Point(1, 1), Polygon([(0, 0), (1, 0), (1, 1)]), None], crs=CRS)
    geopandas.pd.concat((lines, more)).to_file(tmp_path / 'a.gpkg')
    found, _, said = read(tmp_path / 'a.gpkg')
    assert found == BOTH
    assert '3 of 5 features are left out: 1 Point, 1 Polygon, 1 without a geometry' in said
