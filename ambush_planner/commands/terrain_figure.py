"""The preview of a risk map from terrain: the elevation, its layers, and the map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.figure import Figure

from ..maps import Elevation, TerrainMap
from ..maps.occupancy import risk_map_from_occupancy
from .figures import OBSTACLE, draw_risk_map, frame

# Maximum cells across a panel; larger maps are subsampled.
_MOST_CELLS = 1000


def terrain_figure(elevation: Elevation, ground: TerrainMap) -> Figure:
    """Draw six panels: height, slope, depth, exposure, approach, and the risk map."""
    figure = Figure(figsize=(15.0, 9.6), dpi=110, layout='compressed')
    panels = figure.subplots(2, 3).ravel()
    risk_map = risk_map_from_occupancy(ground.values, ground.resolution)
    layers = (
        (elevation.heights, 'Height [m]', 'cividis'),
        (ground.slope, 'Slope, rise over run', 'magma_r'),
        (ground.depth, 'Depth below the ground within range [m]', 'magma_r'),
        (ground.exposure, 'Share of the ground within range that sees a vehicle', 'magma_r'),
        (ground.approach, 'Mean distance to the nearest hidden ground [m]', 'magma'),
    )
    for axes, (layer, title, colours) in zip(panels, layers, strict=False):
        frame(axes, risk_map, title)
        _draw(axes, elevation, layer, colours)
    frame(panels[-1], risk_map, 'Risk map: grey risk, black obstacle or unknown')
    risk = draw_risk_map(panels[-1], risk_map)
    figure.colorbar(risk, ax=panels[-1], shrink=0.7, label='loss')
    if ground.roads.any():
        _draw_roads(panels[-1], ground)
    return figure


def _draw(axes: Axes, elevation: Elevation, layer: npt.NDArray[np.float32], colours: str) -> None:
    thin = max(1, max(layer.shape) // _MOST_CELLS)
    shown = np.ma.masked_invalid(layer[::thin, ::thin])
    rows, columns = np.array(layer.shape) * elevation.resolution
    place = {'origin': 'lower', 'extent': (0.0, columns, 0.0, rows), 'interpolation': 'nearest'}
    axes.set_facecolor(OBSTACLE)
    image = axes.imshow(shown, cmap=colours, **place)
    axes.figure.colorbar(image, ax=axes, shrink=0.7)
    if layer is elevation.heights:
        step = thin * elevation.resolution
        sun = LightSource(315.0, 45.0)
        shade = sun.hillshade(shown.filled(np.nanmin(layer))[::-1], dx=step, dy=step)[::-1]
        shade = np.ma.masked_where(np.isnan(layer[::thin, ::thin]), shade)
        axes.imshow(shade, cmap='gray', alpha=0.35, vmin=0.0, vmax=1.0, **place)


def _draw_roads(axes: Axes, ground: TerrainMap) -> None:
    rows, columns = np.array(ground.roads.shape) * ground.resolution
    axes.imshow(
        np.ma.masked_equal(ground.roads, False), origin='lower', cmap='winter', alpha=0.8,
        extent=(0.0, columns, 0.0, rows), interpolation='nearest', zorder=1,
    )
