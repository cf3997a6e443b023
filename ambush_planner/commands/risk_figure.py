# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush risk``: the risk map with its layers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import map_figures
from ..colours import ROUTES
from ..labels import Labels
from ..maps.risk_layers import Layer
from ..maps.risk_map import RiskMap

_WIDE = 5.0  # of the map, without what is next to it [inches]
_FONT = 8.0  # of names of places [points]
# How shapes of layers are drawn on the map, by the kind of layer.
_STYLES: dict[str, dict[str, Any]] = {
    'roads': {'color': map_figures.ROAD, 'linewidth': 0.9},
    'incidents': {'color': ROUTES[0], 'marker': 'X', 'markersize': 7.0, 'linestyle': 'none',
                  'markeredgecolor': 'white', 'markeredgewidth': 0.6},
    'polygons': {'color': '#1146b0', 'linewidth': 1.4, 'linestyle': 'dotted'}}


def layers_figure(risk_map: RiskMap, layers: Sequence[Layer]) -> Figure:
    """The map with the shapes of all layers, and names of places."""
    width, height = risk_map.size
    figure = Figure((map_figures.WIDTH, 1.2 + _WIDE * min(max(height / width, 0.2), 2.0)),
                    layout='compressed')
    axes = figure.subplots()
    image = map_figures.draw_map(axes, risk_map, 'Risk map')
    map_figures.colour_bar(axes, image, map_figures.LOSS)
    key = [*map_figures.ground_key(risk_map), *_draw_shapes(axes, layers)]
    _name_places(axes, risk_map, layers)
    if key:
        figure.legend(handles=key, loc='outside lower left', ncols=3, frameon=False)
    return figure


def _draw_shapes(axes: Axes, layers: Sequence[Layer]) -> list[Line2D]:
    """Draw roads, incidents and outlines of polygons; return their entries of a legend."""
    key = []
    for layer in layers:
        style = _STYLES[layer.kind]
        if layer.kind == 'incidents':
            axes.plot(layer.shapes.x, layer.shapes.y, zorder=6, **style)
        else:
            layer.shapes.plot(ax=axes, aspect=None, zorder=5, **style)
        key.append(Line2D([], [], label=layer.file, **style))
    return key


def _name_places(axes: Axes, risk_map: RiskMap, layers: Sequence[Layer]) -> None:
    """Write the names of places, other than those that would cover others."""
    letter = _FONT / 72.0 * risk_map.size[0] / _WIDE  # height [m]
    labels = Labels(np.array(risk_map.bounds), np.empty((0, 2)), np.empty((0, 4)))
    for x, y, name in (place for layer in layers for place in layer.names):
        size = np.array((0.6 * len(name), 1.4)) * letter
        if (spot := labels.choose(np.array([(x, y)]), size)) is not None:
            axes.text(*spot, name, ha='center', va='center', fontsize=_FONT, style='italic',
                      path_effects=map_figures.HALO, zorder=7)
