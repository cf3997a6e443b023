# SPDX-License-Identifier: Apache-2.0
"""``ambush terrain``: a risk map for map_server from an elevation model."""

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
from ..maps.risk_map_file import in_local_frame, write_geotiff
from . import cli
from .inputs import add_crs, add_map_output, crs_text

EPILOG = """\
DEM is a GeoTIFF (pip install 'ambush_planner[gis]'), or an npz file with elevation (H, W) [m],
the northernmost row first, NaN where unknown, and resolution [m] (or dx and dy [m]). --roads takes
the same kinds of files (npz: roads); cells other than 0 are roads.

Map values: 0..99 risk, 100 too steep, -1 unknown. Risk is the weighted mean of four shares: depth
of the cell below the ground within weapon range, share of that ground from which a vehicle can be
seen, how close a person can come unseen, and slope. ambush_planner.maps has the formulas.
A GeoTIFF in degrees is reprojected to its UTM zone, and the map keeps the coordinate system.

It also writes MAP.pgm, in map_server's mode raw, a preview, MAP.png, and, if the coordinate system
is known, a GeoTIFF, MAP.tif, whose second band has the heights: pictures show the relief then.
--json: {"verdict", "files"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('terrain', 'Make a risk map from an elevation model.', EPILOG)
    made.add_argument('elevation', type=Path, metavar='DEM', help='GeoTIFF or npz')
    add_map_output(made)
    add_terrain(made)
    add_crs(made)
    return made


def add_terrain(made: argparse._ActionsContainer) -> None:
    """Add the options that convert an elevation model to risk."""
    made.add_argument('--roads', type=Path, metavar='FILE',
                      help='raster of roads: cells other than 0')
    for name, default, text in (
        ('--resolution', 0.0, "cell size [m] (default: the DEM's)"),
        ('--weapon-range', 300.0, 'range of weapons [m] (default: 300)'),
        ('--vehicle-height', 2.5, 'height of vehicles [m] (default: 2.5)'),
        ('--person-height', 1.7, 'eye height of a person [m] (default: 1.7)'),
        ('--slope-limit', 0.42, 'maximum drivable slope (rise/run, default: 0.42)'),
        ('--road-factor', 0.5, 'risk on roads relative to open ground (default: 0.5)'),
    ):
        made.add_argument(name, type=float, default=default, metavar='X', help=text)
    made.add_argument('--weights', type=float, nargs=4, default=(0.4, 0.2, 0.2, 0.2),
                      metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
                      help='weights of the four shares (default: 0.4 0.2 0.2 0.2)')


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    raster = arguments.elevation.suffix.lower() != '.npz'
    cli.require(('matplotlib', *('pyproj', 'rasterio') * raster))
    from ..figures import as_png
    from .terrain_figure import terrain_figure

    elevation, ground = terrain_from(arguments, arguments.elevation, console)
    grid = OccupancyMap(ground.values, ground.resolution, (*elevation.corner, 0.0), elevation.crs)
    if arguments.datum:
        grid = in_local_frame(grid, crs_text(arguments))
    files = [
        arguments.output,
        write_map(arguments.output, grid, 'Risk map from an elevation model.'),
        arguments.output.with_suffix('.png'),
    ]
    files[-1].write_bytes(as_png(terrain_figure(elevation, ground)))
    if grid.crs:
        files.append(arguments.output.with_suffix('.tif'))
        write_geotiff(files[-1], grid, ground.heights)
    console.line(_summary(ground))
    console.result = {'files': [cli.place(path) for path in files]}
    console.line(', '.join(console.result['files']))
    return cli.Exit.HOLDS


def terrain_from(arguments: argparse.Namespace, path: Path,
                 console: cli.Console) -> tuple[Elevation, TerrainMap]:
    """Make the risk map of an elevation model with the options of ``add_terrain``."""
    views = ViewOptions(weapon_range=arguments.weapon_range,
                        vehicle_height=arguments.vehicle_height,
                        person_height=arguments.person_height)
    options = TerrainOptions(view=views, slope_limit=arguments.slope_limit,
                             weights=tuple(arguments.weights),
                             road_factor=arguments.road_factor)
    raster = read_raster(path, crs=arguments.crs or None)
    elevation = elevation_from_raster(raster, arguments.resolution)
    roads = arguments.roads and mask_from_raster(read_raster(arguments.roads, 'roads'), elevation)
    return elevation, terrain_map(elevation, options, roads, console.bar('lines of sight'))


def _summary(ground: TerrainMap) -> str:
    values = ground.values
    risk = values[(values >= 0) & (values < 100)]
    low, middle, high = np.percentile(risk, [10, 50, 90]) if risk.size else (0.0, 0.0, 0.0)
    return (f'{values.shape[1]} x {values.shape[0]} cells of {ground.resolution:g} m: '
            f'{100.0 * np.mean(values == 100):.1f} % too steep, {100.0 * np.mean(values == -1):.1f}'
            f' % unknown; risk of drivable cells, 0 to 99: half are below {middle:.0f}, '
            f'a tenth below {low:.0f}, a tenth above {high:.0f}')


main = cli.command(parser, _work)
