# SPDX-License-Identifier: Apache-2.0
"""Visibility compared with two slow computations."""

import math
from unittest import mock

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from ambush_planner.maps import Elevation, InvalidTerrain, ViewOptions, viewshed, visibility
from ambush_planner.maps.visibility import make_rays


def hills(shape, seed, height, width):
    noise = np.random.default_rng(seed).normal(size=shape)
    smooth = gaussian_filter(noise, width, mode='wrap')
    return height * smooth / smooth.std()


def height_at(heights, row, column):
    inside = 0 <= row < heights.shape[0] and 0 <= column < heights.shape[1]
    return heights[row, column] if inside else np.nan


def along_the_rays(heights, resolution, options):
    """Exposure and approach cell by cell, sample by sample."""
    rays = make_rays(options.weapon_range / resolution, options.rays)
    exposure, approach = np.full(heights.shape, np.nan), np.full(heights.shape, np.nan)
    for row, column in zip(*np.nonzero(~np.isnan(heights)), strict=True):
        top = heights[row, column] + options.vehicle_height
        seen, ground, nearest = 0.0, 0.0, []
        for ray in rays:
            horizon, hidden_at = -math.inf, options.weapon_range
            for sample in ray:
                first, second = (
                    height_at(heights, row + offset[0], column + offset[1])
                    for offset in (sample.first, sample.second)
                )
                height = (1.0 - sample.share) * first + sample.share * second
                if np.isnan(height):
                    continue
                distance = sample.distance * resolution
                head = (height + options.person_height - top) / distance
                ground += sample.weight
                if head >= horizon:
                    seen += sample.weight
                else:
                    hidden_at = min(hidden_at, distance)
                horizon = max(horizon, (height - top) / distance)
            nearest.append(hidden_at)
        exposure[row, column] = seen / ground if ground else 0.0
        approach[row, column] = np.mean(nearest)
    return exposure, approach


@examples(6)
@given(st.integers(0, 2**32 - 1), st.floats(1.0, 9.0), st.sampled_from([8, 24, 64]))
def test_views_match_a_cell_by_cell_computation(seed, reach, rays):
    """Also across the borders of tiles."""
    heights = hills((11, 14), seed, 6.0, 1.0).astype(np.float32)
    heights[np.random.default_rng(seed).random(heights.shape) < 0.05] = np.nan
    heights[0, 0] = 0.0
    options = ViewOptions(weapon_range=reach * 5.0, vehicle_height=2.5, person_height=1.7,
                          rays=rays)
    shares = []
    with mock.patch.object(visibility, 'TILE', (4, 5)):
        views = viewshed(Elevation(heights, 5.0), options, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) == 9
    exposure, approach = along_the_rays(heights.astype(float), 5.0, options)
    np.testing.assert_allclose(views.exposure, exposure, atol=1e-5)
    np.testing.assert_allclose(views.approach, approach, rtol=1e-5)


def lines_of_sight(heights, here, there, options):
    """Whether each line between two heads clears the ground, read bilinearly every 1/4 cell."""
    along = there - np.array(here, float)
    cells = np.hypot(*along.T)[:, None]
    # Beyond the other head it is read there again, where it is clear.
    share = np.minimum(np.arange(0.25, cells.max(), 0.25) / cells, 1.0)
    row, column = (here[k] + share * along[:, k, None] for k in (0, 1))
    r, c = np.floor(row).astype(int), np.floor(column).astype(int)
    r, c = np.minimum(r, heights.shape[0] - 2), np.minimum(c, heights.shape[1] - 2)
    u, v = row - r, column - c
    ground = ((1 - u) * (1 - v) * heights[r, c] + (1 - u) * v * heights[r, c + 1]
              + u * (1 - v) * heights[r + 1, c] + u * v * heights[r + 1, c + 1])
    start = heights[here] + options.vehicle_height
    line = start + share * (heights[tuple(there.T)][:, None] + options.person_height - start)
    return (ground <= line).all(axis=1)


def by_brute_force(heights, resolution, here, options):
    """Share of all cells within range that see the cell ``here``."""
    there = np.argwhere(np.ones(heights.shape, bool))
    distance = resolution * np.hypot(*(there - here).T)
    there = there[(0.0 < distance) & (distance <= options.weapon_range)]
    return float(lines_of_sight(heights, here, there, options).mean())


def test_exposure_approximates_all_lines_of_sight():
    heights = hills((61, 61), 1, 12.0, 5.0).astype(np.float32).astype(float)
    options = ViewOptions(weapon_range=200.0)
    views = viewshed(Elevation(heights, 10.0), options)
    cells = np.random.default_rng(1).integers(20, 41, (20, 2))
    exact = [by_brute_force(heights, 10.0, tuple(cell), options) for cell in cells]
    found = [views.exposure[tuple(cell)] for cell in cells]
    assert np.ptp(exact) > 0.2
    assert np.abs(np.subtract(found, exact)).mean() < 0.03
    assert abs(np.mean(found) - np.mean(exact)) < 0.02
    assert np.corrcoef(found, exact)[0, 1] > 0.97


def test_rejects_a_range_below_one_cell():
    with pytest.raises(InvalidTerrain, match='at least'):
        viewshed(Elevation(np.zeros((5, 5)), 30.0), ViewOptions(weapon_range=20.0))


def test_rejects_a_range_of_too_many_cells_before_memory_is_taken():
    """An elevation model in degrees, taken for metres, has a million cells within range."""
    elevation = Elevation(np.zeros((10, 10)), 1.0 / 3600.0)
    with pytest.raises(InvalidTerrain, match='1080000 cells of .* in metres, not degrees'):
        viewshed(elevation, ViewOptions(weapon_range=300.0))
