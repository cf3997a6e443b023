# SPDX-License-Identifier: Apache-2.0
"""Arguments and messages of the commands that write files of routes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..route_files import NEEDS, PLAN, SUFFIXES, Drawn
from .cli import Console, count, file_of, place, require

FORMATS_HELP = """\
FILE's suffix sets its format. .gpkg (GeoPackage; QGIS draws it with config/ambush_planner.qml) and
.geojson have the routes (departure, length [m], time of drawing), the edges (probability), the
ambush sites (probability, loss), secured area, forbidden ground. .geojson (property layer) is in
latitude and longitude if the map has a coordinate system, .gpkg in the map's. .gpx has each
departure as a route with its corners and as a track. .kml has the routes as lines; .csv too, in the
map's coordinates (WKT); .png is a picture. Routes are secret: files have mode 0600."""


def add_outputs(parser: argparse.ArgumentParser, what: str = 'files for the routes',
                suffixes: Sequence[str] = SUFFIXES, tell: bool = True) -> None:
    """Add the argument ``--output``, a list of files with one of the suffixes each.

    The help lists the suffixes if ``tell``.
    """
    parser.add_argument('-o', '--output', type=file_of(*suffixes), nargs='+', required=True,
                        metavar='FILE',
                        help=what + (': ' + ', '.join(suffixes)) * tell)


def check_outputs(paths: Sequence[Path]) -> None:
    """Raise MissingPackages if a format needs some."""
    require(sorted({name for path in paths for name in NEEDS.get(path.suffix.lower(), ())}))


def tell_overwritten(paths: Iterable[Path], console: Console) -> None:
    """Name the files that are about to be overwritten."""
    for path in paths:
        if path.exists():
            console.say(f'{place(path)} is overwritten.')


def tell_outputs(paths: Sequence[Path], drawn: Drawn, console: Console) -> None:
    """Print what was written, and put it into the result."""
    plans = [path for path in paths if path.suffix.lower() == PLAN]
    routes = [count(len(drawn.paths), 'route')] * (len(paths) > len(plans))
    what = ', '.join([*['plan'] * bool(plans), *routes])
    files = console.secret(paths, f'{what}; ')
    if plans:
        gpx = ' route.gpx' * bool(drawn.risk_map.crs)
        console.line(f'Each day: ambush draw {place(plans[0])} -o card.html{gpx}')
    console.result |= {'files': files, 'departures': len(drawn.paths)}
