"""The data of the report's map: losses, obstacles and places come through."""

import zlib
from base64 import b64decode

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

pytest.importorskip('matplotlib', reason='the commands need matplotlib')

from ambush_planner.commands import report_map
from ambush_planner.maps.risk_map import RiskMap

SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9))


def unpacked(text, kind):
    return np.frombuffer(zlib.decompress(b64decode(text)), kind)


@given(st.data())
@settings(max_examples=50, deadline=None)
def test_losses_and_obstacles_come_through(data):
    shape = data.draw(SHAPES)
    alpha = data.draw(arrays(float, shape, elements=st.floats(0.0, 10.0)))
    obstacles = data.draw(arrays(bool, shape))
    cells, levels, cell = report_map._cells(RiskMap(alpha, obstacles, 2.5))
    assert cell == 2.5
    np.testing.assert_array_equal(cells == report_map.OBSTACLE, obstacles)
    np.testing.assert_array_equal(np.array(levels)[cells[~obstacles]], alpha[~obstacles])


def test_of_very_many_losses_the_nearest_are_kept():
    alpha = np.random.default_rng(1).uniform(1.0, 9.0, (60, 70))
    cells, levels, _ = report_map._cells(RiskMap(alpha, np.zeros(alpha.shape, bool), 1.0))
    assert len(levels) == report_map.OBSTACLE
    assert np.abs(np.array(levels)[cells] - alpha).max() <= 8.0 / 254 / 2 + 1e-9


def test_of_a_large_map_blocks_show_the_worst():
    rng = np.random.default_rng(2)
    alpha, obstacles = rng.integers(1, 50, (3, 4001)) / 5.0, rng.random((3, 4001)) < 0.6
    cells, levels, cell = report_map._cells(RiskMap(alpha, obstacles, 2.0))
    assert cells.shape == (1, 1334) and cell == 6.0
    for k in (0, 1, 700, 1333):
        block = np.s_[:, 3 * k:3 * k + 3]
        free = alpha[block][~obstacles[block]]
        if len(free):
            assert levels[cells[0, k]] == free.max()
        else:
            assert cells[0, k] == report_map.OBSTACLE


def test_a_map_of_obstacles_has_no_losses():
    cells, levels, _ = report_map._cells(RiskMap(np.ones((2, 2)), np.ones((2, 2), bool), 1.0))
    assert (cells == report_map.OBSTACLE).all() and levels == [0.0]


def test_arrays_are_little_endian():
    values = np.array([1.5, -2.0, 1e4])
    assert unpacked(report_map._packed(values, '<f4'), '<f4').tolist() == values.tolist()
