# SPDX-License-Identifier: Apache-2.0
"""Files that people have: each row of the tables on what is said of them, and those read aright."""

import re
import shutil

import numpy as np
import pytest

pytest.importorskip('geopandas', reason='vector files need geopandas')
pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')
import geopandas
import pyproj
from commands import heard, run_here, table_under
from field_samples import (
    CORNER,
    CRS,
    GROUND,
    OSM,
    ROADS,
    TABLES,
    TIMES,
    lines,
    roads,
    rows,
    save,
    tracks,
)
from rasters import write_geotiff
from scipy.io import netcdf_file
from shapely.geometry import Point, Polygon, box

from ambush_planner import AmbushPlannerError, read_risk_map
from ambush_planner.commands import risk as risk_command
from ambush_planner.commands.positions import _xy, positions_in
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.elevation_file import read_raster
from ambush_planner.maps.risk_layers import risk_from_layers
from ambush_planner.maps.road_file import read_roads
from ambush_planner.maps.terrain_risk import TerrainOptions, terrain_of_file
from ambush_planner.maps.visibility import ViewOptions

ROW, COLUMN = np.mgrid[:40, :40]
HILLS = np.rint(300.0 + 20.0 * np.sin(COLUMN / 4.0) + 10.0 * np.cos(ROW / 5.0)).astype('float32')
PLACE = (10.0, 0.0, CORNER[0], 0.0, -10.0, CORNER[1] + 400.0)
OLD_PRJ = ('Projection UTM\nZone 33\nDatum WGS84\nZunits {}\nUnits METERS\nSpheroid WGS84\n'
           'Parameters\n')
SITE = 'LOCAL_CS["site",UNIT["foot",0.3048],AXIS["x",EAST],AXIS["y",NORTH]]'
NEAR = TerrainOptions(view=ViewOptions(weapon_range=60.0))


def tif(folder, values=HILLS, crs=CRS, place=PLACE, name='a.tif', **declared):
    return write_geotiff(folder / name, values, crs, place, **declared)


def heights(values=HILLS, given=None, **declared):
    """Read heights [m]."""
    def say(folder):
        raster, said = heard(read_raster, tif(folder, values, **declared), crs=given)
        np.testing.assert_allclose(raster.values[::-1], values, rtol=1e-5)
        return said
    return say


def ascii_grid(z_unit):
    """A grid of ESRI, and its system in the old form."""
    def say(folder):
        header = (f'ncols 40\nnrows 40\nxllcorner {CORNER[0]}\nyllcorner {CORNER[1]}\n'
                  'cellsize 10\n')
        rows = '\n'.join(' '.join(f'{each:.4f}' for each in row) for row in HILLS)
        (folder / 'a.asc').write_text(header + rows)
        (folder / 'a.prj').write_text(OLD_PRJ.format(z_unit))
        raster, said = heard(read_raster, folder / 'a.asc')
        np.testing.assert_allclose(raster.values[::-1], HILLS, rtol=1e-5)
        return said
    return say


def netcdf(stored=HILLS, unit='m', length=1.0, names=('z',), **attributes):
    """Read heights from a NetCDF file whose coordinates have a unit of some length [m]."""
    def say(folder):
        with netcdf_file(folder / 'a.nc', 'w') as file:
            for name, first, step in (('y', PLACE[5], -10.0), ('x', PLACE[2], 10.0)):
                file.createDimension(name, 40)
                axis = file.createVariable(name, 'f8', (name,))
                axis[:] = (first + step * (np.arange(40) + 0.5)) / length
                axis.units, axis.standard_name = unit, f'projection_{name}_coordinate'
            system = file.createVariable('crs', 'i4', ())
            system.spatial_ref = pyproj.CRS(CRS).to_wkt('WKT1_GDAL')
            for name in names:
                band = file.createVariable(name, stored.dtype, ('y', 'x'))
                band[:], band.grid_mapping = stored, 'crs'
                for key, value in attributes.items():
                    setattr(band, key, value)
        raster, said = heard(read_raster, folder / 'a.nc')
        np.testing.assert_allclose(raster.values[::-1], HILLS, atol=0.06)
        return said
    return say


def risk(values, **declared):
    def say(folder):
        return heard(read_risk_map, tif(folder, values, **declared))[1]
    return say


def ditch(folder):
    fine = np.full((200, 200), 300.0, 'float32')
    fine[:, 90:92] = 290.0
    file = tif(folder, fine, place=(2.0, 0.0, CORNER[0], 0.0, -2.0, CORNER[1] + 400.0))
    made, said = heard(terrain_of_file, file, NEAR, 20.0)
    assert (made.values == 100).any(axis=1).all()
    return said


def position(text, xy=None):
    """Read a position as it is typed for a map."""
    def say(folder):
        (found,) = positions_in(text)
        place = _xy('start', found, GROUND)
        assert np.hypot(*(place - xy)) < 2.0
        return ''
    return say


MIDDLE = CORNER + 205.0
LATITUDE, LONGITUDE = Coordinates(CRS).to_lat_lon(MIDDLE).tolist()
GIS = {
    'heights of a band called `elev_ft`': heights(description='elev_ft'),
    'a grid whose `.prj` says `Zunits FEET`': ascii_grid('FEET'),
    'heights in metres by the band, in US survey feet by the vertical system': heights(
        crs=f'{CRS}+6360', unit='m'),
    'heights in decametres, `dam`': netcdf(HILLS / 10.0, units='dam'),
    'NetCDF with `positive: down`': netcdf(units='m', positive='Down'),
    'NetCDF with `long_name: water depth`': netcdf(long_name='water depth'),
    'NetCDF whose `x` and `y` are in km, but its system in metres': netcdf(unit='km', length=1e3),
    'NetCDF with two variables': netcdf(names=('dem', 'error')),
    'a raster of roads, `ambush risk dem.tif --roads roads.tif`': lambda folder: run_here(
        risk_command, tif(folder), '--roads', tif(folder, name='roads.tif'), '-o', 'm.yaml'
    ).err.strip(),
    'the ellipsoid of Bessel and no datum': heights(
        crs='+proj=tmerc +lon_0=15 +x_0=500000 +ellps=bessel +units=m'),
    'a site grid in feet': heights(crs=SITE),
    '`--crs EPSG:32634` for a file that says EPSG:32633': heights(given='EPSG:32634'),
    'cells of 20 m from a model with a ditch 4 m wide': ditch,
    'an elevation model as a map': risk(HILLS, unit='ft'),
    '`--start 36S UG 68 12`': position('36S UG 68 12'),
    '`--start 37,06096 31,32974`': position('37,06096 31,32974'),
    'a northing before the easting, on the map': position('{1} {0}'.format(*MIDDLE)),
    '`--start "48 50.5N 14 23.1E"`': position('48 50.5N 14 23.1E'),
}


def layer(shapes, top=None, crs=CRS, **keys):
    """Make the map of one layer of shapes; other lists are attributes."""
    def say(folder):
        kept = {key: value for key, value in keys.items() if isinstance(value, list)}
        frame = geopandas.GeoDataFrame(kept or None, geometry=shapes, crs=crs)
        save(frame, folder / 'a.gpkg', layer='one')
        if 'other' in keys:
            save(frame, folder / 'a.gpkg', layer=keys['other'])
        tif(folder, name='dem.tif')
        line = {key: value for key, value in keys.items() if key not in (*kept, 'other')}
        terrain = [{'terrain': 'dem.tif', 'weapon_range': 60}]
        made, said = heard(risk_from_layers, {**(top or {}), 'layers': [
            *terrain, {'polygons': 'a.gpkg', **line}]}, folder)
        return ' '.join((said, *made.remarks))
    return say


FIELD, MINE = box(*(CORNER + 50.0), *(CORNER + 150.0)), Point(CORNER + 305.0)
IN_DEGREES = geopandas.GeoSeries([FIELD], crs=CRS).to_crs(4326)[0]
LAYERS = {
    'polygons without a system': layer([FIELD], crs=None),
    'polygons whose latitude comes first': layer(
        [Polygon([(y, x) for x, y in IN_DEGREES.exterior.coords])], crs=4326),
    'a point among `forbidden` polygons': layer([FIELD, MINE], forbidden=True),
    'a polygon with the form of an 8': layer([Polygon(CORNER + [
        (50.0, 50.0), (250.0, 250.0), (250.0, 50.0), (50.0, 250.0)])]),
    'a `forbidden` polygon that has lost its shape': layer([FIELD, None], forbidden=True),
    '`loss: risk`, which is `high` once': layer([FIELD, FIELD], risk=['2', 'high'], loss='risk'),
    '`loss: risk`, with a decimal comma': layer([FIELD, FIELD], risk=['2', '1,5'], loss='risk'),
    '`loss: severity`, without such an attribute': layer([FIELD], risk=[1], loss='severity'),
    'a file with two layers of polygons': layer([FIELD], other='two'),
    '`crs: EPSG:32634` for a terrain that says EPSG:32633': layer([FIELD], {'crs': 'EPSG:32634'}),
}
SECTION = 'What is said of other files'
PAGES = {'roads': ROADS, 'tables': TABLES, 'gis': GIS, 'risk_layers': LAYERS}
CASES = [(samples[given], said) for page, samples in PAGES.items()
         for given, said in table_under(f'docs/{page}.md', SECTION) if given in samples]


@pytest.mark.parametrize('page', PAGES)
def test_every_row_of_the_documents_is_tried(page):
    documented = [given for given, _ in table_under(f'docs/{page}.md', SECTION)]
    assert sorted(documented) == sorted(PAGES[page])


@pytest.mark.parametrize(('sample', 'documented'), CASES, ids=[said or 'none' for _, said in CASES])
def test_what_is_said_is_what_the_documents_say(sample, documented, tmp_path, recwarn):
    try:
        said = sample(tmp_path)
    except AmbushPlannerError as error:
        said = str(error)
    assert '\n' not in said
    parts = re.findall('`([^`]+)`', documented)
    for words in parts:
        # Names of options for programs are not on the page.
        assert words in re.sub(r' \((road_column, )?(all_lines_are_roads|two_way)\)', '', said)
    assert bool(said) == bool(parts)
    assert not [each for each in recwarn if 'ambush_planner' not in str(each.category)]


def long_border(folder):
    """Held ground south of a parallel of 6 degrees, in one edge."""
    low, high = Coordinates(CRS).to_lat_lon([CORNER, CORNER + 400.0])
    middle = (low[0] + high[0]) / 2.0
    geopandas.GeoDataFrame(geometry=[box(12.0, 45.0, 18.0, middle)], crs=4326).to_file(
        folder / 'a.gpkg')
    made = risk_from_layers({'crs': CRS, 'resolution': 10.0, 'bounds': [*CORNER, *(CORNER + 400.0)],
                             'layers': [{'polygons': 'a.gpkg', 'held': True}]}, folder).risk_map
    assert (made.alpha == 0.0).sum(axis=0).tolist() == pytest.approx([20] * 40, abs=1)


def copied(name, crs=CRS, **options):
    def read(folder):
        frame = lines(highway=['road', 'road'], oneway=['no', 'no']).to_crs(crs)
        assert roads(name, frame, **options)(folder) == ''
    return read


def many_factors(folder):
    """Polygons that overlap, each with a factor of its own: at each cell, their product."""
    factors = np.linspace(0.5, 2.0, 60)
    edges = CORNER[0] + np.linspace(5.0, 395.0, 60)
    shapes = [box(edge, CORNER[1], CORNER[0] + 400.0, CORNER[1] + 400.0) for edge in edges]
    geopandas.GeoDataFrame({'f': factors}, geometry=shapes, crs=CRS).to_file(folder / 'a.gpkg')
    whole_map = {'crs': CRS, 'resolution': 10.0, 'bounds': [*CORNER, *(CORNER + 400.0)]}
    whole = geopandas.GeoDataFrame(geometry=[box(*whole_map['bounds'])], crs=CRS)
    whole.to_file(folder / 'b.gpkg')
    made = risk_from_layers({**whole_map, 'layers': [
        {'polygons': 'b.gpkg', 'loss': 2.0}, {'polygons': 'a.gpkg', 'factor': 'f'}]}, folder)
    centres = CORNER[0] + np.arange(5.0, 400.0, 10.0)
    product = [factors[edges < centre].prod() for centre in centres]
    alpha = np.asarray(made.risk_map.alpha)
    np.testing.assert_allclose(alpha[7] / alpha[7, 0], np.divide(product, product[0]), rtol=1e-5)


def renumbered(folder):
    """OpenStreetMap XML as other programs than its server write it: numbers fall, and are large."""
    text = OSM.replace('TAGS', '<tag k="highway" v="track"/>')
    (folder / 'a.osm').write_text(re.sub(
        r'\b(id|ref)="(\d+)"', lambda match: f'{match[1]}="{2**60 - int(match[2])}"', text))
    given, said = heard(read_roads, str(folder / 'a.osm'))
    assert len(given.pairs) == 4 and not said


def in_a_folder(folder):
    frame = lines(highway=['road', 'road'], oneway=['no', 'no'])
    frame.to_file(folder / 'a.shp')
    shutil.move(folder / 'a.shp', folder / 'a.SHP')
    assert roads('a.SHP')(folder) == ''


RIGHT = {
    'held ground with a long border': long_border,
    'OpenStreetMap with other numbers': renumbered, 'factors': many_factors,
    'GeoJSON in CRS84': copied('a.geojson', 'OGC:CRS84'), 'GML': copied('a.gml', 4326),
    'a shapefile in US survey feet': copied('a.shp', 2264),
    'FlatGeobuf in Gauss-Krueger': copied('a.fgb', 31468), 'MapInfo': copied('a.tab'),
    'SQLite': copied('a.sqlite'), '.SHP': in_a_folder,
    'NetCDF with scale_factor': netcdf((HILLS * 10.0).astype('i2'), scale_factor=0.1),
    'a grid in metres': ascii_grid('NO'), 'DEM 10 m': heights(description='DEM 10 m'),
    '`time` and `Time`': tracks(rows('x,y,Time,time', ['06:00'] * 20, TIMES)),
    'signs': position(f'{LATITUDE:.6f}°, {LONGITUDE:.6f}°', MIDDLE),
    'MGRS in one word': position('33UVQ5520510205', MIDDLE),
}


@pytest.mark.parametrize('name', RIGHT)
def test_these_are_read_without_a_word(name, tmp_path):
    assert not RIGHT[name](tmp_path)
