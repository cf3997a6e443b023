"""Strips and quarters: clear of obstacles, and as wide as these allow."""

from __future__ import annotations

import numpy as np
import pytest
from drive_samples import drives
from games import examples
from hypothesis import given
from hypothesis import strategies as st

from ambush_planner import RiskMap
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.routes.corridor_geometry import (
    OBSTACLE_MARGIN,
    limit_to_map,
    widths_between_nodes,
)

WIDE = 1e6


def directions(corridors, edge):
    """Tail, head, and the unit directions along and to the left of an edge."""
    tail, head = corridors.uv[corridors.links[edge]]
    along = (head - tail) / np.hypot(*(head - tail))
    return tail, head, along, np.array([-along[1], along[0]])


def pieces(corridors, edge, rng):
    """Random points in the strips and quarters of an edge, most of them on their outer rims."""
    tail, head, along, leftward = directions(corridors, edge)
    share = rng.random((60, 1))
    radius = np.where(rng.random((60, 1)) < 0.7, 1.0, rng.random((60, 1)))
    angle = np.pi / 2 * np.where(rng.random(60) < 0.1, rng.integers(0, 2, 60), rng.random(60))
    found = []
    for k, (side, width) in enumerate(zip((leftward, -leftward), corridors.widths.T, strict=True)):
        found.append(tail + share * (head - tail) + radius * width[edge] * side)
        for end, node, ahead in ((0, tail, -along), (1, head, along)):
            fan = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * side
            found.append(node + radius * corridors.beyond[edge, end, k] * fan)
    return np.concatenate(found)


@examples(50)
@given(drives, st.integers(0, 10**6))
def test_strips_and_quarters_are_clear(drive, seed):
    corridors, _, risk_map, clearance, tube, clear_of_edge = drive
    rng = np.random.default_rng(seed)
    field = ObstacleField(risk_map, clear_of_edge)
    for edge in rng.integers(len(corridors.links), size=12):
        points = pieces(corridors, edge, rng)
        assert field.clear_points(points, clearance).all()
        ends = corridors.links[edge]
        others = np.delete(corridors.uv, ends, axis=0)
        if tube is None and len(others):
            assert np.linalg.norm(points[:, None] - others, axis=2).min() > 1e-4
    if tube is not None:
        assert max(corridors.widths.max(), corridors.beyond.max()) <= tube


@pytest.mark.parametrize('clearance', [0.0, 0.3])
def test_the_outer_side_of_a_turn_round_a_corner_is_free(clearance):
    """Nodes next to the corner of a block: nothing on the block's side, and room on the other."""
    obstacles = np.zeros((20, 20), bool)
    obstacles[:10, 10:] = True
    near = 0.01 + clearance
    uv = np.array([(10 - near, 4.0), (10 - near, 10 + near), (15.0, 10 + near)])
    pairs = np.array([(0, 1), (1, 2)])
    wide = type(widths_between_nodes(uv, pairs))(np.full((2, 2), WIDE), np.full((2, 2, 2), WIDE))
    risk_map = RiskMap(np.ones((20, 20)), obstacles, 1.0)
    room = limit_to_map(wide, uv, pairs, risk_map, clearance, True)
    edge = 10 - near - clearance - OBSTACLE_MARGIN
    assert room.widths[0] == pytest.approx((edge, 0.01 - OBSTACLE_MARGIN))
    assert room.beyond[0, 1] == pytest.approx((edge, 0.01 - OBSTACLE_MARGIN))
    assert room.widths[1] == pytest.approx((edge, 0.01 - OBSTACLE_MARGIN))
    assert room.beyond[1, 0] == pytest.approx((edge, 0.01 - OBSTACLE_MARGIN))


def test_a_cell_limits_only_the_quarter_on_its_own_side():
    """A cell ahead on the left limits that quarter, not those on the right or behind."""
    obstacles = np.zeros((21, 21), bool)
    obstacles[13, 13] = True
    uv = np.array([(6.5, 10.5), (10.5, 10.5)])
    pairs = np.array([(0, 1)])
    wide = type(widths_between_nodes(uv, pairs))(np.full((1, 2), 5.0), np.full((1, 2, 2), 5.0))
    risk_map = RiskMap(np.ones((21, 21)), obstacles, 1.0)
    room = limit_to_map(wide, uv, pairs, risk_map, 0.0, True)
    assert room.beyond[0, 1] == pytest.approx((np.hypot(2.5, 2.5) - OBSTACLE_MARGIN, 5.0))
    assert room.beyond[0, 0] == pytest.approx((5.0, 5.0))
    assert room.widths[0] == pytest.approx((5.0, 5.0))
