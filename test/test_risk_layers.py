# SPDX-License-Identifier: Apache-2.0
"""Risk maps from layers: each formula against another way to compute it, and bad input."""

import json
import math
import re

import numpy as np
import pytest
import yaml

pytest.importorskip('geopandas', reason='vector files need geopandas')
import geopandas
import rasterio
import shapely
from commands import run_here, run_script, script_of
from rasters import write_geotiff
from shapely.geometry import LineString, Point, box

from ambush_planner.commands import cli
from ambush_planner.commands.risk import occupancy_of
from ambush_planner.maps import Elevation, TerrainOptions, ViewOptions, terrain_map
from ambush_planner.maps.map_file import read_map
from ambush_planner.maps.occupancy import OccupancyOptions, risk_from_occupancy
from ambush_planner.maps.risk_layers import InvalidLayers, risk_from_layers
from ambush_planner.maps.risk_map_file import read_risk_map

CRS = 'EPSG:32633'
WEST, SOUTH, STEP, ROWS, COLUMNS = 455000.0, 5410000.0, 20.0, 50, 60
GRID = {'crs': CRS, 'resolution': STEP,
        'bounds': [WEST, SOUTH, WEST + COLUMNS * STEP, SOUTH + ROWS * STEP]}


def cells():
    """Centres (H W, 2) of the cells."""
    v, u = np.mgrid[0:ROWS, 0:COLUMNS]
    return np.stack((WEST + (u + 0.5) * STEP, SOUTH + (v + 0.5) * STEP), axis=-1).reshape(-1, 2)


def on_grid(values):
    return np.asarray(values).reshape(ROWS, COLUMNS)


def rows(*shapes, crs=CRS, **attributes):
    return geopandas.GeoDataFrame(attributes or None, geometry=list(shapes), crs=crs)


def at(x, y):
    return Point(WEST + x, SOUTH + y)


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('layers')
    rng = np.random.default_rng(2)
    heights = 80.0 * np.sin(np.mgrid[0:ROWS, 0:COLUMNS][1] / 6.0) + rng.normal(0.0, 0.5, (ROWS, 1))
    write_geotiff(folder / 'dem.tif', heights[::-1].astype(np.float32), CRS,
                  (STEP, 0.0, WEST, 0.0, -STEP, SOUTH + ROWS * STEP))
    zones = rows(at(300, 300).buffer(150), at(400, 300).buffer(150), severity=[1.5, 2.5],
                 barred=['no', 'yes'])
    zones.to_crs('EPSG:4326').to_file(folder / 'zones.geojson', COORDINATE_PRECISION=9)
    rows(LineString([(WEST + 10, SOUTH + 500), (WEST + 1190, SOUTH + 630)]),
         LineString([(WEST + 600, SOUTH + 15), (WEST + 655, SOUTH + 985)]),
         highway=['track', 'service'], width=[30.0, 0.0]).to_file(folder / 'roads.gpkg')
    places = np.concatenate((rng.normal(600.0, 60.0, (40, 2)), rng.uniform(0, 1000, (20, 2))))
    dates = np.datetime64('2025-01-01') + rng.integers(0, 400, 60).astype('timedelta64[D]')
    rows(*(at(*each) for each in places), date=dates.astype(str),
         dead=rng.integers(1, 4, 60)).to_file(folder / 'incidents.gpkg')
    return folder


def joined(folder, *layers, **top):
    return risk_from_layers({**top, 'layers': list(layers)}, folder)


def test_terrain_alone_is_the_terrain_map(folder):
    risk_map = joined(folder, {'terrain': 'dem.tif', 'weapon_range': 200}).risk_map
    with rasterio.open(folder / 'dem.tif') as file:
        heights = file.read(1)[::-1]
    made = terrain_map(Elevation(heights, STEP),
                       TerrainOptions(view=ViewOptions(weapon_range=200.0)))
    expected = risk_from_occupancy(made.values, STEP)
    free = ~expected.obstacles
    assert free.any() and np.array_equal(risk_map.obstacles, expected.obstacles)
    assert np.allclose(risk_map.alpha[free], expected.alpha[free], rtol=1e-12)
    assert (risk_map.crs, risk_map.origin) == (CRS, (WEST, SOUTH, 0.0))
    grid = occupancy_of(risk_map)
    assert np.array_equal(grid.values, made.values) and grid.losses == (1.0, 10.0)


def test_polygons_and_roads_in_their_order(folder):
    zones = geopandas.read_file(folder / 'zones.geojson').to_crs(CRS)
    roads = geopandas.read_file(folder / 'roads.gpkg')
    squares = shapely.box(*(cells() - STEP / 2).T, *(cells() + STEP / 2).T)
    inside = [on_grid(shapely.contains_xy(zone, cells())) for zone in zones.geometry]
    ribbons = [roads.geometry[0].buffer(15.0), roads.geometry[1]]
    road = on_grid(np.any([shapely.intersects(squares, each) for each in ribbons], axis=0))
    made = joined(
        folder, {'polygons': 'zones.geojson', 'loss': 'severity', 'factor': 2},
        {'roads': 'roads.gpkg', 'width': 'width', 'loss': 1, 'factor': 0.5, 'forbidden': True},
        {'roads': 'roads.gpkg|layername=roads', 'loss': 0.25},
        {'polygons': 'zones.geojson', 'forbidden': 'barred'}, base=3, **GRID)
    loss = (3.0 + 1.5 * inside[0] + 2.5 * inside[1]) * 2.0 ** (inside[0] * 1 + inside[1])
    loss = np.where(road, (loss + 1.0) * 0.5, loss)
    thin = on_grid(np.any([shapely.intersects(squares, each) for each in roads.geometry], axis=0))
    barred = on_grid(shapely.intersects(squares, zones.geometry[1]))
    assert np.mean(made.risk_map.alpha != loss + 0.25 * thin) < 0.002  # cells that are just touched
    assert np.mean(made.risk_map.obstacles != (road | barred)) < 0.002
    assert [layer.file for layer in made.layers][::3] == ['zones.geojson'] * 2


def test_roads_open_obstacles_that_forbidden_polygons_close_and_held_ground_costs_nothing(folder):
    layers = [{'terrain': 'dem.tif'}, {'roads': 'roads.gpkg', 'width': 'width', 'passable': True},
              {'polygons': 'zones.geojson', 'held': True},
              {'polygons': 'zones.geojson', 'forbidden': 'barred'}]
    steps = [joined(folder, *layers[:k]).risk_map for k in range(1, 5)]
    lines = geopandas.read_file(folder / 'roads.gpkg')
    squares = shapely.box(*(cells() - STEP / 2).T, *(cells() + STEP / 2).T)
    road = on_grid(shapely.intersects(squares, lines.buffer(lines.width / 2.0).where(
        lines.width > 0.0, lines.geometry).union_all()))
    assert (steps[0].obstacles & road).any() and not steps[1].obstacles[road].any()
    assert np.array_equal(steps[0].obstacles | road, steps[1].obstacles | road)
    assert np.isfinite(steps[1].alpha).all()
    secured = steps[2].alpha == 0.0
    zones = geopandas.read_file(folder / 'zones.geojson').to_crs(CRS).union_all()
    assert np.mean(secured != on_grid(shapely.contains_xy(zones, cells()))) < 0.002
    assert (steps[3].obstacles & secured).any() and not (steps[3].obstacles & secured).all()


@pytest.mark.parametrize('options', [
    {'bandwidth': 80}, {'bandwidth': 80, 'half_life': 90, 'weight': 'dead'},
    {'bandwidth': 120, 'half_life': 30},
])
def test_incidents_against_the_sum_over_all(folder, options):
    known = geopandas.read_file(folder / 'incidents.gpkg')
    places = shapely.get_coordinates(known.geometry)
    dates = np.array(known.date.astype(str).str[:10].tolist(), 'datetime64[D]')
    days = (dates.max() - dates).astype(float)
    weight = known.dead.to_numpy(float) if 'weight' in options else np.ones(60)
    weight = weight * 0.5 ** (days / options.get('half_life', math.inf))
    apart = np.hypot(*(cells()[:, None] - places).transpose(2, 0, 1))
    h = options['bandwidth']
    density = on_grid(np.exp(-(apart**2) / (2.0 * h**2)) @ weight)
    made = joined(folder, {'incidents': 'incidents.gpkg', 'loss': 4, **options}, base=1.5, **GRID)
    assert np.allclose(made.risk_map.alpha, 1.5 + 4.0 * density / density.max())
    few = 'half_life' in options
    assert few == (weight.sum() / weight.max() < 20.0)
    assert any('recent ones' in each for each in made.remarks) == few


POLYGON = rows(box(WEST, SOUTH, WEST + 100, SOUTH + 100))


@pytest.mark.parametrize(('text', 'features', 'words'), [
    ('layers: [', None, 'YAML'), ('- 3', None, 'keys and values'),
    ('until: 2024-13-01', None, 'month'),
    ('layers: []', None, 'layers'),
    ('layers: [{land: dem.tif}]', None, 'layer 1 .*terrain, polygons, roads, incid'),
    ('layers: [{polygons: x, los: 3}]', None, r'layer 1 \(polygons\): .*los'),
    ('{grid: 3, layers: [{polygons: x}]}', None, 'grid'),
    ('layers: [{terrain: none.tif}]', None, r'layer 1 \(terrain\): .*none.tif'),
    ('GRID {polygons: x.gpkg}\n- {terrain: dem.tif}', POLYGON, r'layer 2 \(terrain\)'),
    ('layers: [{polygons: x.gpkg}]', POLYGON, 'resolution: .*bounds: '),
    ('{resolution: 0.001, bounds: [0, 0, 31000, 31000], layers: [{polygons: x.gpkg}]}', POLYGON,
     '31000000 x 31000000 .* 0.001 m'),
    ('GRID {polygons: y.gpkg}', POLYGON, 'y.gpkg: no such file'),
    ('GRID {polygons: x.gpkg}', rows(at(9, 9)), r'1 of 1 shapes are no polygons \(1 Point\)'),
    ('GRID {incidents: x.gpkg}', POLYGON, 'x.gpkg: no layer with Point in it, but x .Polygon'),
    ('FREE {polygons: x.gpkg}', POLYGON.to_crs(4326), 'not in metres'),
    ('GRID {polygons: x.gpkg}', POLYGON.translate(9e3).to_frame('geometry'), 'nothing in it lies'),
    ('GRID {polygons: x.gpkg, loss: height}', POLYGON, "'height'"),
    ('GRID {polygons: x.gpkg, loss: -1}', POLYGON, 'loss .*-1'),
    ('GRID {polygons: x.gpkg, factor: kind}', POLYGON.assign(kind='town'), "'kind' of 1 of 1"),
    ('GRID {incidents: x.gpkg, bandwidth: 5}', rows(at(9, 9)), 'bandwidth .* 20, got 5'),
    ('GRID {incidents: x.gpkg}', rows(at(9, 9)), 'Give the bandwidth in metres'),
    ('GRID {incidents: x.gpkg, half_life: 9}', rows(at(9, 9)), "'date'"),
    ('GRID {incidents: x.gpkg, half_life: 9}', rows(at(9, 9), date=['May?']), "date has 'May.'"),
])
def test_bad_input_is_named_and_nothing_is_written(text, features, words, tmp_path):
    grid = {key: GRID[key] for key in ('resolution', 'bounds')}
    for word, keys in (('GRID', GRID), ('FREE', grid)):
        text = text.replace(word, '\n'.join(f'{k}: {v}' for k, v in keys.items()) + '\nlayers:\n-')
    (tmp_path / 'layers.yaml').write_text(text)
    if features is not None:
        features.to_file(tmp_path / 'x.gpkg')
    with pytest.raises((InvalidLayers, ValueError), match=words):
        risk_from_layers(tmp_path / 'layers.yaml')
    before = sorted(tmp_path.iterdir())
    done = run_here(cli, 'risk', tmp_path / 'layers.yaml', '-o', tmp_path / 'm.yaml')
    assert done.code == 3 and re.fullmatch('ambush risk: .*\n', done.err)
    assert sorted(tmp_path.iterdir()) == before


def test_the_files_that_the_command_writes(folder, tmp_path, capsys):
    layers = [{'terrain': 'dem.tif'}, {'polygons': 'zones.geojson', 'loss': 6},
              {'incidents': 'incidents.gpkg', 'bandwidth': 80, 'half_life': 9},
              {'roads': 'roads.gpkg'},
              {'polygons': 'zones.geojson', 'held': True}]
    (folder / 'layers.yaml').write_text(yaml.safe_dump({'layers': layers}))
    output = tmp_path / 'map.yaml'
    assert cli.main(['risk', str(folder / 'layers.yaml'), '-o', str(output), '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    expected = risk_from_layers(folder / 'layers.yaml').risk_map
    exact = read_risk_map(output.with_suffix('.npz'))
    assert np.array_equal(exact.alpha, expected.alpha) and exact.crs == CRS
    assert np.array_equal(exact.obstacles, expected.obstacles) and exact.origin == expected.origin
    grid = read_map(output)
    scale = result['alpha_max'] - result['alpha_min']
    free = ~expected.obstacles
    assert np.array_equal(grid.values == 100, ~free)
    read = result['alpha_min'] + scale * grid.values[free] / 100.0
    assert np.abs(read - expected.alpha[free]).max() <= scale / 200.0 * (1.0 + 1e-9)
    # The map and the GeoTIFF name their losses, which options of one's own replace.
    for name in ('map.yaml', 'map.tif'):
        losses = read_risk_map(tmp_path / name).alpha[free]
        assert np.abs(losses - exact.alpha[free]).max() <= 0.01 * scale
        other = read_risk_map(tmp_path / name, OccupancyOptions(alpha_max=20.0))
        assert other.alpha[free].min() == 1.0
    assert np.array_equal(read_map(output).values, read_risk_map_values(output.with_suffix('.tif')))
    assert 'recent ones' in result['remarks'][1]
    assert output.with_suffix('.png').stat().st_size > 20_000


def read_risk_map_values(path):
    with rasterio.open(path) as file:
        return file.read(1)[::-1]


@pytest.mark.slow
@pytest.mark.parametrize('name', ['roads', 'risk_layers'])
def test_every_block_of_the_documents_works(name, tmp_path):
    done = run_script(script_of(f'docs/{name}.md'), tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
