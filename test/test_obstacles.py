# SPDX-License-Identifier: Apache-2.0
"""Segments against obstacle cells: exact rational clipping and distances as the oracle."""

from fractions import Fraction

import numpy as np
import pytest
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import RiskMap
from ambush_planner.maps.obstacles import ObstacleField

SIDE = 5
# Around the cells that are tried, so that the map's edge is out of play.
MARGIN = 4


def field_of(cells, shape=(SIDE, SIDE), resolution=1.0) -> ObstacleField:
    blocked = np.zeros(shape, bool)
    for column, row in cells:
        blocked[row, column] = True
    blocked = np.pad(blocked, MARGIN)
    return ObstacleField(RiskMap(np.ones(blocked.shape), blocked, resolution))


def clear(field, a, b, clearance=0.0, resolution=1.0) -> bool:
    a, b = (np.array([p], float) + MARGIN * resolution for p in (a, b))
    return bool(field.clear_segments(a, b, clearance)[0])


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
    outside = [sum(max(cell[k] - p[k], p[k] - cell[k] - 1, 0) ** 2 for k in (0, 1)) for p in (a, b)]
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


@examples(100)
@given(points, points, cells, st.sampled_from((0, 0, 0, 1, 2, 3, 5, 8, 13, 20)))
def test_segments_against_exact_clipping_and_distances(a, b, blocked, reach):
    reach = Fraction(reach, 8)
    nearest = min(squared_distance(a, b, cell) for cell in blocked)
    assert clear(field_of(blocked), a, b, float(reach)) == (nearest > reach**2)


@pytest.mark.parametrize('off, expected', [(9e-7, False), (3e-6, True)])
@pytest.mark.parametrize('turn', range(8))
def test_contact_within_a_millionth_of_a_cell_blocks(off, expected, turn):
    """A face and a corner, from all sides."""
    field = field_of({(2, 2)})
    flip = np.array([[1, 0], [0, 1]])[:: 1 if turn < 4 else -1]
    sign = np.array([(-1) ** turn, (-1) ** (turn // 2)])
    def place(u, v):
        return 2.5 + (sign * (u, v)) @ flip

    assert clear(field, place(-2, 0.5 + off), place(2, 0.5 + off)) == expected
    diagonal = 0.5 + off / np.sqrt(2)
    assert clear(field, place(diagonal - 1, diagonal + 1), place(diagonal + 1, diagonal - 1)) == (
        expected
    )


def test_long_segments_are_blocked_like_their_parts():
    rng = np.random.default_rng(3)
    field = ObstacleField(RiskMap(np.ones((90, 120)), rng.random((90, 120)) < 0.01, 0.5))
    a, b = rng.random((2, 100, 2)) * (60, 45)
    share = np.linspace(0, 1, 101)[:, None]
    for reach in (0.0, 0.3):
        parts = [
            field.clear_segments(x + (y - x) * share[:-1], x + (y - x) * share[1:], reach).all()
            for x, y in zip(a, b, strict=True)
        ]
        assert 3 < sum(parts) < 97
        assert field.clear_segments(a, b, reach).tolist() == parts


def test_the_outer_edge_of_the_map_blocks():
    risk_map = RiskMap(np.ones((4, 5)), np.zeros((4, 5), bool), 2.0)
    inside, outside = 3e-6, 1.9e-6
    for clear_of_edge, clearance in ((True, 0.0), (False, 0.0), (False, 1.5), (True, 1.5)):
        field = ObstacleField(risk_map, clear_of_edge)
        margin = clearance if clear_of_edge else 0.0
        for near, expected in ((margin + inside, True), (margin + outside, False), (-0.5, False)):
            low, high = (near, near), (10 - near, 8 - near)
            for point in (low, high, (low[0], 4.0), (5.0, high[1])):
                found = field.clear_points(np.array([point], float), clearance)[0]
                assert found == expected, (point, clear_of_edge, clearance)
