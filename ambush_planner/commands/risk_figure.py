# SPDX-License-Identifier: Apache-2.0
"""The picture of ``ambush risk``: each layer, if there are any, and the risk map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from .. import map_figures
from ..colours import ROUTES
from ..maps.risk_layers import Layer
from ..maps.risk_map import RiskMap


def layers_figure(risk_map: RiskMap, layers: Sequence[Layer]) -> Figure:
    """A panel for each layer, then the map."""
    count = len(layers) + 1
    rows, columns = -(-count // 2), min(count, 2)
    width, height = risk_map.size
    size = (0.5 * map_figures.WIDTH * columns, (0.8 + 2.0 * min(height / width, 3.0)) * rows)
    figure = Figure(size, layout='compressed')
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, layer in zip(panels, layers, strict=False):
        _draw(figure, axes, risk_map, layer)
    last = panels[count - 1]
    map_figures.risk_bar(figure, map_figures.draw_map(last, risk_map, 'Risk map'), last, shrink=0.7)
    for axes in panels[count:]:
        axes.set_visible(False)
    map_figures.ground_legend(figure, risk_map)
    return figure


def _draw(figure: Figure, axes: Axes, risk_map: RiskMap, layer: Layer) -> None:
    map_figures.frame(axes, risk_map, layer.title)
    values = np.ma.masked_invalid(layer.values.astype(float))
    less = values.min() < 0.0
    style: dict[str, Any] = {'cmap': 'PuOr_r' if less else 'magma_r',
                             'norm': CenteredNorm() if less else None}
    image = map_figures.draw_cells(axes, risk_map, values, **style)
    if layer.values.dtype != bool:
        figure.colorbar(image, ax=axes, shrink=0.7)
    if layer.shapes is not None:
        parts = {'column': 'part', 'cmap': 'tab10', 'legend': True,
                 'legend_kwds': {'title': 'connected parts', 'fontsize': 'small'}}
        style = parts if 'part' in layer.shapes else {'color': ROUTES[0], 'markersize': 4.0}
        layer.shapes.plot(ax=axes, aspect=None, linewidth=1.0, **style)
        axes.set(xlabel='', ylabel='')
