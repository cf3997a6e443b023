# SPDX-License-Identifier: Apache-2.0
"""Arguments and messages of the commands that write files of routes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ..route_files import SUFFIXES, Drawn
from .cli import Console, count, place

FORMATS_HELP = """\
FILE's suffix sets its format. .gpkg (GeoPackage; QGIS draws it with config/ambush_planner.qml) and
.geojson have the routes (departure, length [m], time of drawing), the edges (probability), the
ambush sites (probability, loss), held and forbidden ground. .geojson (property layer) is in
latitude and longitude if the map has a coordinate system, .gpkg in the map's. .gpx has each
departure as a route with its corners and as a track. .kml has the routes as lines; .csv too, in the
map's coordinates (WKT); .png is a picture. Routes are secret: files have mode 0600."""


def add_outputs(parser: argparse.ArgumentParser, what: str = 'files for the routes',
                suffixes: Sequence[str] = SUFFIXES) -> None:
    """Add the argument ``--output``, a list of files with one of the suffixes each."""
    def output(text: str) -> Path:
        if Path(text).suffix not in suffixes:
            raise argparse.ArgumentTypeError(
                f'{text}: its suffix must be one of {", ".join(suffixes)}')
        return Path(text)

    parser.add_argument('-o', '--output', type=output, nargs='+', required=True, metavar='FILE',
                        help=f'{what}: ' + ', '.join(suffixes))


def tell_outputs(paths: Sequence[Path], drawn: Drawn, console: Console) -> None:
    """Print what was written, and put it into the result."""
    files = [place(path) for path in paths]
    console.line(f'{", ".join(files)}: {count(len(drawn.paths), "route")}; secret, so only this '
                 'user can read them.')
    console.result |= {'files': files, 'departures': len(drawn.paths)}
