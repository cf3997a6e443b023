"""``ambush_frontier``: what a longer detour, or a little more risk, buys."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import count
from pathlib import Path

from ..errors import InvalidOption
from ..network.construction import build_network
from ..planning.frontier import DETOURS, SLACKS, FrontierRow, frontier
from . import cli
from .frontier_figure import frontier_figure, relative_exposure
from .inputs import MAP_HELP, OPTIONS_HELP, add_set, options_from, read_risk_map

COLUMNS = tuple(field.name for field in fields(FrontierRow))
EPILOG = f"""\
{MAP_HELP}
A strategy is solved for each detour with the given slack, and for each slack with the given detour.
The table has a row for each: value and lower_bound, expected_length [m], expected_exposure
[loss x m], route_entropy [nats], and error if there is no strategy, which is a finding. TABLE.png
shows the same as curves.
{OPTIONS_HELP}
--json: {{"verdict", "table", "rows": [{{...}}]}}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'frontier', 'Value, length, exposure and entropy over the budgets.', EPILOG
    )
    made.add_argument('map', type=Path, metavar='MAP', help='the risk map, yaml or npz')
    for end in ('--start', '--goal'):
        made.add_argument(end, type=float, nargs=2, required=True, metavar=('X', 'Y'),
                          help='world position [m]')
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='TABLE.csv', help='the table to write'
    )
    made.add_argument(
        '--detours', type=float, nargs='+', metavar='D', default=DETOURS,
        help='expected lengths over the shortest (default: 1.02 to 1.5)',
    )
    made.add_argument(
        '--slacks', type=float, nargs='+', metavar='E', default=SLACKS,
        help='shares of the value given up for unpredictability (default: 0 to 0.3)',
    )
    add_set(made)
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options = options_from(arguments.set)
    if arguments.output.suffix == '.png':
        raise InvalidOption(f'{arguments.output}: the picture has this name; choose TABLE.csv')
    risk_map = read_risk_map(arguments.map, options.map)
    network = build_network(
        risk_map, tuple(arguments.start), tuple(arguments.goal), options.network
    )
    detours, slacks = arguments.detours, arguments.slacks
    show, solved = console.bar('budgets solved'), count(1)
    rows = frontier(
        network, options.game, detours, slacks, options.strategy,
        lambda _: show(next(solved) / (len(detours) + len(slacks))),
    )
    write_frontier(arguments.output, rows, options.strategy.max_detour, options.strategy.risk_slack)
    console.line(_as_text(rows))
    console.line(f'\n{cli.place(arguments.output)}, {arguments.output.with_suffix(".png").name}: '
                 f'{len(network.points)} nodes')
    console.result = {
        'table': cli.place(arguments.output), 'rows': [asdict(row) for row in rows],
    }
    return cli.Exit.FINDING if any(row.error for row in rows) else cli.Exit.HOLDS


def write_frontier(
    path: Path, rows: Sequence[FrontierRow], max_detour: float, risk_slack: float
) -> None:
    """Write the table (CSV) and the picture (.png) next to it, both with mode 0600."""
    text, png = io.StringIO(), io.BytesIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator='\n')
    writer.writeheader()
    for row in rows:
        writer.writerow({
            name: f'{value:.9g}' if isinstance(value, float) else value
            for name, value in asdict(row).items()
        })
    frontier_figure(rows, max_detour, risk_slack).savefig(png, format='png')
    picture = path.with_suffix('.png').name
    cli.write_private(path.parent, {path.name: text.getvalue().encode(), picture: png.getvalue()})


def _as_text(rows: Sequence[FrontierRow]) -> str:
    """Return a table for a terminal, with length and exposure relative to the least."""
    head = ('max_detour', 'risk_slack', 'value', 'gap', 'length', 'exposure', 'route entropy')
    lines = [''.join(f'{name:>14}' for name in head)]
    for row in rows:
        gap = (row.value - row.lower_bound) / row.value if row.value > 0.0 else 0.0
        numbers = f'  {row.error}' if row.error else (
            f'{row.value:14.4g}{gap:14.1e}{row.expected_length / row.shortest_length:14.3f}'
            f'{relative_exposure(row):14.3f}{row.route_entropy:14.2f}'
        )
        lines.append(f'{row.max_detour:14g}{row.risk_slack:14g}{numbers}')
    return '\n'.join(lines)


main = cli.command(parser, _work)
