# SPDX-License-Identifier: Apache-2.0
"""Arguments and messages of the commands that write files of routes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..route_files import NEEDS, PLAN, SUFFIXES
from .cli import Console, count, file_of, place, require

if TYPE_CHECKING:
    from ..route_files import Drawn

FORMATS_HELP = """\
FILE's suffix sets its format. .gpkg (GeoPackage; QGIS draws it with config/ambush_planner.qml) and
.geojson have the routes (departure, length [m], time of drawing), the edges (probability), the
ambush sites (probability, loss), secured area, forbidden ground. .geojson (property layer) is in
latitude and longitude if the map has a coordinate system, .gpkg in the map's. .gpx has each
departure as a route with its corners and as a track. .csv has the routes as lines (WKT) in the
map's coordinates; .png is a picture. Routes are secret: files have mode 0600."""


def add_outputs(parser: argparse.ArgumentParser, what: str = 'files for the routes',
                suffixes: Sequence[str] = SUFFIXES) -> None:
    """Add the argument ``--output``, a list of files with one of the suffixes each."""
    parser.add_argument('-o', '--output', type=file_of(*suffixes), nargs='+', required=True,
                        metavar='FILE', help=f'{what}: {", ".join(suffixes)}')


def require_for(paths: Sequence[Path]) -> None:
    """Raise MissingPackages if a package is not installed that a format of the files needs."""
    require(sorted({name for path in paths for name in NEEDS.get(path.suffix.lower(), ())}))


def check_outputs(paths: Sequence[Path], console: Console) -> None:
    """Raise MissingPackages if a format needs some; name the files that will be overwritten."""
    require_for(paths)
    for path in paths:
        if path.exists():
            console.say(f'{place(path)} will be overwritten.')


def tell_outputs(paths: Sequence[Path], drawn: Drawn, console: Console) -> None:
    """Print what was written, and put it into the result."""
    plans = [path for path in paths if path.suffix.lower() == PLAN]
    routes = [count(len(drawn.paths), 'route')] * (len(paths) > len(plans))
    what = ', '.join([*['plan'] * bool(plans), *routes])
    files = console.secret(paths, f'{what}; ')
    if plans:
        suffix = '.gpx' if drawn.risk_map.crs else '.csv'
        console.line(f'Each day: ambush draw {place(plans[0])} -o card.html route{suffix}')
    console.result |= {'files': files, 'departures': len(drawn.paths)}
