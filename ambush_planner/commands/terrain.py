# SPDX-License-Identifier: Apache-2.0
"""The options with which an elevation model becomes a risk map, and that map."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import cli

if TYPE_CHECKING:
    from ..maps import OccupancyMap

# Options of an elevation model, for which ``ViewOptions`` and ``TerrainOptions`` have defaults.
_VIEW = {'weapon_range': 'range of weapons [m] (default: 300)',
         'vehicle_height': 'height of vehicles [m] (default: 2.5)',
         'person_height': 'eye height of a person [m] (default: 1.7)'}
_GROUND = {'slope_limit': 'maximum drivable slope (rise/run, default: 0.42)',
           'road_factor': 'risk on roads relative to open ground (default: 0.5)'}


def add_terrain(terrain: argparse._ArgumentGroup) -> None:
    """Add the options with which an elevation model becomes a risk map."""
    for name, text in {'resolution': "cell size [m] (default: the DEM's)", **_VIEW,
                       **_GROUND}.items():
        terrain.add_argument(f'--{name.replace("_", "-")}', type=float, metavar='X', help=text)
    terrain.add_argument('--weights', type=float, nargs=4,
                         metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
                         help='weights of the four shares (default: 0.4 0.2 0.2 0.2)')


def terrain_options_in(arguments: argparse.Namespace) -> list[str]:
    """The fields of the options of ``add_terrain`` that were given."""
    return list(_given(arguments, ('resolution', *_VIEW, *_GROUND, 'weights')))


def _given(arguments: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(arguments, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def terrain_of(arguments: argparse.Namespace, source: Path, roads: Path | None,
               console: cli.Console) -> OccupancyMap:
    """The map of an elevation model, with a raster of roads."""
    from ..maps import TerrainOptions, ViewOptions
    from ..maps.terrain_file import terrain_of_file

    views = ViewOptions(**_given(arguments, _VIEW))
    options = TerrainOptions(view=views, **_given(arguments, (*_GROUND, 'weights')))
    return terrain_of_file(source, options, arguments.resolution, roads, arguments.crs or None,
                           console.bar('lines of sight'))
