"""The demo's ground: resampling, slope, depth below the surroundings, and the map that results."""

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="the demo's elevation model comes with matplotlib")

from ambush_planner.core.construction import NetworkOptions, build_network
from ambush_planner.core.risk_map import risk_map_from_occupancy
from ambush_planner.tools import terrain


def plane(rows: int, columns: int, rise_north: float, rise_east: float) -> np.ndarray:
    """Heights of a plane, in units of a cell's edge."""
    row, column = np.mgrid[:rows, :columns] + 0.5
    return rise_north * row + rise_east * column


def test_resampling_keeps_a_plane_where_it_is():
    heights = 10.0 * plane(30, 40, 1.0, 0.0) + 20.0 * plane(30, 40, 0.0, 1.0)
    result = terrain.resample(heights, row_step=10.0, column_step=20.0, resolution=8.0)
    assert result.shape == (37, 100)
    inner = (slice(1, -1), slice(2, -2))
    np.testing.assert_allclose(result[inner], 8.0 * plane(37, 100, 1.0, 1.0)[inner])


def test_resampling_invents_no_heights():
    heights = np.random.default_rng(0).uniform(200.0, 900.0, (20, 25))
    result = terrain.resample(heights, 92.7, 74.4, 90.0)
    assert heights.min() <= result.min() and result.max() <= heights.max()


def test_slope_of_a_plane():
    heights = 90.0 * plane(8, 9, 0.3, -0.4)
    np.testing.assert_allclose(terrain.slope(heights, 90.0), 0.5)


def test_depth_below_the_surroundings():
    heights = np.zeros((21, 21))
    heights[10, 10] = 70.0
    depth = terrain.overlooked_depth(heights, 90.0)
    row, column = np.indices(heights.shape) - 10
    near = 90.0 * np.hypot(row, column) <= terrain.VIEW_RADIUS
    expected = np.where(near, 70.0, 0.0)
    expected[10, 10] = 0.0
    np.testing.assert_array_equal(depth, expected)


def test_values_follow_the_stated_formula():
    heights = np.zeros((40, 40))
    heights[20:] = 100.0  # a step of 100 m over 180 m: too steep on both sides of it
    values = terrain.occupancy_values(heights, 90.0)
    assert (values[19:21] == terrain.OBSTACLE).all()
    assert (values[21:] == 0).all()
    assert (values[15:19] == round(99 * 100.0 / terrain.FULL_RISK_DEPTH)).all()
    assert (values[:15] == 0).all()


def test_the_largest_risk_is_no_obstacle():
    heights = np.zeros((9, 9))
    heights[:3], heights[6:] = 300.0, 300.0  # a gorge with walls of 300 m
    values = terrain.occupancy_values(heights, 90.0)
    assert (values[[2, 3, 5, 6]] == terrain.OBSTACLE).all()
    assert (values[4] == 99).all()


@pytest.fixture(scope="module")
def real_values():
    return terrain.load_occupancy()


def test_the_real_ground(real_values):
    assert real_values.shape == (354, 333)
    assert real_values.dtype == np.int8
    assert real_values.min() >= 0 and real_values.max() == terrain.OBSTACLE
    assert 0.05 < (real_values == terrain.OBSTACLE).mean() < 0.25
    free = real_values[real_values < terrain.OBSTACLE]
    assert np.percentile(free, 10) < 15 and np.percentile(free, 90) > 75


def test_north_is_up():
    elevation = terrain.load_elevation(terrain.RESOLUTION)
    # The highest ground of the sheet lies in its south-west, the plain in the south-east.
    north, south = elevation[-100:], elevation[:100]
    assert south[:, :220].max() == elevation.max() > north.max()
    assert south[:, -80:].mean() < north[:, -80:].mean()


def test_start_and_goal_lie_on_opposite_sides_and_are_joined(real_values):
    risk_map = risk_map_from_occupancy(real_values, terrain.RESOLUTION)
    width, _ = risk_map.size
    assert terrain.START[0] < 0.2 * width and terrain.GOAL[0] > 0.8 * width
    network = build_network(risk_map, terrain.START, terrain.GOAL, NetworkOptions(spacing=720.0))
    assert len(network.points) > 500
