"""One table of colours: readers of any vision tell them apart, and files with literals agree."""

import re
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from matplotlib.colors import to_rgb

from ambush_planner import colours
from ambush_planner.ros import markers

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / 'config'
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
    for route in (*colours.ROUTES, *colours.PROBABILITY, *colours.RISK, colours.ENDS,
                  colours.NETWORK):
        assert difference(route, colours.AMBUSHER) > 30.0, route
    for route in colours.ROUTES:
        assert difference(route, colours.NETWORK) > 20.0, route
    assert difference('#cc3311', colours.AMBUSHER) < 20.0  # the measure sees what it should


def hexadecimal(numbers):
    return '#' + bytes(int(each) for each in numbers).hex()


def test_the_layouts_of_qgis_rviz_and_foxglove_use_the_table():
    style = (CONFIG / 'ambush_planner.qml').read_text()
    assert [hexadecimal(each.split(',')[:3]) for each in re.findall(
        r'name="color" type="QString" value="([\d,]+)"', style)
    ] == [colours.AMBUSHER, colours.OBSTACLE]
    live = [colours.LIVE_ROUTE] * 3 + [colours.LIVE_GOAL]
    layout = (CONFIG / 'ambush_planner.rviz').read_text()
    assert [hexadecimal(each.split(';')) for each in re.findall(
        r'\n    Color: (.*)', layout)] == live
    layout = (CONFIG / 'ambush_planner_foxglove.json').read_text()
    assert [each[:7] for each in re.findall('"(#[0-9a-f]{8})"', layout)] == [live[0], *live]


def test_colour_blind_readers_tell_markers_apart_on_a_dark_ground():
    convoy, ambusher = ([tuple(colour[:3]) for colour in ramp]
                        for ramp in (markers._CONVOY, markers._AMBUSHER))
    assert difference(ambusher[-1], colours.AMBUSHER) < 20.0
    live = [colours.LIVE_ROUTE, colours.LIVE_GOAL]
    for one, other in [*product(convoy, ambusher), *product(live, convoy + ambusher), live]:
        assert difference(one, other) > 20.0, (one, other)
