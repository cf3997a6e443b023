# SPDX-License-Identifier: Apache-2.0
"""``ambush frontier``: what a longer detour, or a little more risk, buys."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from . import cli
from .planner_parser import planner_parser
from .positions import read_ground

if TYPE_CHECKING:
    from ..operations.frontier import FrontierRow

EPILOG = """\
TABLE.csv has value, length, exposure and entropy for each budget, as the console does.
"""
DETAILS = """\
Solves a strategy for each of --detours, all with --slack, and for each of --slacks, all with
--detour.
Columns of the table are value and lower_bound, expected_length [m; s on roads with speeds],
expected_exposure [loss x m], route_entropy [nats], and error if there is no strategy, which is a
finding.
--json: {"verdict", "file", "rows": [{...}]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser(
        'frontier', 'Compare length budgets and slacks: value, length, exposure, entropy.',
        EPILOG, DETAILS, '--start POSITION --goal POSITION [options] -o TABLE.csv',
        ('--detours', '--slacks'), stops=False)
    made.add_argument('-o', '--output', type=cli.file_of('.csv'), required=True,
                      metavar='TABLE.csv', help='the table to write')
    made.add_argument('--detours', type=float, nargs='+', metavar='D',
                      help="length budgets, as multiples of the shortest route's length "
                      '(default: 1.02 to 1.5)')
    made.add_argument('--slacks', type=float, nargs='+', metavar='E', help='shares '
                      'of the value to give up for less predictable routes (default: 0 to 0.3)')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from .inputs import options_from

    of_map, planning = options_from(arguments)
    risk_map, (x, y), (to_x, to_y), _ = read_ground(arguments, of_map)

    from ..operations.frontier import DETOURS, SLACKS, trip_frontier

    detours, slacks = arguments.detours or DETOURS, arguments.slacks or SLACKS
    solved, budgets = count(1), len(detours) + len(slacks)
    with console.waiting('solving') as tell:
        rows = trip_frontier(risk_map, (x, y), (to_x, to_y), planning, detours, slacks,
                             lambda _: tell(f'{next(solved)} of {budgets} budgets'))
    write_frontier(arguments.output, rows)
    console.line(_as_text(rows))
    file = cli.place(arguments.output)
    console.line(f'\n{file}')
    console.result = {'file': file, 'rows': [asdict(row) for row in rows]}
    return cli.Exit.FINDING if any(row.error for row in rows) else cli.Exit.HOLDS


def write_frontier(path: Path, rows: Sequence[FrontierRow]) -> None:
    """Write a table with mode 0600: numbers of nine digits, and nothing where a row has none."""
    from ..operations.frontier import FrontierRow
    from ..recordings.durable_files import write_all_durably

    text = io.StringIO()
    writer = csv.DictWriter(text, [each.name for each in fields(FrontierRow)], lineterminator='\n')
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f'{value:.9g}' if isinstance(value, float) else value
                         for name, value in asdict(row).items()})
    write_all_durably({path: text.getvalue().encode()})


def _as_text(rows: Sequence[FrontierRow]) -> str:
    """Return a table for a terminal, with the length relative to the shortest."""
    head = ('detour', 'slack', 'value', 'gap', 'length', 'exposure', 'route entropy')
    lines = [''.join(f'{name:>14}' for name in head)]
    for row in rows:
        gap = (row.value - row.lower_bound) / row.value if row.value > 0.0 else 0.0
        numbers = f'  {row.error}' if row.error else (
            f'{row.value:14.4g}{gap:14.1e}{row.expected_length / row.shortest_length:14.3f}'
            f'{row.expected_exposure:14.4g}{row.route_entropy:14.2f}'
        )
        lines.append(f'{row.max_detour:14g}{row.risk_slack:14g}{numbers}')
    return '\n'.join(lines)


main = cli.command(parser, _work)
