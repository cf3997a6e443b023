# SPDX-License-Identifier: Apache-2.0
"""``ambush draw``: draw one of a few routes, and perhaps a slot, for a departure."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..planning.route_sheet import read_route_sheet
from . import cli

EPILOG = """\
FILE holds a few routes and their shares; ambush plan MAP ... --routes K -o FILE.json writes it. The
draw takes the operating system's entropy and is not recorded. The file is one JSON object:
{"format": "ambush routes 1", "map", "crs", "start": [x, y], "goal": [x, y], "stops": [[x, y]],
"held_radius", "reach", "value", "lower_bound", "routes": [{"number", "share", "length",
"path": [[x, y]], "lat_lon": [[latitude, longitude]]}], "slots": [["HH:MM", share]]}
Positions are the map's [m]; crs and lat_lon are null if its coordinate system is unknown.
map is relative to FILE's folder; slots is empty without --slots. Routes are secret: the file has
mode 0600.
--json: {"verdict", "route", "share", "length", "slot"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('draw', 'Draw one of a few routes, for a departure.', EPILOG)
    made.add_argument('file', type=Path, metavar='FILE', help='the routes, FILE.json')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    route, slot = read_route_sheet(options.file).draw(np.random.default_rng())
    console.line(f'route {route.number}' + (f', {slot}' if slot else ''))
    console.result = {'route': route.number, 'share': route.share, 'length': route.length,
                      'slot': slot}
    return cli.Exit.HOLDS


main = cli.command(parser, _work)
