"""``ambush_terrain``: a risk map for map_server from an elevation model."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..maps import (
    Elevation,
    TerrainMap,
    TerrainOptions,
    ViewOptions,
    elevation_from_raster,
    mask_from_raster,
    terrain_map,
)
from ..maps.elevation_file import read_raster
from ..maps.map_file import write_map
from ..maps.occupancy import OccupancyMap
from . import cli
from .terrain_figure import terrain_figure

EPILOG = """\
DEM is a GeoTIFF (pip install 'ambush_planner[terrain]'), or an npz file with elevation (H, W) [m],
the northernmost row first, NaN where unknown, and resolution [m] (or dx and dy [m]). --roads takes
the same kinds of file (npz: roads), not 0 where a road leads.

Values: 0..99 risk, 100 too steep, -1 unknown. Risk is the weighted mean of four shares: how deep
the cell lies below the ground within weapon range, from how much of that ground a vehicle is seen,
from how near it is reached unseen, and its slope. The formulas and their sources are in the package
ambush_planner.maps. The map's origin is its south-west corner.

Beside MAP.yaml it writes MAP.pgm, in map_server's mode raw, and MAP.png, to look at.
--json: {"verdict", "files"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('terrain', 'Make a risk map from an elevation model.', EPILOG)
    made.add_argument('elevation', type=Path, metavar='DEM', help='GeoTIFF or npz')
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='MAP.yaml', help='the map to write'
    )
    made.add_argument('--roads', type=Path, metavar='FILE', help='where roads lead')
    number = {'type': float, 'metavar': 'M'}
    made.add_argument(
        '--resolution', default=0.0, help="edge of a cell [m] (default: the DEM's)", **number
    )
    made.add_argument('--weapon-range', default=300.0, help='[m] (default: 300)', **number)
    made.add_argument('--vehicle-height', default=2.5, help='[m] (default: 2.5)', **number)
    made.add_argument('--person-height', default=1.7, help='[m] (default: 1.7)', **number)
    made.add_argument(
        '--slope-limit', type=float, default=0.42, metavar='S',
        help='rise over run that is not driven over (default: 0.42)',
    )
    made.add_argument(
        '--road-factor', type=float, default=0.5, metavar='F',
        help='risk on roads over that beside them (default: 0.5)',
    )
    made.add_argument(
        '--weights', type=float, nargs=4, default=(0.4, 0.2, 0.2, 0.2),
        metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
        help='of the four shares (default: 0.4 0.2 0.2 0.2)',
    )
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> int:
    """Write the map, its picture and the preview, and return the exit code."""
    options = TerrainOptions(
        ViewOptions(
            arguments.weapon_range, arguments.vehicle_height, arguments.person_height
        ),
        arguments.slope_limit,
        tuple(arguments.weights),
        arguments.road_factor,
    )
    elevation = elevation_from_raster(read_raster(arguments.elevation), arguments.resolution)
    roads = arguments.roads and mask_from_raster(read_raster(arguments.roads, 'roads'), elevation)
    ground = terrain_map(elevation, options, roads, console.bar('lines of sight'))
    occupancy = OccupancyMap(ground.values, ground.resolution)
    pictures = [write_map(arguments.output, occupancy, _remark(elevation))]
    pictures.append(arguments.output.with_suffix('.png'))
    terrain_figure(elevation, ground).savefig(pictures[-1])
    console.line(_summary(ground))
    console.line(
        f'{cli.place(arguments.output)}, {", ".join(picture.name for picture in pictures)}'
    )
    console.result = {'files': [cli.place(path) for path in (arguments.output, *pictures)]}
    return cli.Exit.HOLDS


def _remark(elevation: Elevation) -> str:
    place = f'; its lower left corner lies at {elevation.place}' if elevation.place else ''
    return f'Risk map from an elevation model{place}.'


def _summary(ground: TerrainMap) -> str:
    rows, columns = ground.values.shape
    values = ground.values
    risk = values[(values >= 0) & (values < 100)]
    spread = ', '.join(f'{v:.0f}' for v in np.percentile(risk, [10, 50, 90])) if risk.size else '-'
    return (
        f'{columns} x {rows} cells of {ground.resolution:g} m: '
        f'{100.0 * np.mean(values == 100):.1f} % too steep, '
        f'{100.0 * np.mean(values == -1):.1f} % unknown; '
        f'risk (10 %, 50 %, 90 % of the rest) {spread}'
    )


main = cli.command(parser, _work)
