"""Segments against obstacle cells: exact rational clipping and distances as the oracle."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import RiskMap
from ambush_planner.core import obstacles
from ambush_planner.core.obstacles import ObstacleField

SIDE = 5


def field_of(cells, shape=(SIDE, SIDE), resolution=1.0) -> ObstacleField:
    blocked = np.zeros(shape, bool)
    for column, row in cells:
        blocked[row, column] = True
    return ObstacleField(RiskMap(np.ones(shape), blocked, resolution))


def clear(field, a, b, clearance=0.0) -> bool:
    return bool(field.clear_segments(np.array([a], float), np.array([b], float), clearance)[0])


def meets(a, b, cell) -> bool:
    """Whether segment a -> b meets the closed unit cell: Liang and Barsky's clipping, exact."""
    enter, leave = Fraction(0), Fraction(1)
    for axis in (0, 1):
        start, step = a[axis], b[axis] - a[axis]
        low, high = cell[axis] - start, cell[axis] + 1 - start
        if step == 0:
            if low > 0 or high < 0:
                return False
            continue
        near, far = sorted((low / step, high / step))
        enter, leave = max(enter, near), min(leave, far)
    return enter <= leave


def squared_distance(a, b, cell) -> Fraction:
    """Squared distance of segment a -> b from the closed unit cell, exact."""
    if meets(a, b, cell):
        return Fraction(0)
    corners = [(cell[0] + i, cell[1] + j) for i in (0, 1) for j in (0, 1)]
    outside = [
        sum(max(cell[k] - p[k], p[k] - cell[k] - 1, 0) ** 2 for k in (0, 1)) for p in (a, b)
    ]
    return min(outside + [squared_from_segment(corner, a, b) for corner in corners])


def squared_from_segment(point, a, b) -> Fraction:
    along, to = [b[k] - a[k] for k in (0, 1)], [point[k] - a[k] for k in (0, 1)]
    length = along[0] ** 2 + along[1] ** 2
    t = min(max((along[0] * to[0] + along[1] * to[1]) / length, 0), 1) if length else 0
    return sum((to[k] - t * along[k]) ** 2 for k in (0, 1))


# Eighths hit corners and sides all the time, and are exact in binary.
eighths = st.integers(-4, 8 * SIDE + 4).map(lambda k: Fraction(k, 8))
points = st.tuples(eighths, eighths)
cells = st.sets(st.tuples(*[st.integers(0, SIDE - 1)] * 2), min_size=1, max_size=6)


@examples(500)
@given(points, points, cells)
def test_segments_against_exact_clipping(a, b, blocked):
    expected = not any(meets(a, b, cell) for cell in blocked)
    assert clear(field_of(blocked), a, b) == expected


@examples(500)
@given(points, points, cells, st.sampled_from((1, 2, 3, 5, 8, 13, 20)))
def test_clearance_against_exact_distances(a, b, blocked, reach):
    reach = Fraction(reach, 8)
    nearest = min(squared_distance(a, b, cell) for cell in blocked)
    assert clear(field_of(blocked), a, b, float(reach)) == (nearest > reach**2)


@examples(200)
@given(st.integers(0, 10**9))
def test_any_directions_against_dense_sampling(seed):
    rng = np.random.default_rng(seed)
    blocked = rng.random((SIDE, SIDE)) < 0.2
    field = ObstacleField(RiskMap(np.ones((SIDE, SIDE)), blocked, 0.25))
    a, b = rng.random((2, 40, 2)) * SIDE * 0.25
    found = field.clear_segments(a, b, 0.0)
    samples = a[:, None] + np.linspace(0, 1, 400)[:, None] * (b - a)[:, None]
    column, row = np.moveaxis(np.clip((samples / 0.25).astype(int), 0, SIDE - 1), -1, 0)
    touched = blocked[row, column].any(axis=1)
    assert not (found & touched).any()
    shrunk = field.clear_segments(a, b, 0.25 * 0.02)
    assert (found | ~shrunk).all() and (touched | found | ~shrunk).all()


def test_all_segments_at_once_are_as_one_by_one(monkeypatch):
    rng = np.random.default_rng(1)
    field = field_of({(1, 1), (3, 2), (4, 4)})
    a, b = rng.random((2, 300, 2)) * SIDE
    together = field.clear_segments(a, b, 0.2)
    monkeypatch.setattr(obstacles, "CHUNK", 7)
    assert np.array_equal(field.clear_segments(a, b, 0.2), together)
    assert together.tolist() == [clear(field, *ends, 0.2) for ends in zip(a, b, strict=True)]


def test_touching_a_corner_or_a_side_counts():
    field = field_of({(2, 2)})
    assert not clear(field, (1, 3), (3, 5) if SIDE < 4 else (2, 2))
    assert not clear(field, (1, 3), (2, 2))
    assert not clear(field, (1, 1), (2, 2))
    assert not clear(field, (1, 4), (3, 2))
    assert not clear(field, (0, 2), (5, 2))
    assert not clear(field, (2, 0), (2, 5))
    assert clear(field, (0, 1.999), (5, 1.999))
    assert clear(field, (1.999, 0), (1.999, 5))


@pytest.mark.parametrize("resolution", [0.05, 0.1, 1 / 3, 92.3])
def test_a_diagonal_between_cell_centres_meets_both_flanks_at_any_resolution(resolution):
    field = field_of({(7, 8)}, (20, 20), resolution)
    centre = (np.arange(20) + 0.5) * resolution
    assert not clear(field, (centre[7], centre[7]), (centre[8], centre[8]))
    assert not clear(field, (centre[6], centre[8]), (centre[8], centre[8]))
    assert clear(field, (centre[8], centre[7]), (centre[9], centre[8]))
    assert clear(field, (centre[6], centre[7]), (centre[6], centre[9]))


def test_the_border_of_the_map_is_no_obstacle():
    field = field_of(set())
    assert clear(field, (0, 0), (SIDE, SIDE), 3.0)


def test_points_keep_their_distance_round_a_corner():
    field = field_of({(0, 0)})
    near = 1 + 0.5 / np.sqrt(2)
    points = np.array([(near - 1e-6, near - 1e-6), (near + 1e-6, near + 1e-6), (1.5, 0.5)])
    assert field.clear_points(points, 0.5).tolist() == [False, True, False]
