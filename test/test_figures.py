# SPDX-License-Identifier: Apache-2.0
"""Pictures: the layers, and the figure of the demo."""

import re

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from matplotlib.figure import Figure

from ambush_planner import colours, figures, map_figures
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.routes.shared_roads import stripes


@pytest.fixture
def axes():
    return Figure().subplots()


def turned_map(yaw: float) -> RiskMap:
    return RiskMap(np.ones((3, 5)), np.zeros((3, 5), bool), 2.0, (100.0, 50.0, yaw))


def test_ticks_are_round_coordinates_of_the_map(axes):
    risk_map = RiskMap(np.ones((30, 40)), np.zeros((30, 40), bool), 100.0, (730e3, 4040e3, 0.0))
    map_figures.draw_map(axes, risk_map)
    for axis, name in ((axes.xaxis, 'x'), (axes.yaxis, 'y')):
        assert axis.get_label_text() == f'{name} [km]' and len(axis.get_ticklocs()) >= 2
        for at, label in zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=True):
            assert float(label.get_text()) == at / 1000.0 and at % 500.0 == 0.0


def test_few_routes_are_numbered_and_many_are_not(axes):
    routes = [np.array([(0.0, 0.0), (5.0, k), (10.0, 0.0)]) for k in range(21)]
    figures.draw_routes(axes, routes[:3])
    assert [text.get_text() for text in axes.texts] == ['1', '2', '3']
    assert len({line.get_color() for line in axes.lines}) == 3
    many = Figure().subplots()
    figures.draw_routes(many, routes)
    assert not many.texts and {line.get_color() for line in many.lines} == {colours.ROUTES[0]}


def test_paths_on_one_road_are_stripes_and_a_crossing_is_none():
    x = np.arange(100.0)
    road = np.column_stack((x, 0.0 * x))
    branch = np.column_stack((x, np.maximum(x - 50.0, 0.0)))
    across = np.column_stack((50.0 + 0.0 * x, x - 20.0))
    first, second, third = stripes([road, branch, across])
    assert [over for _, over in first] == [1, 0] and [over for _, over in second] == [0]
    assert [len(piece) for piece, _ in first] == [51, 50] and len(third) == 1


def test_a_picture_says_below_what_it_shows_and_a_scale_is_as_tall_as_its_map():
    figure = Figure((5, 4), layout='compressed')
    axes = figure.subplots()
    risk_map = turned_map(0.0)
    image = map_figures.draw_map(axes, risk_map)
    map_figures.colour_bar(axes, image, map_figures.LOSS)
    figure.legend(handles=[map_figures.OBSTACLE], loc='outside lower left')
    assert map_figures.as_png(figure, 'a.png', ['m.tif', 'roads.osm']).startswith(b'\x89PNG')
    (note,) = figure.texts
    assert re.fullmatch(r'a\.png: m\.tif, roads\.osm; drawn \d{4}-\d\d-\d\d \d\d:\d\d',
                        note.get_text())
    bar, drawn = axes.child_axes[0].get_window_extent(), axes.get_window_extent()
    assert (bar.y0, bar.y1) == pytest.approx((drawn.y0, drawn.y1)) and bar.x0 > drawn.x1
    legend = figure.legends[0].get_window_extent()
    assert note.get_window_extent().y1 < legend.y0, 'below everything'


def test_the_risk_map_has_the_shapes_of_its_layers():
    geopandas = pytest.importorskip('geopandas', reason='vector files need geopandas')
    from shapely.geometry import LineString, Point

    from ambush_planner.commands.risk_figure import layers_figure
    from ambush_planner.maps.risk_layers import Layer

    risk_map = RiskMap(np.ones((30, 40)), np.zeros((30, 40), bool), 10.0)
    shapes = {'roads': geopandas.GeoSeries([LineString([(20, 20), (320, 120)])]),
              'incidents': geopandas.GeoSeries([Point(50, 60), Point(90, 200)])}
    layers = [Layer(kind, kind, each) for kind, each in shapes.items()]
    figure = layers_figure(risk_map, layers)
    figure.draw_without_rendering()
    whole = figure.axes[0]
    assert any(np.array_equal(line.get_xydata(), [(50, 60), (90, 200)]) for line in whole.lines)
    assert any(np.array_equal(path.vertices, [(20, 20), (320, 120)])
               for each in whole.collections for path in each.get_paths())
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*shapes]
