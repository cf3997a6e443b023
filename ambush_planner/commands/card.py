# SPDX-License-Identifier: Apache-2.0
"""``ambush card``: the driver's sheet of one departure."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date
from typing import TYPE_CHECKING

from ..route_files import PLAN
from ..words import distance
from . import cli
from .positions import add_crs, in_named_system

if TYPE_CHECKING:
    from ..recordings.recorded_departure import RecordedDeparture
    from .card_page import Card

EPILOG = """\
FILE is a recorded departure (.mcap), of the node or of ambush draw.
The page is for printing (A4): the map with this route, and its way points with grid references
(MGRS, latitude and longitude, or the map's metres), true bearings (from the map's y axis if
its coordinate system is unknown), distances along the path, times, and what is secured on the way.
It tells nothing of other routes. MGRS needs the package mgrs, which is in the extra gis.
--json: {"verdict", "file", "legs", "length"}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('card', 'Write the map, legs and times of one departure for its driver.',
                          EPILOG)
    made.add_argument('departure', type=cli.existing, metavar='FILE', help='a recording')
    made.add_argument('-o', '--output', type=cli.file_of('.html'), required=True,
                      metavar='CARD.html', help='the page to write')
    add_speed(made)
    made.add_argument('--start-time', type=cli.time_of_day, metavar='HH:MM',
                      help='when the convoy leaves (default: the slot that was drawn, else times '
                      'are minutes from departure)')
    add_crs(made)
    return made


def add_speed(parser: argparse.ArgumentParser) -> None:
    """Add the argument ``--speed``."""
    parser.add_argument('--speed', type=cli.number(0.01, 1000.0), metavar='KM/H',
                        help='mean speed, for the times on the card (default: as the roads allow, '
                        'if the plan has their speeds)')


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    if arguments.departure.suffix.lower() == PLAN:
        file = cli.place(arguments.departure)
        raise cli.UsageError(f'{file} is a plan, not a departure: draw one with ambush draw {file} '
                             f'-o {arguments.output}')
    if arguments.departure.is_dir():
        raise cli.UsageError(f'{cli.place(arguments.departure)} is a folder; a card has one '
                             'departure, so name its recording (.mcap)')

    from ..recordings.durable_files import write_all_durably
    from ..recordings.recorded_departure import read_departure
    from .card_page import card_page

    with console.waiting('drawing the card'):
        card = departure_card(read_departure(arguments.departure), arguments.speed,
                              arguments.start_time)
        card = replace(card, risk_map=in_named_system(card.risk_map, arguments, console))
        file, length = arguments.output, float(card.distances[-1])
        write_all_durably({file: card_page(card, console).encode()})
    legs = len(card.points) - 1
    (name,) = console.secret([file], f'{cli.count(legs, "leg")}, {distance(length)}; ')
    console.result = {'file': name, 'legs': legs, 'length': length}
    return cli.Exit.HOLDS


def departure_card(departure: RecordedDeparture, speed: float | None = None,
                   start: str | None = None) -> Card:
    """The card of a recorded departure."""
    from .card_page import card_of

    said, day = departure.metadata, departure.metadata.day
    slot, zone = (day.slot, day.zone) if day and not start else (start, _zone(start))
    return card_of(departure.path_poses, departure.risk_map, departure.trip,
                   (departure.drawn_from, departure.route),
                   departure.parameters.planning.network.roads, said.trip.names, speed, slot,
                   f'Departure {said.departure}', day.date if day else '', zone)


def _zone(start: str | None) -> str:
    """Return the time zone of this computer today, at a time if it is known."""
    from ..recordings.plan_departures import local_zone

    return local_zone(date.today().isoformat(), start) if start else ''


main = cli.command(parser, _work)
