"""``ambush card``: the driver's sheet of one departure."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from ..recordings import read_departure
from . import cli
from .card_page import Card, card_page
from .inputs import add_crs, crs_text
from .report_words import distance

EPILOG = """\
The page is for printing (A4). It has the map with this route, and a table of its way points: grid
references (MGRS, UTM, latitude and longitude; metres of the map if its coordinate system is
unknown), bearing of each leg, distances along the path and times, and where the path is on held
ground. Nothing on it tells of other routes. MGRS needs the package mgrs, which is in the extra gis.
Bearings are from true north, on a map without a coordinate system from its y axis. The coordinate
system is the node's parameter map.crs, unless --crs or --datum names another one.
--json: {"verdict", "file", "legs", "length"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('card', 'Write the map, legs and times of one departure for its driver.',
                          EPILOG)
    made.add_argument('departure', type=Path, metavar='FILE', help='the recording of a departure')
    made.add_argument('-o', '--output', type=_page, required=True, metavar='CARD.html',
                      help='the page to write')
    made.add_argument('--speed', type=cli.number(0.01, 1000.0), required=True, metavar='KM/H',
                      help='mean speed')
    made.add_argument('--start-time', type=_time, metavar='HH:MM',
                      help='when the convoy leaves (default: times are minutes from departure)')
    add_crs(made)
    return made


def _page(text: str) -> Path:
    if Path(text).suffix != '.html':
        raise argparse.ArgumentTypeError(f'{text}: its suffix must be .html')
    return Path(text)


def _time(text: str) -> datetime:
    try:
        return datetime.strptime(text, '%H:%M')
    except ValueError:
        raise argparse.ArgumentTypeError(f'must be HH:MM, got {text!r}') from None


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    card = _recorded(arguments)
    cli.write_private(arguments.output.parent,
                      {arguments.output.name: card_page(card, console).encode()})
    file, legs = cli.place(arguments.output), len(card.legs.distances) - 1
    length = float(card.legs.distances[-1])
    console.line(f'{file}: {cli.count(legs, "leg")}, {distance(length)}; secret, so only this user '
                 'can read it.')
    console.result = {'file': file, 'legs': legs, 'length': length}
    return cli.Exit.HOLDS


def _recorded(arguments: argparse.Namespace) -> Card:
    if arguments.departure.is_dir():
        raise cli.UsageError(f'{cli.place(arguments.departure)} is a folder; a card has one '
                             'departure, so name its recording (.mcap)')
    departure = read_departure(arguments.departure)
    network = departure.strategy.network
    risk_map = replace(departure.risk_map, crs=crs_text(arguments) or departure.risk_map.crs)
    places = network.points[[network.source, *network.stops, network.target]]
    return Card(np.asarray(departure.path_poses[:, :2]), risk_map, places,
                departure.strategy.game.options.held_radius, arguments.speed / 3.6,
                arguments.start_time)


main = cli.command(parser, _work)
