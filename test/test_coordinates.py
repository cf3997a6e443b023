# SPDX-License-Identifier: Apache-2.0
"""Coordinate systems against pyproj and geodesics, and maps that keep them from file to file."""

import numpy as np
import pytest
from games import HUNT, random_map
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

pytest.importorskip('pyproj', reason='coordinate systems take the extra "gis"')
pytest.importorskip('rasterio', reason='GeoTIFF takes the extra "gis"')

import pyproj
import rasterio

from ambush_planner import InvalidRiskMap, RiskMap
from ambush_planner.errors import InvalidCoordinates
from ambush_planner.maps import OccupancyOptions
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.map_file import write_map
from ambush_planner.maps.occupancy import OccupancyMap
from ambush_planner.maps.risk_map_file import in_local_frame, read_risk_map, write_geotiff

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
def test_a_datum_is_in_the_utm_zone_that_navsat_transform_takes(latitude, longitude, code):
    frame = Coordinates(f'datum {latitude} {longitude} 0')
    assert frame.crs.to_epsg() == code
    east, north = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(
        longitude, latitude)
    assert frame.to_crs((0.0, 0.0)) == pytest.approx((east, north), abs=1e-6)


@pytest.mark.parametrize('crs', ['EPSG:32616', 'EPSG:5070', 'EPSG:32616+5703',
                                 pyproj.CRS('EPSG:2193').to_wkt(), 'datum 60.4 5.3 -2'])
def test_degrees_and_metres_are_those_of_pyproj(crs):
    system = Coordinates(crs)
    west, south, east, north = system.crs.area_of_use.bounds
    degrees = np.random.default_rng(1).uniform((south, west), (north, east), (50, 2))
    if crs.startswith('datum'):
        degrees = (60.4, 5.3) + 0.01 * degrees / np.abs(degrees).max()
    xy = system.from_lat_lon(degrees)
    there = pyproj.Transformer.from_crs(4326, system.crs).transform(*degrees.T)
    if system.crs.axis_info[0].direction == 'north':
        there = there[::-1]
    np.testing.assert_allclose(system.to_crs(xy), np.transpose(there), atol=1e-3)
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


def test_a_map_in_a_robots_frame_stays_where_it_is_on_the_earth(tmp_path):
    """Its cells, and those of its rotated GeoTIFF, have the latitudes and longitudes of before."""
    datum, code = 'datum -33.9 18.4 0.7', 32734
    east, north = Coordinates(datum).to_crs((-800.0, 300.0))
    values = np.arange(20, dtype=np.int8).reshape(4, 5)
    before = OccupancyMap(values, 30.0, (east, north, 0.0), f'EPSG:{code}')
    after = in_local_frame(before, datum)
    maps = [RiskMap(values, values < 0, 30.0, grid.origin, grid.crs) for grid in (before, after)]
    one, other = (Coordinates(each.crs).to_lat_lon(each.to_world([(15.0, 15.0), (135.0, 105.0)]))
                  for each in maps)
    np.testing.assert_allclose(one, other, atol=1e-9)
    write_geotiff(tmp_path / 'm.tif', after)
    with rasterio.open(tmp_path / 'm.tif') as file:
        assert file.crs.to_epsg() == code and file.read(1)[0, 4] == 19
        np.testing.assert_allclose(file.xy(3, 0), Coordinates(f'EPSG:{code}').from_lat_lon(one[0]),
                                   atol=1e-4)
    with pytest.raises(InvalidCoordinates, match='reproject'):
        in_local_frame(before, 'datum 50 10 0')
