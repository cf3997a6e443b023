# SPDX-License-Identifier: Apache-2.0
"""``ambush card``: the driver's sheet of one departure."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map_file import read_risk_map
from ..planning.route_sheet import read_route_sheet
from ..recordings import read_departure
from . import cli
from .card_page import Card, card_page
from .console import distance
from .inputs import add_crs, crs_text

EPILOG = """\
FILE is a recorded departure (.mcap), or a file of ambush plan --routes (.json) with --route.
The page is for printing (A4): the map with this route, and its way points with grid references
(MGRS, UTM, latitude and longitude, or the map's metres), true bearings (from the map's y axis if
its coordinate system is unknown), distances along the path, times, and the held ground on the way.
It tells nothing of other routes. MGRS needs the package mgrs, which is in the extra gis.
--json: {"verdict", "file", "legs", "length"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('card', 'Write the map, legs and times of one departure for its driver.',
                          EPILOG)
    made.add_argument('departure', type=Path, metavar='FILE', help='a recording, or few routes')
    made.add_argument('--route', type=int, metavar='NUMBER', help='the route in a .json FILE')
    made.add_argument('-o', '--output', type=cli.file_of('.html'), required=True,
                      metavar='CARD.html', help='the page to write')
    made.add_argument('--speed', type=cli.number(0.01, 1000.0), required=True, metavar='KM/H',
                      help='mean speed')
    made.add_argument('--start-time', type=_time, metavar='HH:MM',
                      help='when the convoy leaves (default: times are minutes from departure)')
    add_crs(made)
    return made


def _time(text: str) -> datetime:
    try:
        return datetime.strptime(text, '%H:%M')
    except ValueError:
        raise argparse.ArgumentTypeError(f'must be HH:MM, got {text!r}') from None


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    of_few = arguments.departure.suffix.lower() == '.json'
    if of_few == (arguments.route is None):
        raise cli.UsageError('--route NUMBER goes with a .json file of few routes, and only there')
    card = _chosen(arguments) if of_few else _recorded(arguments)
    file, length = arguments.output, float(card.distances[-1])
    cli.write_private(file.parent, {file.name: card_page(card, console).encode()})
    console.result = {'file': cli.place(file), 'legs': len(card.points) - 1, 'length': length}
    console.line(f'{cli.place(file)}: {cli.count(len(card.points) - 1, "leg")}, '
                 f'{distance(length)}; secret, so only this user can read it.')
    return cli.Exit.HOLDS


def _recorded(arguments: argparse.Namespace) -> Card:
    if arguments.departure.is_dir():
        raise cli.UsageError(f'{cli.place(arguments.departure)} is a folder; a card has one '
                             'departure, so name its recording (.mcap)')
    departure = read_departure(arguments.departure)
    network = departure.strategy.network
    risk_map = replace(departure.risk_map, crs=crs_text(arguments) or departure.risk_map.crs)
    return Card(departure.path_poses[:, :2], risk_map,
                network.points[[network.source, *network.stops, network.target]],
                departure.strategy.game.options.held_radius, arguments.speed, arguments.start_time)


def _chosen(arguments: argparse.Namespace) -> Card:
    sheet = read_route_sheet(arguments.departure)
    found = [route for route in sheet.routes if route.number == arguments.route]
    if not found:
        raise cli.UsageError(f'{cli.place(arguments.departure)} has routes 1 to '
                             f'{len(sheet.routes)}, not {arguments.route}')
    crs = crs_text(arguments) or sheet.crs
    return Card(found[0].path, read_risk_map(sheet.map, OccupancyOptions(crs=crs)),
                np.array([sheet.start, *sheet.stops, sheet.goal]), sheet.held_radius,
                arguments.speed, arguments.start_time)


main = cli.command(parser, _work)
