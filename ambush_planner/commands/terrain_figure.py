# SPDX-License-Identifier: Apache-2.0
"""The picture of a risk map from an elevation model."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..figures import WIDTH, draw_cells, draw_map, frame, ground_legend, risk_bar
from ..maps import Elevation, TerrainMap
from ..maps.occupancy import OccupancyOptions


def terrain_figure(elevation: Elevation, ground: TerrainMap) -> Figure:
    """Draw six panels: height, slope, depth, exposure, approach, and the risk map with roads."""
    figure = Figure(figsize=(WIDTH, 9.3), layout='compressed')
    *panels, last = figure.subplots(3, 2).ravel()
    risk_map = ground.risk_map(elevation.corner, OccupancyOptions(crs=elevation.crs))
    for axes, (layer, title, colours) in zip(panels, (
        (elevation.heights, 'Height [m]', 'cividis'),
        (ground.slope, 'Slope, rise over run', 'magma_r'),
        (ground.depth, 'Depth below the ground in range [m]', 'magma_r'),
        (ground.exposure, 'Share of ground in range that sees you', 'magma_r'),
        (ground.approach, 'Mean distance to hidden ground [m]', 'magma'),
    ), strict=True):
        frame(axes, risk_map, title)
        shown = draw_cells(axes, risk_map, np.ma.masked_invalid(layer), cmap=colours)
        figure.colorbar(shown, ax=axes, shrink=0.7)
    risk_bar(figure, draw_map(last, risk_map, 'Risk map'), last, shrink=0.7)
    if ground.roads.any():
        draw_cells(last, risk_map, np.ma.masked_equal(ground.roads, False), cmap='winter',
                   alpha=0.8)
    ground_legend(figure, risk_map)
    return figure
