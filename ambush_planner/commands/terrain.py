# SPDX-License-Identifier: Apache-2.0
"""The options with which an elevation model becomes a risk map, and that map."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

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
from . import cli


def add_terrain(terrain: argparse._ArgumentGroup) -> None:
    """Add the options with which an elevation model becomes a risk map."""
    for name, default, text in (
        ('--resolution', None, "cell size [m] (default: the DEM's)"),
        ('--weapon-range', 300.0, 'range of weapons [m] (default: 300)'),
        ('--vehicle-height', 2.5, 'height of vehicles [m] (default: 2.5)'),
        ('--person-height', 1.7, 'eye height of a person [m] (default: 1.7)'),
        ('--slope-limit', 0.42, 'maximum drivable slope (rise/run, default: 0.42)'),
        ('--road-factor', 0.5, 'risk on roads relative to open ground (default: 0.5)'),
    ):
        terrain.add_argument(name, type=float, metavar='X', help=text)
        _DEFAULTS[_field(name)] = default
    terrain.add_argument('--weights', type=float, nargs=4,
                         metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
                         help='weights of the four shares (default: 0.4 0.2 0.2 0.2)')


def terrain_options_in(arguments: argparse.Namespace) -> list[str]:
    """The fields of the options of ``add_terrain`` that were given."""
    return [name for name in _DEFAULTS if getattr(arguments, name) is not None]


def _field(option: str) -> str:
    return option[2:].replace('-', '_')


# Defaults of the options of an elevation model.
_DEFAULTS: dict[str, Any] = {'weights': (0.4, 0.2, 0.2, 0.2)}


def terrain_of(arguments: argparse.Namespace, source: Path, roads: Path | None,
               console: cli.Console) -> tuple[Elevation, TerrainMap]:
    """An elevation model, and its risk map with a raster of roads."""
    for name, default in _DEFAULTS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
    views = ViewOptions(weapon_range=arguments.weapon_range,
                        vehicle_height=arguments.vehicle_height,
                        person_height=arguments.person_height)
    options = TerrainOptions(view=views, slope_limit=arguments.slope_limit,
                             weights=tuple(arguments.weights), road_factor=arguments.road_factor)
    raster = read_raster(source, crs=arguments.crs or None)
    elevation = elevation_from_raster(raster, arguments.resolution or 0.0)
    mask = mask_from_raster(read_raster(roads, 'roads'), elevation) if roads else None
    return elevation, terrain_map(elevation, options, mask, console.bar('lines of sight'))
