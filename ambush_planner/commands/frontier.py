"""``ambush_frontier``: what a longer way, or a little more risk, buys."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import count
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..errors import InvalidOption, InvalidRiskMap
from ..maps.map_file import read_map
from ..maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..network.construction import build_network
from ..planning.frontier import DETOURS, SLACKS, FrontierRow, frontier
from . import cli
from .frontier_figure import frontier_figure, over
from .table_file import private
from .table_options import options_from

COLUMNS = tuple(field.name for field in fields(FrontierRow))
EPILOG = """\
MAP is a YAML file that map_server reads (ambush_terrain makes such maps), or an npz file with alpha
and obstacles (H, W), row 0 the lowest, resolution [m] and, if it is not 0, origin (x, y, yaw).
A strategy is solved for each detour, with the slack as set, and for each slack, with the detour as
set. The table has a row for each: value and lower_bound, expected_length [m], expected_exposure
[loss x m], route_entropy [nats], and error where there is no strategy. Beside TABLE.csv it writes
TABLE.png, to choose by looking. Options have the names of the node's parameters (map., network.,
game., strategy.), and the defaults of the Python functions.
A row without a strategy is a finding.
--json: {"verdict", "table", "rows": [{...}]}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'frontier', 'Value, length, exposure and entropy over the budgets.', EPILOG
    )
    made.add_argument('map', type=Path, metavar='MAP', help='the risk map, yaml or npz')
    place = {'type': float, 'nargs': 2, 'required': True, 'metavar': ('X', 'Y')}
    made.add_argument('--start', help='world position [m]', **place)
    made.add_argument('--goal', help='world position [m]', **place)
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='TABLE.csv', help='the table to write'
    )
    made.add_argument(
        '--detours', type=float, nargs='+', metavar='D',
        help='expected lengths over the shortest (default: 1.02 to 1.5)',
    )
    made.add_argument(
        '--slacks', type=float, nargs='+', metavar='E',
        help='shares of the value given up for unpredictability (default: 0 to 0.3)',
    )
    made.add_argument(
        '--set', nargs='+', default=[], metavar='NAME=VALUE',
        help='options, such as network.spacing=50 game.ambush_radius=100',
    )
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> int:
    """Write the table and its picture; a row without a strategy is a finding."""
    options = options_from(arguments.set)
    picture = arguments.output.with_suffix('.png')
    if picture == arguments.output:
        raise InvalidOption(f'{arguments.output}: the picture has this name; choose TABLE.csv')
    risk_map = read_risk_map(arguments.map, options.map)
    network = build_network(
        risk_map, tuple(arguments.start), tuple(arguments.goal), options.network
    )
    detours, slacks = arguments.detours or DETOURS, arguments.slacks or SLACKS
    bar, solved = console.bar('budgets solved'), count(1)
    rows = frontier(
        network, options.game, detours, slacks, options.strategy,
        lambda row: bar(next(solved) / (len(detours) + len(slacks))),
    )
    write_frontier(arguments.output, rows, options.strategy.max_detour, options.strategy.risk_slack)
    failed = any(row.error for row in rows)
    console.line(table_text(rows))
    console.line(
        f'\n{cli.place(arguments.output)}, {picture.name}: {len(network.points)} nodes'
    )
    console.result = {
        'table': cli.place(arguments.output), 'rows': [asdict(row) for row in rows],
    }
    return cli.Exit.FINDING if failed else cli.Exit.HOLDS


def read_risk_map(path: Path, options: OccupancyOptions) -> RiskMap:
    """Read a map of map_server's, or the fields of a ``RiskMap`` from an npz file.

    Raises
    ------
    InvalidTerrain, InvalidRiskMap
        It is not such a map; what is wrong is named.
    OSError
        It cannot be opened.
    """
    if path.suffix != '.npz':
        read = read_map(path)
        return risk_map_from_occupancy(read.values, read.resolution, read.origin, options)
    try:
        with np.load(path) as file:
            content = {name: file[name] for name in file.files}
        origin = tuple(float(value) for value in content.get('origin', (0.0, 0.0, 0.0)))
        return RiskMap(
            content['alpha'], content['obstacles'], float(content['resolution']), origin
        )
    except KeyError as error:
        raise InvalidRiskMap(f'{path}: no {error}; it has {", ".join(content)}') from error
    except (BadZipFile, EOFError, TypeError, ValueError) as error:
        raise InvalidRiskMap(f'{path}: {error}') from error


def write_frontier(
    path: Path, rows: Sequence[FrontierRow], max_detour: float, risk_slack: float
) -> None:
    """Write the table (CSV), and beside it the picture (.png), mode 0600."""
    with open(path, 'w', encoding='utf-8', newline='', opener=private) as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator='\n')
        writer.writeheader()
        for row in rows:
            writer.writerow({
                name: f'{value:.9g}' if isinstance(value, float) else value
                for name, value in asdict(row).items()
            })
    with open(path.with_suffix('.png'), 'wb', opener=private) as stream:
        frontier_figure(rows, max_detour, risk_slack).savefig(stream, format='png')


def table_text(rows: Sequence[FrontierRow]) -> str:
    """The rows to read on a terminal; lengths and exposure over the least there is."""
    head = ('max_detour', 'risk_slack', 'value', 'gap', 'length', 'exposure', 'route entropy')
    lines = [head]
    for row in rows:
        gap = (row.value - row.lower_bound) / row.value if row.value > 0.0 else 0.0
        numbers = (
            f'{row.value:.4g}', f'{gap:.1e}',
            f'{row.expected_length / row.shortest_length:.3f}',
            f'{over(row.expected_exposure, row.least_exposure):.3f}', f'{row.route_entropy:.2f}',
        )
        budgets = f'{row.max_detour:g}', f'{row.risk_slack:g}'
        lines.append((*budgets, *((row.error,) if row.error else numbers)))
    return '\n'.join(
        ''.join(f'{cell:>14}' for cell in line) if len(line) == len(head)
        else ''.join(f'{cell:>14}' for cell in line[:2]) + f'  {line[2]}'
        for line in lines
    )


main = cli.command(parser, _work)
