"""Pictures: the layers, and the figure of the demo."""

import math
from itertools import combinations

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from ambush_planner import colours, figures
from ambush_planner.maps.risk_map import RiskMap
from paper.figures import binned_directions

# Normal vision, then colours in linear RGB as protanopes, deuteranopes and tritanopes see them:
# Machado, Oliveira and Fernandes 2009, severity 1.
VISION = (
    np.eye(3),
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
     [-0.003882, -0.048116, 1.051998]],
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
     [-0.011820, 0.042940, 0.968881]],
    [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
     [0.004733, 0.691367, 0.303900]],
)


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


def test_obstacles_are_masked(axes):
    obstacles = np.array([[True, False]])
    image = figures.draw_risk_map(axes, RiskMap(np.ones((1, 2)), obstacles, 1.0))
    np.testing.assert_array_equal(image.get_array().mask, obstacles)


def test_binned_directions_are_weighted_means():
    points = np.array([[0.1, 0.1], [0.9, 0.1], [2.5, 0.5], [5.5, 5.5]])
    direction = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8], [1.0, 0.0]])
    places, mean, share = binned_directions(points, direction, np.array([3.0, 1.0, 2.0, 0.0]), 1.0)
    np.testing.assert_allclose(places, [[0.3, 0.1], [2.5, 0.5]])
    np.testing.assert_allclose(mean, [[0.75, 0.25], [0.6, 0.8]])
    np.testing.assert_allclose(share, [1.0, 0.5])
    places, mean, share = binned_directions(points, direction, np.zeros(4), 1.0)
    assert places.shape == mean.shape == (0, 2) and share.shape == (0,)


def cielab(linear):
    """CIELAB of a colour in linear RGB (D65)."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(xyz @ np.clip(linear, 0.001, 1.0) / (0.9505, 1.0, 1.089))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def difference(one, other):
    """The least CIE76 difference of two colours for any vision; 2.3 is just noticeable."""
    a, b = (((np.array(to_rgb(each)) + 0.055) / 1.055) ** 2.4 for each in (one, other))
    return min(np.linalg.norm(cielab(np.array(eye) @ a) - cielab(np.array(eye) @ b))
               for eye in VISION)


def test_colour_blind_readers_tell_the_colours_apart():
    for one, other in combinations(colours.ROUTES, 2):
        assert difference(one, other) > 12.0, (one, other)
    for route in (*colours.ROUTES, *colours.PROBABILITY, *colours.RISK, colours.ENDS):
        assert difference(route, colours.AMBUSHER) > 30.0, route
    assert difference('#cc3311', colours.AMBUSHER) < 20.0  # the measure sees what it should


def test_scale_bar_has_a_round_length(axes):
    figures.frame(axes, RiskMap(np.ones((4, 30)), np.zeros((4, 30), bool), 100.0), '')
    figures.scale_bar(axes)
    assert [text.get_text() for text in axes.texts] == ['500 m']
    assert np.ptp(axes.lines[0].get_xdata()) == 500.0 and len(axes.get_xticks()) == 0
