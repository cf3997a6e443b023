# SPDX-License-Identifier: Apache-2.0
"""Coordinate systems against pyproj and geodesics, and maps that keep them from file to file."""

import numpy as np
import pytest
from commands import heard
from games import HUNT, random_map
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

pytest.importorskip('pyproj', reason='coordinate systems take the extra "gis"')
pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')

import pyproj
from rasters import write_geotiff as write_raster

from ambush_planner import InvalidRiskMap
from ambush_planner.errors import InvalidCoordinates
from ambush_planner.maps import OccupancyOptions
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.elevation_file import read_raster
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.risk_map_file import read_risk_map, write_geotiff

GEOD = pyproj.Geod(ellps='WGS84')
# The zone of a place takes pyproj 0.1 s to find, so nothing is shrunk.
few = settings(max_examples=3 * HUNT, phases=[Phase.explicit, Phase.generate], deadline=None)
latitudes, longitudes = st.floats(-79.0, 83.0), st.floats(-180.0, 179.99)
# Towns, one on the coast of Norway, where zone 32 is widened.
ZONES = [(36.5, -84.2, 32616), (-33.9, 18.4, 32734), (60.4, 5.3, 32632), (-0.1, -78.5, 32717)]


@few
@given(latitudes, longitudes, st.floats(-4.0, 4.0), st.floats(0.0, 500.0), st.floats(-7.0, 7.0))
def test_a_robots_frame_is_that_of_its_datum(latitude, longitude, yaw, far, bearing):
    """A place some way off in a direction from true east has the same coordinates in the frame.

    Up to the scale of UTM, which is within 0.1 % of 1 (0.9996 to 1.001).
    """
    frame = Coordinates(f'datum {latitude} {longitude} {yaw}')
    azimuth = 90.0 - np.degrees(bearing + yaw)
    there = GEOD.fwd(longitude, latitude, azimuth, far)[1::-1]
    x, y = frame.from_lat_lon(there)
    assert (x, y) == pytest.approx((far * np.cos(bearing), far * np.sin(bearing)),
                                   abs=0.01 + 0.0015 * far)
    np.testing.assert_allclose(frame.to_lat_lon((x, y)), there, atol=1e-9)


@pytest.mark.parametrize(('latitude', 'longitude', 'code'), ZONES)
def test_a_datum_is_the_turned_utm_zone_of_navsat_transform(latitude, longitude, code):
    """It rotates the zone of the datum by yaw and the convergence there, and moves it."""
    zone, yaw = pyproj.Proj(code), 0.7
    turn = yaw + np.radians(zone.get_factors(longitude, latitude).meridian_convergence)
    offsets = np.random.default_rng(1).uniform(-3e3, 3e3, (50, 2))
    matrix = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    degrees = zone(*(offsets @ matrix + zone(longitude, latitude)).T, inverse=True)
    frame = Coordinates(f'datum {latitude} {longitude} {yaw}')
    np.testing.assert_allclose(frame.from_lat_lon(np.transpose(degrees[::-1])), offsets, atol=0.1)


@pytest.mark.parametrize('crs', ['EPSG:32616', 'EPSG:5070', 'EPSG:32616+5703',
                                 pyproj.CRS('EPSG:2193').to_wkt()])
def test_degrees_and_metres_are_those_of_pyproj(crs):
    system = Coordinates(crs)
    west, south, east, north = system.crs.area_of_use.bounds
    degrees = np.random.default_rng(1).uniform((south, west), (north, east), (50, 2))
    xy = system.from_lat_lon(degrees)
    there = pyproj.Transformer.from_crs(4326, system.crs).transform(*degrees.T)
    if system.crs.axis_info[0].direction == 'north':
        there = there[::-1]
    np.testing.assert_allclose(xy, np.transpose(there), atol=1e-3)
    np.testing.assert_allclose(system.to_lat_lon(xy), degrees, atol=1e-8)


@pytest.mark.parametrize(('crs', 'reason'), [
    ('EPSG:4326', 'metre'), ('EPSG:2264', 'metre'), ('', 'is unknown'),
    ('nonsense', "'nonsense'"), ('datum 1 2', '"datum LAT LON YAW"'),
    ('datum 89 0 0', 'no UTM zone'),
])
def test_unusable_systems_are_refused(crs, reason):
    with pytest.raises(InvalidCoordinates, match=reason):
        Coordinates(crs)


@pytest.mark.parametrize('place', [(91.0, 0.0), (np.nan, 0.0), (0.0, 3.0)])
def test_unusable_positions_are_refused_in_one_line(place):
    with pytest.raises(InvalidCoordinates, match=r'(latitude must be|too far).*20 such') as refused:
        Coordinates('EPSG:32616').from_lat_lon([place] * 20)
    assert len(str(refused.value)) < 200


@pytest.mark.parametrize('crs', ['EPSG:32616', 'datum 36.5 -84.2 0.3', None])
def test_files_keep_map_and_system(tmp_path, crs):
    risk_map = random_map(1, yaw=0.5)
    np.savez(tmp_path / 'm.npz', alpha=risk_map.alpha, obstacles=risk_map.obstacles,
             resolution=risk_map.resolution, origin=risk_map.origin, crs=crs or '')
    values = np.random.default_rng(1).integers(-1, 101, (13, 10)).astype(np.int8)
    grid = OccupancyMap(values, 2.0, (7e5, 4e6, 0.0), crs)
    write_map(tmp_path / 'm.yaml', grid)
    for name in ('m.npz', 'm.yaml'):
        assert read_risk_map(tmp_path / name).crs == crs
        given = OccupancyOptions(crs='EPSG:32734')
        if crs is None:
            assert read_risk_map(tmp_path / name, given).crs == 'EPSG:32734'
        else:
            with pytest.raises(InvalidRiskMap, match=f'{crs}.* EPSG:32734'):
                read_risk_map(tmp_path / name, given)
    if crs == 'EPSG:32616':
        write_geotiff(tmp_path / 'm.tif', grid)
        one, other = (read_risk_map(tmp_path / name) for name in ('m.tif', 'm.yaml'))
        assert np.array_equal(one.obstacles, other.obstacles)
        np.testing.assert_array_equal(one.alpha[~one.obstacles], other.alpha[~one.obstacles])
        assert (one.origin, one.crs) == (other.origin, other.crs)


def test_an_elevation_model_comes_into_the_frame_of_a_robot(tmp_path):
    """Heights that are a plane in their system are those there at each cell's latitude."""
    datum = 'datum 36.6 -84.3 0.7'
    east, north = pyproj.Transformer.from_crs(4326, 32616, always_xy=True).transform(-84.3, 36.6)
    rows, columns = np.mgrid[:40, :40] + 0.5
    path = write_raster(tmp_path / 'a.tif', 3.0 * rows + columns, place=(
        30.0, 0.0, east - 600.0, 0.0, -30.0, north + 600.0))
    raster, said = heard(read_raster, path, crs=datum)
    assert raster.crs == datum and f'to {datum}' in said
    middle = np.array(raster.values.shape) // 2
    cells = middle + [(-2, 3), (4, -5)]
    xy = raster.corner + (cells[:, ::-1] + 0.5) * (raster.column_step, raster.row_step)
    assert np.hypot(*xy.T).max() < 400.0
    lat_lon = Coordinates(datum).to_lat_lon(xy)
    there = Coordinates('EPSG:32616').from_lat_lon(lat_lon) - (east - 600.0, north + 600.0)
    np.testing.assert_allclose(raster.values[tuple(cells.T)], there @ (1.0 / 30.0, -0.1), atol=0.01)
