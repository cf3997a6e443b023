# SPDX-License-Identifier: Apache-2.0
"""Axes, rotated origins, the reading of occupancy grids, and every bad input by name."""

import math

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import InvalidRiskMap, RiskMap, arrays, read_risk_map
from ambush_planner.maps.occupancy import OccupancyOptions, risk_from_occupancy
from ambush_planner.maps.risk_map import GradedLosses

origins = st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-7, 7))
resolutions = st.floats(0.01, 100)


def flat(rows=3, columns=4, resolution=0.5, origin=(0.0, 0.0, 0.0)) -> RiskMap:
    return RiskMap(np.ones((rows, columns)), np.zeros((rows, columns), bool), resolution, origin)


@examples(25)
@given(origins, resolutions, st.integers(0, 10**6))
def test_world_and_map_axes_round_trip_and_centres_are_in_their_cells(origin, resolution, seed):
    risk_map = flat(resolution=resolution, origin=origin)
    uv = np.random.default_rng(seed).random((5, 2)) * risk_map.size
    back = risk_map.to_map_axes(risk_map.to_world(uv))
    assert back == pytest.approx(uv, abs=1e-11 * (1 + np.hypot(*origin[:2]) + max(risk_map.size)))


@examples(20)
@given(origins, resolutions, st.integers(0, 2), st.integers(0, 3), st.sampled_from([0.0, 0.5]))
def test_centres_and_lower_left_corners_are_in_their_cells(origin, resolution, row, column, part):
    """However a position on a border is rounded on its way through world coordinates."""
    risk_map = flat(resolution=resolution, origin=origin)
    place = risk_map.to_world([(column + part) * resolution, (row + part) * resolution])
    assert risk_map.cells(risk_map.to_map_axes(place)) == (row, column)
    assert part == 0.0 or risk_map.contains(risk_map.to_map_axes(place))


def test_a_quarter_turn_by_hand():
    risk_map = flat(origin=(10.0, 20.0, math.pi / 2))
    assert risk_map.to_world([1.5, 0.5]) == pytest.approx([9.5, 21.5])
    assert risk_map.to_map_axes([9.5, 21.5]) == pytest.approx([1.5, 0.5])


def test_row_zero_is_the_lowest_and_the_border_belongs_to_the_map():
    risk_map = flat()
    assert risk_map.size == (2.0, 1.5)
    assert risk_map.cells([[0.0, 0.0], [1.99, 0.01], [0.5, 0.0], [2.0, 1.5]]) == (
        pytest.approx([0, 0, 0, 2]), pytest.approx([0, 3, 1, 3])
    )
    inside = risk_map.contains([[0, 0], [2, 1.5], [2.001, 1], [1, -0.001], [np.nan, 1]])
    assert inside.tolist() == [True, True, False, False, False]


def test_layers_are_private_and_read_only():
    alpha = np.ones((2, 2))
    risk_map = RiskMap(alpha, np.zeros((2, 2), bool), 1.0)
    alpha[0, 0] = 7.0
    assert risk_map.alpha[0, 0] == 1.0
    for layer in (risk_map.alpha, risk_map.obstacles):
        with pytest.raises(ValueError, match='read-only'):
            layer[0, 0] = 1


def one_bad(value) -> np.ndarray:
    alpha = np.ones((2, 3))
    alpha[1, 2] = value
    return alpha


@pytest.mark.parametrize('change, words', [
    ({'alpha': one_bad(np.nan)}, r'alpha .*nan at row 1, column 2 \(1 such'),
    ({'alpha': one_bad(np.inf)}, r'alpha .*inf at row 1, column 2'),
    ({'alpha': one_bad(-0.5)}, r'alpha .*-0\.5 at row 1, column 2'),
    ({'alpha': np.ones(3)}, r'alpha .*\(3,\)'),
    ({'alpha': np.ones((0, 3))}, r'alpha .*\(0, 3\)'), ({'alpha': 'abc'}, 'not numeric'),
    ({'obstacles': np.zeros((3, 2), bool)}, r'obstacles .*\(2, 3\), got \(3, 2\)'),
    ({'unknown': [[True]]}, r'unknown .*\(2, 3\), got \(1, 1\)'),
    ({'resolution': -1.0}, r'resolution .*-1\.0'), ({'resolution': 0.0}, r'resolution .*0\.0'),
    ({'resolution': np.nan}, 'resolution .*nan'), ({'resolution': None}, 'not numeric'),
    ({'resolution': 10**400}, 'not numeric'), ({'origin': (0.0, 0.0)}, 'origin'),
    ({'origin': (0.0, np.nan, 0.0)}, 'origin .*nan'),
    ({'origin': (0.0, 0.0, 'north')}, 'not numeric'),
])
def test_rejects_malformed_maps(change, words):
    good = {'alpha': np.ones((2, 3)), 'obstacles': np.zeros((2, 3), bool), 'resolution': 1.0}
    with pytest.raises(InvalidRiskMap, match=words):
        RiskMap(**{**good, **change})


def test_unknown_cells_can_have_a_loss_and_thresholds_move():
    options = OccupancyOptions(alpha_min=2.0, alpha_max=4.0, obstacle_threshold=50,
                               unknown_alpha=7.0)
    risk_map = risk_from_occupancy([[0, 49, 50, -1]], 1.0, options=options)
    assert risk_map.alpha[0, [0, 1, 3]] == pytest.approx([2.0, 2.98, 7.0])
    assert risk_map.obstacles.tolist() == [[False, False, True, False]]
    options = OccupancyOptions(obstacle_threshold=101, unknown_alpha=0.0)
    assert not risk_from_occupancy([[100, -1]], 1.0, options=options).obstacles.any()


@pytest.mark.parametrize('dtype', [np.int8, np.int64, np.float64])
def test_every_value_in_range_is_read(dtype):
    values = np.arange(-1, 101, dtype=dtype)[None]
    risk_map = risk_from_occupancy(values, 1.0)
    assert risk_map.alpha[0, 1:] == pytest.approx(1.0 + 0.09 * np.arange(101))
    assert np.flatnonzero(risk_map.obstacles[0]).tolist() == [0, 101]


@pytest.mark.parametrize('value', [-2, 101, np.nan, np.inf])
def test_rejects_values_out_of_range(value):
    with pytest.raises(InvalidRiskMap, match=rf'{value}.* \(0, 1\)'):
        risk_from_occupancy([[0, value]], 1.0)


def test_a_file_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(arrays, 'MAX_BYTES', 10**4)
    np.savez_compressed(tmp_path / 'm.npz', alpha=np.ones((99, 99)), obstacles=0, resolution=1.0)
    with pytest.raises(InvalidRiskMap, match='m.npz: its arrays would take 7.8.* bytes'):
        read_risk_map(tmp_path / 'm.npz')


def graded(rng, shape=(7, 9)):
    """The same map with its losses in grades and as an array, with all layers."""
    levels, grades = np.array([0.5, 1.0, 4.0, 9.0]), rng.integers(0, 4, shape).astype(np.uint8)
    others = (rng.random(shape) < 0.3, 2.0, (10.0, 20.0, 0.3), 'EPSG:32616',
              rng.random(shape) < 0.3)
    return [RiskMap(alpha, *others)
            for alpha in (GradedLosses(levels, grades), levels[grades])]


def test_graded_losses_are_read_like_an_array():
    one, other = graded(np.random.default_rng(1))
    losses, array = one.alpha, other.alpha
    assert one.graded is losses
    assert other.graded is None
    assert len(losses) == 7
    assert (losses.shape, losses.size, losses.dtype) == (array.shape, array.size, array.dtype)
    for key in ((2, 3), 2, (slice(1, 5), slice(None, None, 2)), array > 1.0, ([1, 2], [3, 4])):
        assert np.array_equal(losses[key], array[key])
    for read in (np.asarray, lambda each: each + 1.0, lambda each: 2.0 * each < array,
                 lambda each: each.mean(axis=0), np.sqrt, lambda each: each.ravel()):
        assert np.array_equal(read(losses), read(array))
    assert one.loss_range == other.loss_range
    assert np.array_equal(one.nearest_free_alpha(), other.nearest_free_alpha())
    with pytest.raises(TypeError):
        losses[0, 0] = 1.0


@pytest.mark.parametrize('level', [-1.0, math.nan])
def test_graded_losses_must_be_losses(level):
    losses = GradedLosses([0.0, level], np.ones((2, 2), np.uint8))
    with pytest.raises(InvalidRiskMap, match='alpha must be finite and >= 0'):
        RiskMap(losses, np.zeros((2, 2), bool), 1.0)


@pytest.mark.parametrize('which', [0, 1], ids=['grades', 'array'])
def test_a_part_of_a_map_lies_where_it_lay(which):
    whole = graded(np.random.default_rng(2))[which]
    part = whole.part(slice(2, 6), slice(3, 5))
    assert (part.alpha.shape, part.resolution, part.crs) == ((4, 2), 2.0, 'EPSG:32616')
    uv = np.array([[1.0, 1.0], [3.0, 7.0]])
    assert part.to_world(uv) == pytest.approx(whole.to_world(uv + [6.0, 4.0]))
    for name in ('alpha', 'obstacles', 'unknown'):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[2:6, 3:5])


@pytest.mark.parametrize('which', [0, 1], ids=['grades', 'array'])
def test_a_coarser_map_hides_no_loss_and_no_obstacle(which):
    whole = graded(np.random.default_rng(3))[which]
    assert whole.coarser(9) is whole
    coarse = whole.coarser(4)  # blocks of 3 x 3 cells, the highest ones of 1 x 3
    assert (coarse.alpha.shape, coarse.resolution, coarse.origin) == ((3, 3), 6.0, whole.origin)
    assert (coarse.graded is None) == (whole.graded is None)
    for row, column in np.ndindex(3, 3):
        block = slice(3 * row, 3 * row + 3), slice(3 * column, 3 * column + 3)
        assert coarse.alpha[row, column] == whole.alpha[block].max()
        assert coarse.obstacles[row, column] == whole.obstacles[block].any()
        assert coarse.unknown[row, column] == whole.unknown[block].all()


def test_a_hiding_place_has_the_loss_of_the_nearest_free_cell():
    _, risk_map = graded(np.random.default_rng(4))
    losses, free = risk_map.nearest_free_alpha(), np.argwhere(~risk_map.obstacles)
    for row, column in np.argwhere(risk_map.obstacles):
        apart = np.hypot(*(free - (row, column)).T)
        nearest = free[np.isclose(apart, apart.min())]
        assert losses[row, column] in risk_map.alpha[tuple(nearest.T)]
