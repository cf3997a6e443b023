# SPDX-License-Identifier: Apache-2.0
"""Declarations of rasters and images are applied, refused, or named if ignored: tables."""

import re

import numpy as np
import pytest
import yaml

pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')
pytest.importorskip('PIL', reason='Pillow comes with the extra "figures"')
import rasterio
from commands import heard
from PIL import Image
from rasters import SQUARE, UTM
from rasters import write_geotiff as write

from ambush_planner import AmbushPlannerError, read_risk_map
from ambush_planner.maps.elevation_file import read_raster
from ambush_planner.maps.map_file import read_map

ROW, COLUMN = np.mgrid[:30, :40]
HILLS = np.rint(300.0 + 20.0 * np.sin(COLUMN / 4.0) + 10.0 * np.cos(ROW / 5.0))
RISK = (HILLS - HILLS.min()).astype(np.uint8)
HOLE = np.s_[8:20, 10:22]
DEGREES = (1 / 3600, 0.0, -84.3, 0.0, -1 / 3600, 36.6)


def read(path, is_risk=False, **more):
    """The values, north first, and what was said."""
    raster, said = heard(read_raster, path, is_risk, **more)
    return raster.values[::-1], said


def as_stored(scale, offset, kind):
    return np.rint((HILLS - offset) / scale).astype(kind)


@pytest.mark.parametrize(('scale', 'offset', 'kind'), [
    (0.01, -100.0, 'uint16'), (-1.0, 0.0, 'int16'), (0.5, 250.0, 'uint8'),
    (10.0, 300.0, 'float64'),
])
def test_scale_and_offset_are_applied(scale, offset, kind, tmp_path):
    stored = as_stored(scale, offset, kind)
    if kind[0] == 'f':
        stored = ((HILLS - offset) / scale).astype(kind)
    values, said = read(write(tmp_path / 'a.tif', stored, scale=scale, offset=offset))
    np.testing.assert_allclose(values, HILLS, atol=max(0.5 * scale, 1e-3))
    assert said == ''


def test_scale_counts_for_risk_nodata_and_in_other_systems(tmp_path):
    half = (RISK // 2).astype(np.uint8)
    half[HOLE] = 255
    values, _ = read(write(tmp_path / 'a.tif', half, scale=2.0, nodata=255), True)
    assert np.isnan(values[HOLE]).all() and values[0, 0] == 2 * half[0, 0]
    tenths = as_stored(0.1, 0.0, 'int16')
    one, said = read(write(tmp_path / 'b.tif', tenths, 'EPSG:4326', DEGREES, scale=0.1))
    other, _ = read(write(tmp_path / 'c.tif', HILLS, 'EPSG:4326', DEGREES))
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert 'reprojected from WGS 84 to WGS 84 / UTM zone 16N' in said


@pytest.mark.parametrize(('declared', 'words'), [
    ({'unit': 'ft'}, "heights are in 'ft': convert them to metres"), ({'unit': 'Feet'}, 'Feet'),
    ({'unit': 'US survey foot'}, 'US survey foot'), ({'unit': 'ftUS'}, 'ftUS'),
    ({'unit': 'decimetres'}, 'decimetres'), ({'unit': 'furlong'}, 'furlong'),
    ({'units': 'feet'}, 'feet'), ({'description': 'Elevation [ft]'}, "'ft'"),
    ({'description': 'elev_ft'}, "'ft'"), ({'crs': 'EPSG:32616+6360'}, 'US survey foot'),
    ({'crs': 'EPSG:32616+6360', 'unit': 'm'}, 'US survey foot'),
    ({'crs': 'EPSG:32616+5715'}, 'are its values depths?'), ({'unit': 'm'}, ''),
    ({'unit': 'metre'}, ''), ({'crs': 'EPSG:32616+5773'}, ''),
    ({'description': 'Elevation (bare earth)'}, ''), ({'description': 'DEM 10 m'}, ''),
    ({'description': 'depth', 'positive': 'up'}, ''),
    ({'crs': 'EPSG:2274', 'place': (100.0, 0.0, 2.5e6, 0.0, -100.0, 7e5)}, 'are its heights in'),
])
def test_heights_in_other_units_are_refused(declared, words, tmp_path):
    path = write(tmp_path / 'a.tif', HILLS, **declared)
    if words:
        with pytest.raises(AmbushPlannerError, match=re.escape(words)):
            read(path)
    else:
        np.testing.assert_allclose(read(path)[0], HILLS, rtol=1e-7)


# The writer of the raster without a georeference is warned, too.
@pytest.mark.filterwarnings('ignore::rasterio.errors.NotGeoreferencedWarning')
@pytest.mark.parametrize(('declared', 'words'), [
    ({'colours': {1: (255, 0, 0)}}, 'table of colours'), ({'crs': None, 'place': (
        1, 0, 0, 0, 1, 0)}, 'no georeference'),
    ({'place': (9, 3, 0, 3, -9, 0)}, 'gdalwarp'),  # rotated
    ({'crs': 'EPSG:4326', 'place': (0.001, 0, 179.95, 0, -0.001, -85.0)},
     r'a\.tif: .*latitude -85'),  # near a pole
])
def test_what_cannot_be_applied_is_refused(declared, words, tmp_path):
    path = write(tmp_path / 'a.tif', (HILLS - 100.0).astype(np.uint8), **declared)
    with pytest.raises(AmbushPlannerError, match=words):
        read(path)


@pytest.mark.parametrize(('fill', 'kind', 'declared', 'words'), [
    (-9999, 'float32', {}, '144 of 1200 heights are unknown: outside -430 to 9000 m'),
    (np.inf, 'float32', {}, 'outside -430'), (32767, 'int16', {}, 'outside -430'),
    (-9999, 'int16', {'scale': 0.1}, 'outside -430'),
    (-9999, 'float32', {'nodata': -32768}, 'outside -430'),
    (-9999, 'float32', {'nodata': -9999}, ''), (np.nan, 'float32', {}, ''),
    (0, 'uint16', {'nodata': 0}, ''),
])
def test_numbers_for_no_data_are_unknown_and_counted(fill, kind, declared, words, tmp_path):
    stored = HILLS / declared.get('scale', 1.0)
    stored[HOLE] = fill
    values, said = read(write(tmp_path / 'a.tif', stored.astype(kind), **declared))
    assert np.isnan(values[HOLE]).all() and np.isnan(values).sum() == 144
    assert words in said and bool(words) == bool(said)


def test_holes_do_not_spread_in_a_reprojection(tmp_path):
    stored = HILLS.astype(np.float32)
    stored[HOLE], stored[25:, :9] = -9999, -32768
    values, said = read(write(tmp_path / 'a.tif', stored, 'EPSG:4326', DEGREES))
    assert np.nanmin(values) > 265.0 and said.count('unknown') == 1


@pytest.mark.parametrize('ground', [
    np.maximum(HILLS - 290.0, 0.0),  # the sea
    np.where(HILLS < 280.0, 278.0, HILLS),  # a lake
    np.where(ROW == 15, 100.0, HILLS + ROW),  # a gorge
    HILLS - 700.0 * (HILLS > 0.0) + 420.0, np.full_like(HILLS, 12.0),
])
def test_ground_as_it_is_on_earth_stays(ground, tmp_path):
    values, said = read(write(tmp_path / 'a.tif', ground + np.where(ROW == 15, COLUMN / 9.0, 0.0)))
    assert not np.isnan(values).any() and said == ''


def test_alpha_bands_and_masks_are_unknown(tmp_path):
    alpha = np.full(HILLS.shape, 255, np.uint8)
    alpha[HOLE] = 0
    low = (HILLS - 200.0).astype(np.uint8)
    masked = write(tmp_path / 'b.tif', low)
    with rasterio.open(masked, 'r+') as file:
        file.write_mask(alpha)
    for path in (write(tmp_path / 'a.tif', low, alpha=alpha), masked):
        values, _ = read(path)
        assert np.array_equal(np.isnan(values), alpha == 0)


def test_longitudes_to_360_and_files_without_a_system(tmp_path):
    east = (*DEGREES[:2], DEGREES[2] + 360.0, *DEGREES[3:])
    one, other = (read(write(tmp_path / 'a.tif', HILLS, 'EPSG:4326', place))[0]
                  for place in (DEGREES, east))
    np.testing.assert_allclose(one, other, atol=1e-6)
    known = read_raster(write(tmp_path / 'b.tif', HILLS, None), crs=UTM)
    assert known.crs == UTM and known.corner == (7.4e5, 4.05e6 - 900.0)
    read(write(tmp_path / 'c.tif', HILLS, None, DEGREES), crs='EPSG:4326')


@pytest.mark.parametrize(('values', 'declared', 'words'), [
    (HILLS - 265.5, {}, 'no whole numbers; .*ambush risk'), (RISK, {'unit': 'm'}, "unit is 'm'"),
    (RISK, {'description': 'DEM'}, "called 'DEM'"), (RISK, {'crs': 'EPSG:32616+5773'}, "'metre'"),
    (RISK, {'units': 'metres'}, "'metres'"),
    (HILLS.astype(np.int16), {}, 'cell values must be .* elevation model'),
    (RISK / 100.0, {}, 'risks from 0 to 1.*multiply by 100'),
    (RISK, {'colours': {1: (255, 0, 0)}}, 'table of colours'),
    (RISK, {'place': (30.0, 0.0, 7e5, 0.0, -60.0, 4e6)}, r'not square; .* gdalwarp -tr 30 30'),
    (RISK, {'crs': 'EPSG:4326', 'place': DEGREES}, 'gdalwarp -r near -t_srs EPSG:32616'),
])
def test_no_elevation_model_and_no_share_is_a_risk_map(values, declared, words, tmp_path):
    with pytest.raises(AmbushPlannerError, match=words):
        read_risk_map(write(tmp_path / 'a.tif', values, **declared))


@pytest.mark.parametrize(('values', 'words'), [
    (np.minimum(RISK, 1), 'no value is over 1, of 100'), (np.full_like(RISK, 7), 'no risk'),
    (RISK, ''),
])
def test_what_is_said_of_a_risk_map(values, words, tmp_path):
    risk_map, said = heard(read_risk_map, write(tmp_path / 'A.TIF', values, place=SQUARE))
    assert words in said and bool(words) == bool(said)
    assert not risk_map.obstacles.any() and risk_map.crs == UTM
    assert risk_map.size[1] == pytest.approx(-30 * SQUARE[4])


def test_files_are_known_by_their_content_and_others_name_the_formats(tmp_path):
    (tmp_path / 'a.vrt').write_text(
        '<VRTDataset rasterXSize="9" rasterYSize="9"><GeoTransform>0,1,0,9,0,-1</GeoTransform>'
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename>'
        '/vsicurl/http://localhost:9/a.tif</SourceFilename></SimpleSource></VRTRasterBand>'
        '</VRTDataset>')
    Image.fromarray(RISK).save(tmp_path / 'a.png')
    (tmp_path / 'a.txt').write_text('hello')
    for name, words in (('a.vrt', 'vsicurl.* is not here'), ('a.txt', 'a risk map is a .yaml'),
                        ('a.png', 'no raster that is read')):
        with pytest.raises(AmbushPlannerError, match=words):
            read_risk_map(tmp_path / name)
    grid = '\n'.join(' '.join(map(str, row)) for row in RISK.tolist())
    (tmp_path / 'risk.ASC').write_text('ncols 40\nnrows 30\nxllcorner 0\nyllcorner 0\ncellsize 30\n'
                                       + grid)
    np.testing.assert_allclose(read_risk_map(tmp_path / 'risk.ASC').alpha[::-1], 1 + RISK * 0.09)


# A wall of a dark grey with a gap, as map_server sees it: 0 is free, 100 an obstacle.
GREY = np.full((20, 30), 254, np.uint8)
GREY[:16, 14:16] = 24
WALL = np.where(GREY == 24, 100, 0)


def tiff(values, **options):
    def save(path):
        with rasterio.open(path, 'w', driver='GTiff', height=20, width=30, count=1,
                           dtype=values.dtype, **options) as file:
            file.write(values, 1)
    return save


def pgm(values, most):
    rows = '\n'.join(' '.join(map(str, row)) for row in values.tolist())
    return lambda path: path.write_text(f'P2\n30 20\n{most}\n{rows}\n')


DEEP = np.rint(GREY / 255.0 * 65535).astype(np.uint16)
IMAGES = {
    '8.png': Image.fromarray(GREY).save, 'a.png': Image.fromarray(GREY).convert('RGBA').save,
    '8.tif': tiff(GREY), '8.pgm': pgm(GREY, 255), '16.png': Image.fromarray(DEEP).save,
    '16.tif': tiff(DEEP), 'float.tif': tiff((GREY / 255.0).astype(np.float32)),
    '16.pgm': pgm(DEEP, 65535), '16.jp2': Image.fromarray(DEEP).save,
    'p5.pgm': lambda path: path.write_bytes(b'P5 30 20 65535\n' + DEEP.astype('>u2').tobytes()),
}


@pytest.mark.filterwarnings('ignore::rasterio.errors.NotGeoreferencedWarning')
@pytest.mark.parametrize('name', IMAGES)
def test_walls_are_walls_in_grey_with_8_bits_and_other_kinds_are_refused(name, tmp_path):
    IMAGES[name](tmp_path / name)
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(
        {'image': name, 'resolution': 0.5, 'origin': [0, 0, 0], 'negate': 0,
         'occupied_thresh': 0.65, 'free_thresh': 0.25}))
    if not name.startswith('8'):
        with pytest.raises(AmbushPlannerError, match=f'{name}: pixels .*to grey with 8 bits'):
            read_map(tmp_path / 'm.yaml')
        return
    np.testing.assert_array_equal(read_map(tmp_path / 'm.yaml').values[::-1], WALL)
