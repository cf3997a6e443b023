# SPDX-License-Identifier: Apache-2.0
"""``ambush risk``: a risk map from terrain, polygons, roads and incidents."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..colours import ROUTES
from ..figures import WIDTH, as_png, draw_cells, draw_map, frame, risk_bar
from ..maps.map_file import write_map
from ..maps.occupancy import OccupancyMap
from ..maps.risk_layers import Layer, LayeredRisk, risk_from_layers
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import write_geotiff
from . import cli
from .inputs import add_map_output

EPILOG = """\
LAYERS.yaml has a line for each layer; docs/risk_layers.md explains the formulas:

  layers:
  - {terrain: dem.tif, loss: 9}
  - {polygons: villages.gpkg, loss: 2, factor: 1.5}
  - {incidents: incidents.geojson, loss: 5, bandwidth: 400, half_life: 180}
  - {roads: roads.gpkg, width: 8, factor: 0.5, passable: true}

It writes MAP.yaml and MAP.pgm for map_server, MAP.npz with the exact losses, MAP.png with a
picture of each layer and of the result, and, if the coordinate system is known, a GeoTIFF, MAP.tif.
--json: {"verdict", "files", "alpha_min", "alpha_max", "remarks"}
""" + cli.EXIT_CODES
# Losses of the values 0 and 100 in MAP.yaml unless the map exceeds them: the node's defaults.
LEAST, MOST = 1.0, 10.0
_COLUMNS = 2


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('risk', 'Make a risk map from layers.', EPILOG)
    made.add_argument('layers', type=Path, metavar='LAYERS.yaml', help='the layers')
    add_map_output(made)
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    joined = risk_from_layers(arguments.layers, progress=console.bar('lines of sight'))
    grid, least, most = occupancy_of(joined.risk_map)
    figure = layers_figure(joined)
    scale = f'map.alpha_min={least:.6g} map.alpha_max={most:.6g}'
    output = arguments.output
    files = [output, write_map(output, grid, f'Risk map from layers; its losses: {scale}'),
             output.with_suffix('.npz'), output.with_suffix('.png')]
    risk_map = joined.risk_map
    np.savez_compressed(files[2], alpha=risk_map.alpha, obstacles=risk_map.obstacles,
                        resolution=risk_map.resolution, origin=risk_map.origin,
                        crs=risk_map.crs or '')
    files[3].write_bytes(as_png(figure))
    if grid.crs:
        files.append(output.with_suffix('.tif'))
        write_geotiff(files[-1], grid)
    for remark in joined.remarks:
        console.item(remark, indent=0)
    if (least, most) != (LEAST, MOST):
        console.line(f'losses go beyond {LEAST:g} to {MOST:g}: with {output.name}, set {scale}')
    console.result = {'files': [cli.place(path) for path in files], 'alpha_min': least,
                      'alpha_max': most, 'remarks': joined.remarks}
    console.line(', '.join(console.result['files']))
    return cli.Exit.HOLDS


def occupancy_of(risk_map: RiskMap) -> tuple[OccupancyMap, float, float]:
    """Values 0..99 for the losses, 100 for obstacles, and the losses of the values 0 and 100."""
    losses = risk_map.alpha[~risk_map.obstacles]
    least = float(min(losses.min(initial=LEAST), LEAST))
    most = least + max((losses.max(initial=0.0) - least) / 0.99, MOST - least)
    values = np.minimum(np.rint((risk_map.alpha - least) / (most - least) * 100.0), 99.0)
    values = np.where(risk_map.obstacles, 100, values).astype(np.int8)
    return (OccupancyMap(values, risk_map.resolution, risk_map.origin, risk_map.crs), least,
            float(most))


def layers_figure(joined: LayeredRisk) -> Figure:
    """Draw each layer, and the sum in the last panel."""
    count = len(joined.layers) + 1
    rows, columns = -(-count // _COLUMNS), min(count, _COLUMNS)
    width, height = joined.risk_map.size
    size = (0.5 * WIDTH * columns, (0.8 + 3.0 * min(height / width, 3.0)) * rows)
    figure = Figure(size, layout='compressed')
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, layer in zip(panels, joined.layers, strict=False):
        _draw(figure, axes, joined.risk_map, layer)
    last = panels[count - 1]
    risk_bar(figure, draw_map(last, joined.risk_map, 'Risk map'), last, shrink=0.7)
    for axes in panels[count:]:
        axes.set_visible(False)
    return figure


def _draw(figure: Figure, axes: Axes, risk_map: RiskMap, layer: Layer) -> None:
    frame(axes, risk_map, layer.title)
    image = draw_cells(axes, risk_map, np.ma.masked_invalid(layer.values), cmap='magma_r')
    figure.colorbar(image, ax=axes, shrink=0.7)
    if layer.shapes is not None:
        parts = {'column': 'part', 'cmap': 'tab10', 'legend': True,
                 'legend_kwds': {'title': 'connected parts', 'fontsize': 'small'}}
        style = parts if 'part' in layer.shapes else {'color': ROUTES[0], 'markersize': 4.0}
        layer.shapes.plot(ax=axes, aspect=None, linewidth=1.0, **style)


main = cli.command(parser, _work)
