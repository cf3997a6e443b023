# SPDX-License-Identifier: Apache-2.0
"""``ambush risk``: a risk map from an elevation model, or from layers of risk."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import cli
from .positions import add_crs

if TYPE_CHECKING:
    from ..maps.occupancy import OccupancyMap
    from ..maps.risk_map import RiskMap

DESCRIPTION = """\
Make a risk map from an elevation model, or from layers of risk.

  ambush risk dem.tif -o map.yaml --resolution 90 --weapon-range 500
  ambush risk layers.yaml -o map.yaml"""
# Options of an elevation model, for which ``ViewOptions`` and ``TerrainOptions`` have defaults.
_VIEW = {'weapon_range': 'range of weapons [m] (default: 300)',
         'vehicle_height': 'height of vehicles [m] (default: 2.5)',
         'person_height': 'eye height of a person [m] (default: 1.7)'}
_GROUND = {'slope_limit': 'maximum drivable slope (rise/run, default: 0.42)'}
COMMON = ('-o', '--resolution', '--weapon-range', '--slope-limit', '--crs')
USAGE = 'ambush risk DEM_OR_LAYERS [options] -o MAP.yaml'
EPILOG = """\
A DEM is a GeoTIFF of heights. LAYERS.yaml has a line for each layer of risk, such
as terrain, villages, roads and incidents; docs/risk_layers.md explains them.
It writes MAP.yaml and MAP.pgm for map_server, a picture, MAP.png, and, if the coordinate system is
known, a GeoTIFF, MAP.tif, with its style for QGIS; of layers also MAP.npz with the exact losses.
MAP.sources.json has the files that it was made from by name and hash, for ambush draw.
"""
DETAILS = """\
DEM is a GeoTIFF or another raster of heights in metres. Values of the map: 0..99 risk, 100 too
steep, -1 unknown. Risk is the weighted mean of four shares: depth of the cell below the ground
within weapon range, share of that ground from which a vehicle can be seen, how close a person can
come unseen, and slope.
ambush_planner.maps has the formulas. For roads in it, write layers: terrain and roads. A GeoTIFF
in degrees is reprojected to its UTM zone, and the map keeps the coordinate system.

LAYERS.yaml has a line for each layer; docs/risk_layers.md explains the formulas:

  layers:
  - {terrain: dem.tif, loss: 9}
  - {polygons: villages.gpkg, loss: 2, factor: 1.5}
  - {incidents: incidents.geojson, loss: 5, bandwidth: 400, half_life: 180}
  - {roads: roads.gpkg, width: 8, factor: 0.5, passable: true}

MAP.png shows the result with the shapes of all layers.
--json: {"verdict", "files", "alpha_min", "alpha_max", "remarks"}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('risk', DESCRIPTION, EPILOG, COMMON, DETAILS, USAGE)
    made.add_argument('source', type=cli.existing, metavar='DEM_OR_LAYERS',
                      help='the elevation model (.tif, ...), or the layers (.yaml)')
    made.add_argument('-o', '--output', type=cli.file_of('.yaml', '.yml'), required=True,
                      metavar='MAP.yaml', help='the map to write')
    terrain = made.add_argument_group('with an elevation model')
    for name, text in {'resolution': "cell size [m] (default: the DEM's)", **_VIEW,
                       **_GROUND}.items():
        terrain.add_argument(f'--{name.replace("_", "-")}', type=float, metavar='X', help=text)
    terrain.add_argument('--weights', type=float, nargs=4,
                         metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
                         help='weights of the four shares (default: 0.4 0.2 0.2 0.2)')
    add_crs(terrain)
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    given = [*_given(arguments, ('resolution', *_VIEW, *_GROUND, 'weights')),
             *['crs'] * bool(arguments.crs)]
    if arguments.source.suffix.lower() in ('.yaml', '.yml'):
        if given:
            raise cli.UsageError(f'--{given[0].replace("_", "-")} goes with an elevation model; '
                                 f'write it into {arguments.source.name}, as --help says')
        return _of_layers(arguments, console)
    return _of_terrain(arguments, console)


def _given(arguments: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(arguments, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _of_terrain(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..map_figures import as_png
    from ..maps import TerrainOptions, ViewOptions
    from ..maps.terrain_risk import terrain_of_file
    from ..recordings.sources import list_sources
    from .risk_figure import layers_figure

    cli.require(('pyproj', 'rasterio'))
    options = TerrainOptions(view=ViewOptions(**_given(arguments, _VIEW)),
                             **_given(arguments, (*_GROUND, 'weights')))
    with console.waiting('lines of sight') as tell:
        grid = terrain_of_file(arguments.source, options, arguments.resolution,
                               arguments.crs or None,
                               lambda share: tell(f'{share:.0%}'))
    picture = as_png(layers_figure(grid.risk_map(), ()), _picture_of(arguments).name,
                     [arguments.source.name])
    files = _written(arguments.output, grid, 'Risk map from an elevation model.', picture)
    files.append(list_sources(files, [arguments.source]))
    console.line(_summary(grid))
    unknown = 'no GeoTIFF is written, because the coordinate system is unknown: give it with --crs'
    return _told(files, grid.losses, [] if grid.crs else [unknown], console)


def _picture_of(arguments: argparse.Namespace) -> Path:
    return Path(arguments.output).with_suffix('.png')


def _of_layers(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..map_figures import as_png
    from ..maps.map_file import read_yaml
    from ..maps.risk_layers import InvalidLayers, risk_from_layers
    from ..maps.risk_map import LOSSES
    from ..maps.risk_map_file import npz_bytes
    from ..recordings.sources import layer_files, list_sources
    from .risk_figure import layers_figure

    with console.waiting('joining layers') as tell:
        joined = risk_from_layers(
            arguments.source, progress=lambda share: tell(f'lines of sight {share:.0%}'))
    grid = occupancy_of(joined.risk_map)
    output = arguments.output
    files = _written(output, grid, 'Risk map from layers.',
                     as_png(layers_figure(joined.risk_map, joined.layers),
                            _picture_of(arguments).name, [arguments.source.name]))
    files.insert(2, output.with_suffix('.npz'))
    files[2].write_bytes(npz_bytes(joined.risk_map))
    files.append(list_sources(files, [arguments.source, *layer_files(
        read_yaml(arguments.source, InvalidLayers), arguments.source.parent)]))
    if grid.losses != LOSSES:
        least, most = grid.losses
        console.line('losses go beyond {:g} to {:g}: '.format(*LOSSES)
                     + f'for the node, set map.alpha_min={least:.6g} map.alpha_max={most:.6g}')
    return _told(files, grid.losses, joined.remarks, console)


def _written(output: Path, grid: OccupancyMap, comment: str, picture: bytes) -> list[Path]:
    """Write the map for map_server, the picture and, in a known system, the GeoTIFF."""
    from ..maps.map_file import write_map
    from ..maps.risk_map_file import write_geotiff

    files = [output, write_map(output, grid, comment), output.with_suffix('.png')]
    files[2].write_bytes(picture)
    if grid.crs:
        files += [output.with_suffix('.tif'), output.with_suffix('.qml')]
        write_geotiff(files[3], grid)
        files[4].write_text(cli.resource('risk_map.qml'), encoding='utf-8')
    return files


def _told(files: list[Path], losses: tuple[float, float], remarks: Sequence[str],
          console: cli.Console) -> cli.Exit:
    for remark in remarks:
        console.item(remark, indent=0)
    console.result = {'files': [cli.place(path) for path in files], 'alpha_min': losses[0],
                      'alpha_max': losses[1], 'remarks': list(remarks)}
    console.line(', '.join(console.result['files']))
    return cli.Exit.HOLDS


def occupancy_of(risk_map: RiskMap) -> OccupancyMap:
    """Values 0..99 for the losses, which may go beyond the usual ones, and 100 for obstacles."""
    import numpy as np

    from ..maps.occupancy import OccupancyMap
    from ..maps.risk_map import LOSSES

    losses = risk_map.alpha[~risk_map.obstacles]
    least = float(losses.min(initial=LOSSES[0]))
    most = least + max((losses.max(initial=0.0) - least) / 0.99, LOSSES[1] - least)
    values = np.minimum(np.rint((risk_map.alpha - least) / (most - least) * 100.0), 99.0)
    values = np.where(risk_map.obstacles, 100, values).astype(np.int8)
    return OccupancyMap(values, risk_map.resolution, risk_map.origin, risk_map.crs,
                        (least, float(most)))


def _summary(grid: OccupancyMap) -> str:
    import numpy as np

    values = grid.values
    risk = values[(values >= 0) & (values < 100)]
    low, middle, high = np.percentile(risk, [10, 50, 90]) if risk.size else (0.0, 0.0, 0.0)
    return (f'{values.shape[1]} x {values.shape[0]} cells of {grid.resolution:g} m: '
            f'{100.0 * np.mean(values == 100):.1f} % too steep, {100.0 * np.mean(values == -1):.1f}'
            f' % unknown; risk of drivable cells, 0 to 99: half are below {middle:.0f}, '
            f'a tenth below {low:.0f}, a tenth above {high:.0f}')


main = cli.command(parser, _work)
