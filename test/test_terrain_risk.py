# SPDX-License-Identifier: Apache-2.0
"""The risk map from the ground: its formulas, and the demo's ground."""

import numpy as np
import pytest

from ambush_planner.maps import (
    Elevation,
    TerrainOptions,
    relative_depth,
    slope,
    terrain_map,
    viewshed,
)


def hills(seed=0, shape=(40, 50)):
    row, column = np.mgrid[: shape[0], : shape[1]]
    phase = np.random.default_rng(seed).uniform(0.0, 6.0, 2)
    return 8.0 * np.sin(row / 4.0 + phase[0]) * np.cos(column / 5.0 + phase[1])


def only(name):
    """Options in which a single share counts."""
    names = ('depth', 'exposure', 'approach', 'slope')
    return TerrainOptions(weights=tuple(float(name == each) for each in names), slope_limit=1.5)


@pytest.mark.parametrize('name', ['depth', 'exposure', 'approach', 'slope'])
def test_values_follow_the_stated_formula(name):
    elevation = Elevation(hills(), 10.0)
    ground, views = terrain_map(elevation, only(name)), viewshed(elevation)
    share = {
        'depth': np.minimum(relative_depth(elevation, 300.0) / 120.0, 1.0),
        'exposure': views.exposure, 'approach': 1.0 - views.approach / 300.0,
        'slope': np.minimum(slope(elevation) / 1.5, 1.0),
    }[name]
    assert np.ptp(ground.values) > 5
    np.testing.assert_allclose(ground.values, 99.0 * share, atol=0.501)


def test_cliffs_are_obstacles_and_the_largest_risk_is_none():
    heights = np.zeros((60, 30))
    heights[:20], heights[40:] = 400.0, 400.0
    values = terrain_map(Elevation(heights, 10.0), only('depth')).values
    assert (values[25:35] == 99).all()
    limited = terrain_map(Elevation(heights, 10.0)).values
    assert (limited[[19, 20, 39, 40]] == 100).all() and (limited[25:35] < 100).all()


def test_unknown_terrain_stays_unknown():
    heights = hills()
    heights[5:9, 5:9] = np.nan
    ground = terrain_map(Elevation(heights, 10.0))
    np.testing.assert_array_equal(ground.values == -1, np.isnan(heights))
