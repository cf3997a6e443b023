# SPDX-License-Identifier: Apache-2.0
"""``ambush slots``: what it is worth to vary the time of departure, too."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import InvalidOption
from ..planning.concerns import concerns, is_sound
from ..planning.slots import mix_slots
from . import cli
from .inputs import (
    MAP_HELP,
    OPTIONS_HELP,
    POSITION_HELP,
    add_crs,
    add_options,
    add_places,
    options_from,
    planned,
    risk_map_from,
)

COLUMNS = ('slot', 'share', 'value', 'lower_bound')
EPILOG = f"""\
An ambusher can wait in one slot only. Give one map for all slots, or one for
each, if darkness or traffic change the risk. A slot is drawn with its share, then a route by that
slot's plan. value and lower_bound are those of each slot's plan; the joint ones hold for an ambush
that lasts --window slots in a row.
{MAP_HELP}
{POSITION_HELP}
{OPTIONS_HELP}
--json: {{"verdict", "table", "value", "lower_bound", "slots": [{{...}}]}}
""" + cli.EXIT_CODES
_TIME = re.compile(r'([01]?\d|2[0-3]):[0-5]\d')


def checked_slots(slots: Sequence[str]) -> list[str]:
    """The times as HH:MM; raises InvalidOption if one is none, or they do not go forwards."""
    for text in slots:
        if not _TIME.fullmatch(text):
            raise InvalidOption(f'slots must be times HH:MM, got {text!r}')
    times = [text.zfill(5) for text in slots]
    for before, after in zip(times[:-1], times[1:], strict=True):
        if after <= before:
            raise InvalidOption(f'slots must go forwards in time, but {after} follows {before}')
    return times


def add_slots(parser: argparse.ArgumentParser, required: bool = False) -> None:
    """Add the arguments ``--slots``, for ``checked_slots``, and ``--window``."""
    parser.add_argument('--slots', nargs='+', required=required, default=(), metavar='HH:MM',
                        help='times of departure to draw from')
    parser.add_argument('--window', type=cli.number(1, 1e4, int), default=1, metavar='COUNT',
                        help='number of consecutive slots that an ambush lasts (default: 1)')


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('slots', 'Choose how likely each time of departure is.', EPILOG)
    made.add_argument('maps', type=Path, nargs='+', metavar='MAP',
                      help='the risk map, or one for each slot')
    add_slots(made, required=True)
    made.add_argument('-o', '--output', type=cli.file_of('.csv'), metavar='TABLE.csv',
                      help='the table to write')
    add_places(made)
    add_crs(made)
    add_options(made)
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options, slots = options_from(arguments), checked_slots(arguments.slots)
    if len(arguments.maps) not in (1, len(slots)):
        raise InvalidOption(f'give one map, or one for each of the {len(slots)} slots, got '
                            f'{len(arguments.maps)}')
    plans = []
    for path in arguments.maps:
        risk_map = risk_map_from(path, options.map, console)
        plans.append(planned(arguments, risk_map, options.planning, console))
        for text in concerns(plans[-1]):
            console.say(f'Warning: {path}: {text}.')
    plans *= len(slots) // len(plans)
    joint = mix_slots([plan.value for plan in plans], [plan.lower_bound for plan in plans],
                      arguments.window)
    rows = [dict(zip(COLUMNS, (slot, float(share), plan.value, plan.lower_bound), strict=True))
            for slot, share, plan in zip(slots, joint.shares, plans, strict=True)]
    console.line(f'{"slot":<8}{"share":>8}{"value":>10}')
    for row in rows:
        console.line(f'{row["slot"]:<8}{row["share"]:>8.1%}{row["value"]:>10.4g}')
    console.line(f'joint value {joint.value:.4g}, lower bound {joint.lower_bound:.4g}: mean loss '
                 'per departure if the ambusher knows all but the draws of slot and route')
    console.result = {'value': joint.value, 'lower_bound': joint.lower_bound, 'slots': rows}
    if arguments.output:
        cli.write_private(arguments.output.parent,
                          {arguments.output.name: cli.as_csv(COLUMNS, rows)})
        console.result['table'] = cli.place(arguments.output)
        console.line(console.result['table'])
    return cli.Exit.HOLDS if all(map(is_sound, plans)) else cli.Exit.FINDING


main = cli.command(parser, _work)
