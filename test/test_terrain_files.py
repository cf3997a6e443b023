# SPDX-License-Identifier: Apache-2.0
"""Elevation models read, maps written and read back, and ``ambush risk`` as a user starts it."""

import numpy as np
import pytest
import yaml

pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')
import pyproj
from commands import run_here
from rasters import write_geotiff

from ambush_planner import AmbushPlannerWarning, InvalidRiskMap
from ambush_planner.commands import risk
from ambush_planner.maps import InvalidTerrain
from ambush_planner.maps.elevation_file import read_raster
from ambush_planner.maps.map_file import read_map, write_map
from ambush_planner.maps.occupancy import OccupancyMap


def test_rejects_files_that_are_broken_or_no_rasters(tmp_path):
    np.savez(tmp_path / 'a.npz', elevation=np.zeros((30, 30)))
    whole = write_geotiff(tmp_path / 'whole.tif', np.zeros((300, 300))).read_bytes()
    (tmp_path / 'half.tif').write_bytes(whole[: len(whole) // 2])
    (tmp_path / 'b.tif').write_text('hello')
    for name in ('a.npz', 'half.tif', 'b.tif'):
        with pytest.raises(InvalidTerrain, match=name):
            read_raster(tmp_path / name)


@pytest.mark.parametrize(('crs', 'west', 'north', 'step', 'utm'), [
    ('EPSG:4326', 18.4, -33.9, 1 / 1200, 'EPSG:32734'),
    ('EPSG:3857', -9.37e6, 4.37e6, 100.0, 'EPSG:32616'),  # its metres are 0.81 m there
    ('EPSG:2264', 1.5e6, 6e5, 300.0, 'EPSG:32617'),  # feet
])
def test_a_geotiff_without_true_metres_is_reprojected_to_its_utm_zone(tmp_path, crs, west, north,
                                                                      step, utm):
    """Heights that are a plane in the source come out as pyproj says, cell by cell."""
    rows, columns = np.mgrid[:40, :40] + 0.5
    path = write_geotiff(tmp_path / 'a.tif', 3.0 * rows - columns, crs,
                         (step, 0, west, 0, -step, north), unit='m')
    with pytest.warns(AmbushPlannerWarning, match=f'reprojected .*{utm}'):
        raster = read_raster(path)
    assert raster.crs == utm
    assert np.isnan(raster.values[[0, 0, -1, -1], [0, -1, 0, -1]]).any()  # the area is rotated
    inner = (slice(8, -8),) * 2
    row, column = np.mgrid[: raster.values.shape[0], : raster.values.shape[1]] + 0.5
    back = pyproj.Transformer.from_crs(utm, crs, always_xy=True)
    x, y = back.transform(raster.corner[0] + column * raster.column_step,
                          raster.corner[1] + row * raster.row_step)
    expected = 3.0 * (north - y) / step - (x - west) / step
    np.testing.assert_allclose(raster.values[inner], expected[inner], atol=1e-3)


@pytest.mark.parametrize('shape', [(1, 1), (13, 10)])
def test_written_maps_read_back_unchanged(tmp_path, shape):
    """Also if Pillow has read the image and written it as PNG."""
    image = pytest.importorskip('PIL.Image', reason='Pillow comes with the extra "figures"')
    values = np.random.default_rng(1).integers(-1, 101, shape).astype(np.int8)
    file = tmp_path / 'm.yaml'
    picture = write_map(file, OccupancyMap(values, 0.05, (-3.0, 2.5, 0.1)), 'one\ntwo')
    assert file.read_text().startswith('# one\n# two\nimage: m.pgm\n')
    with image.open(picture) as opened:
        opened.save(tmp_path / 'm.png')
    for name in ('m.pgm', 'm.png'):
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {'image': name}))
        result = read_map(file)
        np.testing.assert_array_equal(result.values, values)
        assert (result.resolution, result.origin) == (0.05, (-3.0, 2.5, 0.1))


def test_modes_of_map_server(tmp_path):
    (tmp_path / 'm.pgm').write_bytes(b'P5 # comment\n5 1\n255\n' + bytes([255, 205, 128, 80, 0]))
    common = {'image': 'm.pgm', 'resolution': 1.0, 'origin': [0, 0, 0], 'negate': 0,
              'occupied_thresh': 0.65, 'free_thresh': 0.25}
    for extra, expected in (
        ({}, [0, 0, -1, 100, 100]),
        ({'negate': 1}, [100, 100, -1, -1, 0]),
        ({'mode': 'scale'}, [0, 0, 62, 100, 100]),
        ({'mode': 'scale', 'occupied_thresh': 1.0, 'free_thresh': 0.0}, [0, 20, 50, 69, 100]),
        ({'mode': 'raw'}, [-1, -1, -1, 80, 0]),
    ):
        (tmp_path / 'm.yaml').write_text(yaml.safe_dump(common | extra))
        assert read_map(tmp_path / 'm.yaml').values[0].tolist() == expected


@pytest.mark.parametrize(('change', 'reason'), [
    ({'image': None}, 'image'), ({'mode': 'colour'}, 'mode'), ({'resolution': 0.0}, 'resolution'),
    ({'resolution': 'x'}, 'resolution'), ({'origin': [0, 0]}, 'origin'),
    ({'image': 'short.pgm'}, 'too short'), ({'image': 'text.pgm'}, 'not a readable image'),
])
def test_rejects_malformed_map_files(tmp_path, change, reason):
    write_map(tmp_path / 'm.yaml', OccupancyMap(np.zeros((3, 3), np.int8), 1.0))
    (tmp_path / 'short.pgm').write_bytes(b'P5 30 30 255\nab')
    (tmp_path / 'text.pgm').write_text('hello')
    fields = yaml.safe_load((tmp_path / 'm.yaml').read_text()) | change
    fields = {name: value for name, value in fields.items() if value is not None}
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(fields))
    with pytest.raises(InvalidRiskMap, match=reason):
        read_map(tmp_path / 'm.yaml')


def test_the_command_leaves_map_picture_and_preview(tmp_path):
    pytest.importorskip('matplotlib', reason='the preview takes the extra "figures"')
    row, column = np.mgrid[:80, :120]
    heights = 40.0 * np.sin(row / 9.0) * np.cos(column / 7.0)
    heights[:10, :10] = np.nan
    dem = write_geotiff(tmp_path / 'dem.tif', heights, None, (10.0, 0.0, 0.0, 0.0, -10.0, 800.0))
    done = run_here(risk, dem, '-o', tmp_path / 'm.yaml', '--weapon-range', 100)
    assert done.code == 0, done.err
    result = read_map(tmp_path / 'm.yaml')
    assert result.values.shape == (80, 120) and result.resolution == 10.0
    assert (result.values[70:, :10] == -1).all()  # the file's first rows are in the north
    assert '120 x 80 cells of 10 m' in done.out
    assert (tmp_path / 'm.png').read_bytes().startswith(b'\x89PNG')
