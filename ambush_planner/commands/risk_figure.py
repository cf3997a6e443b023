# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush risk``: the risk map, and below it each layer, if there are any."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .. import map_figures
from ..arrays import pooled
from ..colours import ROUTES
from ..labels import Labels
from ..maps.risk_layers import Layer
from ..maps.risk_map import RiskMap

# Width of the map, and of a panel of a layer, without what is next to it [inches]; panels in a row.
_WIDE, _NARROW, _COLUMNS = 5.0, 1.9, 2
_FONT = 8.0  # of names of places [points]
# How shapes of layers are drawn on the map, by the kind of layer.
_STYLES: dict[str, dict[str, Any]] = {
    'roads': {'color': map_figures.ROAD, 'linewidth': 0.9},
    'incidents': {'color': ROUTES[0], 'marker': 'X', 'markersize': 7.0, 'linestyle': 'none',
                  'markeredgecolor': 'white', 'markeredgewidth': 0.6},
    'polygons': {'color': '#1146b0', 'linewidth': 1.4, 'linestyle': 'dotted'}}


def layers_figure(risk_map: RiskMap, layers: Sequence[Layer]) -> Figure:
    """The map with the shapes of all layers, then a panel for each layer."""
    width, height = risk_map.size
    shape = min(max(height / width, 0.2), 2.0)
    rows = -(-len(layers) // _COLUMNS)
    tall, below = 1.2 + _WIDE * shape, rows * (0.5 + _NARROW * shape)
    figure = Figure((map_figures.WIDTH, tall + below), layout='compressed')
    top, bottom = (figure.subfigures(2, 1, height_ratios=(tall, below)) if rows
                   else (figure.subfigures(), None))
    whole = top.subplots()
    image = map_figures.draw_map(whole, risk_map, 'Risk map')
    map_figures.colour_bar(whole, image, map_figures.LOSS)
    key = [*map_figures.ground_key(risk_map), *_draw_shapes(whole, layers)]
    _name_places(whole, risk_map, layers)
    if key:
        top.legend(handles=key, loc='outside lower left', ncols=3, frameon=False)
    panels = bottom.subplots(rows, _COLUMNS, squeeze=False).ravel() if bottom else ()
    for axes, layer in zip(panels, layers, strict=False):
        _draw(axes, risk_map, layer)
    for axes in panels[len(layers):]:
        axes.set_axis_off()
    return figure


def _draw_shapes(axes: Axes, layers: Sequence[Layer]) -> list[Line2D]:
    """Draw roads, incidents and outlines of polygons; return their entries of a legend."""
    key = []
    for layer in layers:
        if layer.shapes is None:
            continue
        style = _STYLES[layer.kind]
        if layer.kind == 'incidents':
            axes.plot(layer.shapes.x, layer.shapes.y, zorder=6, **style)
        else:
            layer.shapes.plot(ax=axes, aspect=None, zorder=5, **style)
        key.append(Line2D([], [], label=layer.title.partition(':')[0], **style))
    axes.set(xlabel='', ylabel='')
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


def _draw(axes: Axes, risk_map: RiskMap, layer: Layer) -> None:
    map_figures.frame(axes, risk_map, layer.title)
    block = math.ceil(max(layer.values.shape) / map_figures.MAX_CELLS)
    values = np.ma.masked_invalid(pooled(np.fmax, layer.values.astype(float), block))
    less = values.min() < 0.0
    style: dict[str, Any] = {'cmap': 'PuOr_r' if less else 'magma_r',
                             'norm': CenteredNorm() if less else None}
    shown = risk_map.coarser(map_figures.MAX_CELLS)
    image = map_figures.draw_cells(axes, shown, values, **style)
    if layer.values.dtype != bool:
        map_figures.colour_bar(axes, image, '')
    if layer.shapes is not None:
        layer.shapes.plot(ax=axes, aspect=None, linewidth=1.0, color=ROUTES[0], markersize=4.0)
    axes.set(xticks=[], yticks=[], xlabel='', ylabel='')
