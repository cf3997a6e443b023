"""Pictures: the layers, and the figure of the demo."""

import math

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from matplotlib.figure import Figure

from ambush_planner import figures
from ambush_planner.maps.risk_map import RiskMap


@pytest.fixture
def axes():
    return Figure().subplots()


def turned_map(yaw: float) -> RiskMap:
    return RiskMap(np.ones((3, 5)), np.zeros((3, 5), bool), 2.0, (100.0, 50.0, yaw))


def test_frame_contains_a_rotated_map(axes):
    figures.frame(axes, turned_map(math.pi / 2), 'turned')
    np.testing.assert_allclose(axes.get_xlim(), (94.0, 100.0))
    np.testing.assert_allclose(axes.get_ylim(), (50.0, 60.0))
    assert axes.get_xlabel() == 'x [m]'


def test_map_is_drawn_at_its_origin(axes):
    risk_map = turned_map(0.3)
    image = figures.draw_risk_map(axes, risk_map)
    shown = (image.get_transform() - axes.transData).transform([(0.0, 0.0), (10.0, 6.0)])
    np.testing.assert_allclose(shown, risk_map.to_world([(0.0, 0.0), (10.0, 6.0)]))
