"""What ``ambush_terrain`` does: read the ground, make the map, write it and a picture of it."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..terrain import (
    Elevation,
    OccupancyMap,
    TerrainMap,
    TerrainOptions,
    ViewOptions,
    elevation_from,
    mask_from,
    read_raster,
    terrain_map,
    write_map,
)
from . import cli
from .terrain_figure import terrain_figure


def run_terrain(arguments: argparse.Namespace, console: cli.Console) -> int:
    """Write the map, its picture and the preview, and return the exit code."""
    options = TerrainOptions(
        ViewOptions(
            arguments.weapon_range, arguments.vehicle_height, arguments.person_height
        ),
        arguments.slope_limit,
        tuple(arguments.weights),
        arguments.road_factor,
    )
    elevation = elevation_from(read_raster(arguments.elevation), arguments.resolution)
    roads = arguments.roads and mask_from(read_raster(arguments.roads, 'roads'), elevation)
    ground = terrain_map(elevation, options, roads, console.bar('lines of sight'))
    occupancy = OccupancyMap(ground.values, ground.resolution)
    pictures = [write_map(arguments.output, occupancy, _remark(elevation))]
    pictures.append(_write_preview(arguments.output, elevation, ground))
    console.line(_summary(ground))
    console.line(
        f'{cli.place(arguments.output)}, {", ".join(picture.name for picture in pictures)}'
    )
    console.result = {
        'verdict': 'holds', 'files': [cli.place(path) for path in (arguments.output, *pictures)],
    }
    return cli.Exit.HOLDS


def _remark(elevation: Elevation) -> str:
    place = f'; its lower left corner lies at {elevation.place}' if elevation.place else ''
    return f'Risk map from an elevation model{place}.'


def _write_preview(path: Path, elevation: Elevation, ground: TerrainMap) -> Path:
    picture = path.with_suffix('.png')
    terrain_figure(elevation, ground).savefig(picture)
    return picture


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
