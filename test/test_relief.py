# SPDX-License-Identifier: Apache-2.0
"""Heights brought to square cells, slope, and depth below the surroundings."""

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label

from ambush_planner.maps import (
    Elevation,
    InvalidTerrain,
    Raster,
    elevation_from_raster,
    relative_depth,
    slope,
)
from ambush_planner.maps.relief import barriers


def plane(rows, columns, north, east):
    row, column = np.mgrid[:rows, :columns] + 0.5
    return north * row + east * column


def test_resampling_preserves_a_plane():
    raster = Raster(10.0 * plane(30, 40, 1.0, 0.0) + 20.0 * plane(30, 40, 0.0, 1.0), 10.0, 20.0)
    result = elevation_from_raster(raster, 8.0)
    np.testing.assert_allclose(result.heights, 8.0 * plane(37, 100, 1.0, 1.0), rtol=1e-6)


def test_unknown_heights_spread_only_to_interpolated_cells():
    heights = np.zeros((20, 20))
    heights[10, 10] = np.nan
    unknown = np.isnan(elevation_from_raster(Raster(heights, 10.0, 10.0), 5.0).heights)
    assert unknown[20:22, 20:22].all() and not unknown[:18].any() and not unknown[:, 24:].any()


def test_a_sample_at_a_known_cells_centre_is_known():
    """Cells of 10 m sampled every 30 m: each sample is the centre of one raster cell."""
    heights = plane(30, 30, 2.0, 3.0)
    expected = heights[1::3, 1::3].copy()
    heights[1::3, 2::3] = heights[2::3, 1::3] = heights[0::3] = np.nan
    np.testing.assert_array_equal(
        elevation_from_raster(Raster(heights, 10.0, 10.0), 30.0).heights, np.float32(expected)
    )


@pytest.mark.parametrize(('heights', 'resolution', 'reason'), [
    (np.zeros(4), 1.0, '2 x 2'), (np.zeros((1, 4)), 1.0, '2 x 2'),
    (np.full((3, 3), np.nan), 1.0, 'no elevation is known'),
    (np.full((3, 3), np.inf), 1.0, 'finite'), (np.zeros((3, 3)), 0.0, 'resolution'),
])
def test_rejects_malformed_elevations(heights, resolution, reason):
    with pytest.raises(InvalidTerrain, match=reason):
        Elevation(heights, resolution)


@examples(40)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.6), st.floats(1.05, 9.0))
def test_a_way_over_cells_is_a_way_over_the_finer_cells_in_them(seed, steep, ratio):
    """One connected part of the raster's ground reaches all larger cells that are connected."""
    rng = np.random.default_rng(seed)
    walls = rng.random((40, 50)) < steep / 4
    for row, column, length in rng.integers(0, (40, 50, 30), (5, 3)):
        walls[row, column: column + length] = walls[row: row + length, column] = True
    heights = np.where(walls, 100.0, 0.0)
    raster = Raster(heights.astype(np.float32), 1.0, 1.0)
    cells = elevation_from_raster(raster, ratio)
    free = ~barriers(raster, cells, 9.0)
    passable = slope(elevation_from_raster(raster)) <= 9.0
    row, column = ((np.arange(count) + 0.5) / ratio for count in heights.shape)
    row, column = (each[each < count].astype(int)
                   for each, count in zip((row, column), free.shape, strict=True))
    fine = label(passable[:len(row), :len(column)])[0]
    part, box = (each[np.ix_(row, column)]
                 for each in (label(free)[0], np.arange(free.size).reshape(free.shape)))
    for k in range(1, part.max() + 1):
        within = np.unique(np.stack((fine, box))[:, (part == k) & (fine > 0)], axis=1)
        assert np.bincount(within[0]).max() == len(np.unique(box[part == k]))


def test_gaps_in_walls_stay_open_and_boulders_block_nothing():
    heights = np.zeros((60, 60), np.float32)
    heights[21:24, :25] = heights[21:24, 38:] = heights[5, 5] = heights[51, 30] = 9.0
    raster = Raster(heights, 1.0, 1.0)
    found = barriers(raster, elevation_from_raster(raster, 10.0), 0.5)
    assert found.sum(axis=1).tolist() == [0, 0, 4, 0, 0, 0] and not found[2, 2:4].any()
    assert not barriers(raster, elevation_from_raster(raster, 0.7), 0.5).any()


@examples(20)
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.5, 90.0))
def test_slope_is_exact_on_planes(north, east, resolution):
    elevation = Elevation(resolution * plane(8, 9, north, east), resolution)
    np.testing.assert_allclose(slope(elevation), np.hypot(north, east), atol=1e-5)


def test_unknown_terrain_makes_no_cliff_and_has_no_slope():
    heights = 500.0 + plane(20, 20, 0.1, 0.0)
    heights[5:9, 5:9] = np.nan
    result = slope(Elevation(heights, 1.0))
    assert np.isnan(result[5:9, 5:9]).all() and np.isnan(result).sum() == 16
    assert np.nanmax(result) < 0.2


def naive_depth(heights, resolution, radius):
    rows, columns = np.indices(heights.shape)
    depth = np.empty(heights.shape)
    for row, column in np.ndindex(heights.shape):
        near = resolution * np.hypot(rows - row, columns - column) <= radius
        depth[row, column] = heights[near].max()
    return depth - heights


@examples(12)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 15.9))
def test_depth_matches_a_brute_force_search_of_the_disc(seed, radius):
    rng = np.random.default_rng(seed)
    heights = rng.normal(size=(13, 17)).astype(np.float32)
    heights[rng.random(heights.shape) < 0.1] = np.nan
    heights[0, 0] = 1.0
    here = ~np.isnan(heights)
    result = relative_depth(Elevation(heights, 3.0), 3.0 * radius)
    assert np.isnan(result[~here]).all()
    expected = naive_depth(np.where(here, heights, -1e9), 3.0, 3.0 * radius)
    np.testing.assert_allclose(result[here], expected[here], rtol=1e-6)
