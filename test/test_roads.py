# SPDX-License-Identifier: Apache-2.0
"""Networks of roads: against networkx and the files themselves; a recording node."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import networkx
import numpy as np
import pytest
from commands import run_here
from games import exact_value, lp_value

pytest.importorskip('geopandas', reason='vector files need geopandas')
import geopandas
import shapely
from shapely.geometry import LineString, MultiLineString

from ambush_planner import (
    GameOptions,
    GoalBlocked,
    InvalidOption,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    RiskMap,
    StartBlocked,
    StrategyOptions,
    build_network,
    plan_trip,
)
from ambush_planner.commands import frontier, hold, judge, plan
from ambush_planner.network import construction
from ambush_planner.planning.options import ROAD_TUBE
from ambush_planner.planning.plan import departure_paths

CRS = 'EPSG:32633'
CORNER = (455000.0, 5410000.0)
START, GOAL = (63.0, 57.0), (1100.0, 1000.0)
EXACT = StrategyOptions(max_detour=math.inf, risk_slack=0.0)


def town():
    """Bent streets, a third of them one-way, and an expressway that only bridges them.

    They follow a grid plan; streets that meet share a vertex there.
    """
    rng = np.random.default_rng(4)
    place = 50.0 + 100.0 * np.stack(np.mgrid[0:12, 0:12], axis=-1)
    place += rng.uniform(-25.0, 25.0, place.shape)
    streets = [*place, *place.transpose(1, 0, 2)]
    one_way = ['no', 'yes', '-1'] * 8
    # Another bend between junctions, off the straight line.
    lines = [LineString(np.stack((each[:-1], (each[:-1] + each[1:]) / 2 + 9.0), axis=1)
                        .reshape(-1, 2).tolist() + [each[-1].tolist()]) for each in streets]
    lines.append(LineString([place[0, 0], (560.0, 610.0), place[11, 11]]))
    speeds = [30.0] * 24 + [90.0]
    return geopandas.GeoDataFrame({
        'highway': 'tertiary', 'oneway': [*one_way, None], 'speed_kph': speeds}, geometry=lines,
        crs=CRS)


@pytest.fixture(scope='module')
def streets(tmp_path_factory):
    """The town as GeoJSON in degrees and as a layer of a GeoPackage, both far from the origin."""
    folder, rows = tmp_path_factory.mktemp('town'), town()
    rows.geometry = rows.translate(*CORNER)
    rows.to_crs('EPSG:4326').to_file(folder / 'town.geojson', COORDINATE_PRECISION=9)
    rows.set_geometry(rows.centroid).to_file(folder / 'town.gpkg', layer='names')
    rows.to_file(folder / 'town.gpkg', layer='streets')
    rows.drop(columns='speed_kph').to_file(folder / 'untimed.gpkg')
    return folder


def ground(crs=CRS, corner=CORNER):
    v, u = np.mgrid[0:240, 0:240] / 240
    alpha = 1.0 + 5.0 * np.sin(5.0 * u) ** 2 * np.cos(4.0 * v) ** 2
    return RiskMap(alpha, np.zeros(alpha.shape, bool), 5.0, (*corner, 0.0), crs)


def on_map(xy):
    return tuple(np.add(xy, CORNER).tolist())


def roads(streets, name='untimed.gpkg', **options):
    return NetworkOptions(method='graph', graph=str(streets / name), **{'spacing': 40.0, **options})


def as_networkx(timed):
    """The town's streets vertex by vertex, with costs."""
    graph = networkx.DiGraph()
    for row in town().itertuples():
        chain = [tuple(np.round(each, 6)) for each in row.geometry.coords]
        speed = row.speed_kph / 3.6 if timed else 1.0
        for a, b in pairwise(chain):
            cost = math.dist(a, b) / speed
            if row.oneway != '-1':
                graph.add_edge(a, b, cost=cost)
            if row.oneway != 'yes':
                graph.add_edge(b, a, cost=cost)
    return graph


@pytest.mark.parametrize(('name', 'detour'), [
    ('town.geojson', math.inf), ('town.gpkg', 1.2), ('untimed.gpkg', math.inf)])
def test_a_town_against_networkx(streets, name, detour):
    """Least cost and value; from junction to junction, so that both graphs have the ends."""
    timed, graph = name != 'untimed.gpkg', as_networkx(name != 'untimed.gpkg')
    lines = town().geometry
    ends = lines[2].coords[2], lines[8].coords[20]
    options = PlanningOptions(network=roads(streets, name), game=GameOptions(),
                              strategy=replace(EXACT, max_detour=detour))
    plan = plan_trip(ground(), *map(on_map, ends), options)
    strategy, network = plan.strategy, plan.network
    least = networkx.shortest_path_length(graph, *(tuple(np.round(each, 6)) for each in ends),
                                          weight='cost')
    assert network.travel_unit == ('s' if timed else 'm')
    assert strategy.shortest_length == pytest.approx(least, rel=1e-6)
    assert strategy.expected_length <= detour * least * (1.0 + 1e-6)
    value = float(exact_value(network)) if detour == math.inf else lp_value(
        network, detour * strategy.shortest_length)
    assert strategy.value == pytest.approx(value, rel=1e-4)
    assert strategy.lower_bound <= value * (1.0 + 1e-9)


def test_nodes_and_edges_are_those_of_the_file(streets):
    network = build_network(ground(), on_map(START), on_map(GOAL), roads(streets))
    points, lines = network.points - CORNER, list(town().geometry)
    vertices = np.unique(shapely.get_coordinates(lines).round(6), axis=0)
    (far,) = {round(float(np.hypot(*(points - each).T).min()), 4) for each in vertices}
    assert far == 0.0
    joins = np.isin(network.edges, [network.source, network.target]).any(axis=1)
    assert joins.sum() == 2
    segments = shapely.linestrings(points[network.edges[~joins]])
    assert shapely.distance(segments, MultiLineString(lines)).max() < 1e-6
    middles = shapely.line_interpolate_point(segments, 0.5, normalized=True)
    assert shapely.distance(middles, MultiLineString(lines)).max() < 1e-6
    assert network.lengths[~joins].max() <= 40.0
    both = sum(each.length * (1 if way in ('yes', '-1') else 2)
               for each, way in zip(lines, town().oneway, strict=True))
    assert network.lengths[~joins].sum() == pytest.approx(both, rel=1e-6)
    # The bridge leads over 20 streets and meets none of them.
    bridge = [np.argmin(np.hypot(*(points - each).T)) for each in lines[-1].coords]
    assert np.isin(network.tails, bridge[1]).sum() == 2
    inner = np.delete(np.arange(len(points)), [network.source, network.target])
    assert np.array_equal(network.alpha[inner], ground().alpha[ground().cells(points[inner])])


@pytest.mark.parametrize(('game', 'tube'), [
    (GameOptions(ambush_radius=45.0, secured_radius=150.0), None),
    (GameOptions(secured_radius=150.0), 3.0)])
def test_paths_keep_to_the_roads(streets, game, tube):
    options = PlanningOptions(network=roads(streets, 'town.gpkg|layername=streets'), game=game)
    options = replace(options, drive=replace(options.drive, tube=tube))
    plan = plan_trip(ground(), on_map(START), on_map(GOAL), options)
    near = MultiLineString([*town().geometry, LineString([START, (50.0, 50.0)])])
    joins = [np.flatnonzero((plan.network.edges == end).any(axis=1))[0]
             for end in (plan.network.source, plan.network.target)]
    near = shapely.union_all([near, *shapely.linestrings(
        plan.network.points[plan.network.edges[joins]] - CORNER)])
    off = []
    for path in departure_paths(plan, 20, 5.0, np.random.default_rng(1)):
        assert path[0, :2].tolist() == list(on_map(START))
        assert path[-1, :2].tolist() == list(on_map(GOAL))
        off.append(shapely.distance(shapely.points(path[:, :2] - CORNER), near).max())
    assert 0.5 * (tube or ROAD_TUBE) < max(off) <= (tube or ROAD_TUBE) + 1e-6
    edges = set(map(tuple, plan.network.edges.tolist()))
    route = plan.strategy.sample_route(np.random.default_rng(2)).tolist()
    assert edges.issuperset(pairwise(route))


def test_plan_judge_hold_and_frontier_play_on_the_same_roads(streets, tmp_path, monkeypatch):
    """With the length budget of the trips, each has the value and the network of ``plan``."""
    pytest.importorskip('matplotlib', reason='pictures need matplotlib')
    risk_map, sizes = ground(), set()
    np.savez(tmp_path / 'map.npz', alpha=risk_map.alpha, obstacles=risk_map.obstacles,
             resolution=risk_map.resolution, origin=risk_map.origin, crs=CRS)
    build = construction.road_trip_graph

    def count_nodes(*arguments):
        made = build(*arguments)
        sizes.add(len(made.points))
        return made

    monkeypatch.setattr(construction, 'road_trip_graph', count_nodes)

    def numbers(command, *arguments):
        done = run_here(command, tmp_path / 'map.npz', *arguments, '--roads',
                        streets / 'untimed.gpkg', '--start', *on_map(START), '--goal',
                        *on_map(GOAL), '--reach', 30, '--secured', 150, '--json', '--set',
                        'network.spacing=60')
        assert done.code == 0, done.err
        return json.loads(done.out)

    numbers(plan, '-n', 3, '-o', tmp_path / 'trips.geojson')
    trips = geopandas.read_file(tmp_path / 'trips.geojson', where="layer = 'routes'")
    trips[['geometry']].to_file(tmp_path / 'trips.gpkg')
    judged = numbers(judge, tmp_path / 'trips.gpkg', '-o', tmp_path / 'judge.png')
    detour = judged['max_detour']
    x, y = on_map((600.0, 600.0))
    (tmp_path / 'corner.csv').write_text(f'name,x,y\ncorner,{x},{y}\n')
    (swept, _) = numbers(frontier, '--detours', detour, '--slacks', 0.01, '--detour', detour, '-o',
                         tmp_path / 'f.csv')['rows']
    found = [numbers(plan, '--detour', detour, '-o', tmp_path / 'routes.csv'), judged['optimal'],
             numbers(hold, '--detour', detour, '--radius', 60, '-k', 1, '-o', tmp_path / 'h.png',
                     '--candidates', tmp_path / 'corner.csv'),
             swept]
    for each in found:
        assert each['value'] == pytest.approx(found[0]['value'], rel=1e-3)
        assert each['lower_bound'] == pytest.approx(found[0]['lower_bound'], rel=1e-3)
    assert len(judged['left_out']) == 0 and len(sizes) == 1
    assert judged['optimal']['value'] <= judged['reweighted']['value']


def nav2_graph(edges, **properties):
    """A square of 10 m with these (start, end) edges, as nav2_route writes it."""
    corners = [(1.0, 1.0), (11.0, 1.0), (11.0, 11.0), (1.0, 11.0)]
    features = [{'type': 'Feature', 'properties': {'id': k + 7, 'frame': 'map'},
                 'geometry': {'type': 'Point', 'coordinates': list(each)}}
                for k, each in enumerate(corners)]
    for k, (a, b, *bends) in enumerate(edges):
        way = [list(corners[a]), *bends, list(corners[b % 4])]
        features.append({'type': 'Feature', 'geometry': {'type': 'MultiLineString',
                                                         'coordinates': [way]},
                         'properties': {'id': 100 + k, 'startid': a + 7, 'endid': b + 7,
                                        **properties}})
    return json.dumps({'type': 'FeatureCollection', 'features': features})


def test_a_graph_of_nav2_route(tmp_path):
    file = tmp_path / 'graph.geojson'
    file.write_text(nav2_graph([(0, 1), (1, 2), (0, 3), (3, 2, [6.0, 12.0])],
                               metadata={'abs_speed_limit': 0.5}))
    risk_map = RiskMap(np.ones((30, 30)), np.zeros((30, 30), bool), 0.5)
    options = NetworkOptions(method='graph', spacing=20.0, graph=str(file))
    network = build_network(risk_map, (1.0, 1.0), (11.0, 11.0), options)
    ways = {tuple(map(tuple, each)) for each in network.points[network.edges].tolist()}
    assert ways == {((1, 1), (11, 1)), ((11, 1), (11, 11)), ((1, 1), (1, 11)), ((1, 11), (6, 12)),
                    ((6, 12), (11, 11))}
    assert np.allclose(network.seconds, network.lengths / 0.5)
    with pytest.raises(NoRoute, match='one-way'):
        build_network(risk_map, (11.0, 1.0), (1.0, 11.0), options)


def lines(*coordinates, crs=CRS, **attributes):
    return geopandas.GeoDataFrame({'highway': ['road'] * len(coordinates), **attributes},
                                  geometry=list(map(LineString, coordinates)), crs=crs)


STREET = [(10.0, 10.0), (90.0, 10.0)]


@pytest.mark.parametrize(('file', 'rows', 'words'), [
    ('none.gpkg', None, 'none.gpkg|No such file'),
    ('text.gpkg', 'no roads', 'text.gpkg'),
    ('bad.geojson', '{"features": [{"properties": {"startid": 1}}]}', 'bad.geojson'),
    ('nav2.geojson', nav2_graph([(0, 9)]), 'edge 100: .*16'),
])
def test_bad_files_are_refused_in_one_sentence(file, rows, words, tmp_path):
    if isinstance(rows, str):
        (tmp_path / file).write_text(rows)
    elif rows is not None:
        rows.to_file(tmp_path / file)
    with pytest.raises(InvalidOption, match=words) as refused:
        NetworkOptions(method='graph', graph=str(tmp_path / file))
    assert str(refused.value).startswith('graph') and '\n' not in str(refused.value)


@pytest.mark.parametrize(('rows', 'options', 'error', 'words'), [
    (lines(STREET, crs='EPSG:4326'), {}, InvalidOption, 'not in metres .WGS 84'),
    (lines(STREET, crs='EPSG:2263'), {}, InvalidOption, 'not in metres .NAD83'),
    (lines(STREET, crs=None), {'join_distance': 5.0}, StartBlocked,
     r'start \(20.000, 20.000\) .*10.0 m .*join_distance'),
    (lines(STREET, crs=None), {}, GoalBlocked, 'goal .*70.0 m'),
    (lines([(500.0, 0.0), (900.0, 0.0)], crs=None), {}, StartBlocked, 'without roads'),
    (lines(STREET, [(60.0, 80.0), (95.0, 80.0)], crs=None), {}, NoRoute,
     '2 separate parts, of 0.09 and 0.035 km, 70 m apart'),
    (lines(STREET, [(90.0, 10.0), (90.0, 80.0)], crs=None, oneway=['no', '-1']), {}, NoRoute,
     'one-way'),
    (lines(STREET, [(90.0, 10.0), (90.0, 80.0)], crs=None), {'clearance': 3.0}, NoRoute,
     'obstacles .*2 pieces'),
    (lines(STREET, crs=None), {'spacing': 1e-9}, InvalidOption, 'spacing'),
])
def test_roads_that_do_not_fit_are_refused(rows, options, error, words, tmp_path):
    rows.to_file(tmp_path / 'roads.gpkg')
    obstacles = np.zeros((100, 100), bool)
    obstacles[50, 88] = True  # a metre from the second street
    risk_map = RiskMap(np.ones((100, 100)), obstacles, 1.0)
    with pytest.raises(error, match=words):
        build_network(risk_map, (20.0, 20.0), (90.0, 80.0), NetworkOptions(
            method='graph', graph=str(tmp_path / 'roads.gpkg'), **{'spacing': 10.0, **options}))


def test_a_node_logs_what_its_road_file_leaves_open(tmp_path):
    """Roads that cross without a shared vertex, once, as the file is read once."""
    ros, waiting = map(pytest.importorskip, ('ros_harness', 'waiting'))
    file = tmp_path / 'roads.gpkg'
    rows = lines([(1.0, 5.0), (9.0, 5.0)], [(5.0, 1.0), (5.0, 9.0)], crs=None)
    rows.rename(columns={'highway': 'klasse'}).to_file(file)
    parameters = {'network.method': 'graph', 'network.graph': str(file),
                  'network.road_column': 'klasse=road', 'network.two_way': True}
    with waiting.stderr_in(tmp_path / 'log') as said, ros.stage(parameters=parameters) as running:
        assert said().count('[WARN]') == 2 and 'roads cross' in said()
        assert 'its coordinate system is unknown' in said()
        running.use({'network.method': 'uniform_delaunay'})
        running.use({'network.method': 'graph'})


def test_a_node_drives_on_roads_and_its_recordings_hold(tmp_path, capsys):
    """An obstacle closes a road. The recording has the roads, so the file may change."""
    ros = pytest.importorskip('ros_harness')
    from ambush_planner.commands import verify

    file = tmp_path / 'roads.gpkg'
    lines([(1.0, 5.0), (3.0, 5.0), (3.5, 8.5), (6.5, 8.5), (9.0, 5.0)],
          [(3.0, 5.0), (3.5, 2.0), (6.5, 2.0), (9.0, 5.0)],
          crs=None, speed_kph=[5.0, 4.0]).to_file(file)
    parameters = {'network.method': 'graph', 'network.graph': str(file),
                  'network.join_distance': 1.0}
    with ros.stage(tmp_path / 'runs', parameters) as running:
        client = running.give(ros.risk_grid(), (1.5, 5.5), (8.5, 5.5))
        assert client.call('new_route').success
        for row, high in ((17, False), (3, True)):
            grid = ros.risk_grid()
            grid.data[row * grid.info.width + 10] = 100
            client.publish('alpha_map', grid)
            client.call_until('new_route', lambda answer, high=high: answer.success and (
                max(each.pose.position.y for each in client.last('path').poses) > 8.0) == high)
        bad = running.planner.set_parameters([ros.Parameter('network.graph', value='/none')])[0]
        assert not bad.successful and 'read-only' in bad.reason
        file.unlink()
        running.use({'replan.tolerance': 0.1})
        assert client.call('new_route').success, 'the roads are known'
    code = verify.main([str(tmp_path / 'runs'), '--replan'])
    assert code == 0, capsys.readouterr().out
