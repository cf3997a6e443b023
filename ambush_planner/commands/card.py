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
FILE is a recorded departure (.mcap), of the node or of ambush draw, or with --route a plan of few
routes (.plan).
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
    made.add_argument('departure', type=cli.existing, metavar='FILE', help='a recording, or a plan')
    made.add_argument('--route', type=int, metavar='NUMBER', help='the route in a plan of few')
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
    of_plan = arguments.departure.suffix.lower() == PLAN
    if of_plan == (arguments.route is None):
        file = cli.place(arguments.departure)
        raise cli.UsageError(
            f'{file} is a plan, not a departure: draw one with ambush draw {file} -o '
            f'{arguments.output}, or name a route with --route N if it was made with --routes'
            if of_plan else
            f'{file} is a departure, which has one route: leave out --route')
    if arguments.departure.is_dir():
        raise cli.UsageError(f'{cli.place(arguments.departure)} is a folder; a card has one '
                             'departure, so name its recording (.mcap)')

    from ..recordings.durable_files import write_all_durably
    from ..recordings.recorded_departure import read_departure
    from .card_page import card_page

    with console.waiting('drawing the card'):
        card = _chosen(arguments) if of_plan else departure_card(
            read_departure(arguments.departure), arguments.speed, arguments.start_time)
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


def _chosen(arguments: argparse.Namespace) -> Card:
    from ..recordings.plan_file import read_plan
    from .card_page import card_of

    saved = read_plan(arguments.departure)
    plan = saved.plan
    file = cli.place(arguments.departure)
    if plan.few is None:
        raise cli.UsageError(f'{file} is not a plan of few routes: make one with --routes K, or '
                             'draw a departure')
    if not 1 <= arguments.route <= (count := len(plan.few.paths)):
        raise cli.UsageError(f'{file} has routes 1 to {count}, not {arguments.route}')
    k, few = arguments.route - 1, plan.few
    leg = int(few.leg[k])
    trip, (start, goal) = plan.of_leg(leg).trip, saved.names
    return card_of(few.paths[k], plan.own_map, trip, (trip, (few.routes[k],)),
                   plan.options.network.roads,
                   (start * (leg == 0), goal * (leg == len(plan.legs) - 1)), arguments.speed,
                   arguments.start_time, f'Route {arguments.route}',
                   zone=_zone(arguments.start_time))


main = cli.command(parser, _work)
