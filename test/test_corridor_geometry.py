"""Strips and quarters: clear of obstacles, and as wide as these allow."""

from __future__ import annotations

import numpy as np
import pytest

from ambush_planner import RiskMap
from ambush_planner.routes.corridor_geometry import (
    OBSTACLE_MARGIN,
    limit_to_map,
    widths_between_nodes,
)

WIDE = 1e6


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
    for found in (room.widths[0], room.beyond[0, 1], room.widths[1], room.beyond[1, 0]):
        assert found == pytest.approx((edge, 0.01 - OBSTACLE_MARGIN))


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
