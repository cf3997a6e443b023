# SPDX-License-Identifier: Apache-2.0
"""``ambush table``: value and length of the strategies for all pairs of depots and customers."""

from __future__ import annotations

import argparse
import csv
import math
import multiprocessing
import os
import signal
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import count, product
from pathlib import Path

from ..errors import AmbushPlannerError
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..planning.many import Problem, solve_many
from . import cli
from .inputs import MAP_HELP, OPTIONS_HELP, Position, add_options, options_from, risk_map_from

NUMBERS = ('value', 'lower_bound', 'expected_length', 'shortest_length', 'route_entropy')
COLUMNS = ('depot', 'customer', *NUMBERS, 'error')
PLACES_HELP = 'name, and x, y (world positions [m]) or lat, lon [degrees]'
EPILOG = f"""\
DEPOTS.csv and CUSTOMERS.csv have the columns {PLACES_HELP}.
{MAP_HELP}
The table has a row for each pair: value, lower_bound, expected_length and shortest_length [m; s on
roads with speeds], route_entropy [nats], and error if there is no strategy, which is a finding.
{OPTIONS_HELP}
--json: {{"verdict", "table", "pairs", "failed", "seconds"}}
""" + cli.EXIT_CODES


class InvalidPlaces(AmbushPlannerError, ValueError):
    """A file of places cannot be used."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'table', 'Compute value, length and entropy for all pairs of places.', EPILOG
    )
    made.add_argument('depots', type=Path, metavar='DEPOTS.csv', help='where trips begin')
    made.add_argument('customers', type=Path, metavar='CUSTOMERS.csv', help='where trips end')
    made.add_argument('--map', type=Path, required=True, metavar='MAP', help='the risk map')
    cli.add_table(made)
    add_options(made)
    made.add_argument('--jobs', type=cli.number(1, 1e3, int), default=len(os.sched_getaffinity(0)),
                      metavar='N', help='processes (default: one for each processor)')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    options = options_from(arguments)
    files = [read_places(path) for path in (arguments.depots, arguments.customers)]
    risk_map = risk_map_from(arguments.map, options.map, console)
    pairs = list(product(*(in_metres(places, risk_map).items() for places in files)))
    problems = [Problem(risk_map, start, goal, options.planning)
                for (_, start), (_, goal) in pairs]
    show, solved = console.bar('pairs solved'), count(1)
    # On Ctrl-C, this process cancels the other pairs and waits for those that are being solved.
    with ProcessPoolExecutor(
        arguments.jobs, multiprocessing.get_context('spawn'), signal.signal,
        (signal.SIGINT, signal.SIG_IGN),
    ) as pool:
        results = solve_many(problems, pool, answer=_numbers, in_flight=2 * arguments.jobs,
                             on_result=lambda _: show(next(solved) / len(pairs)))
    rows = []
    for ((depot, _), (customer, _)), result in zip(pairs, results, strict=True):
        error = {'error': f'{type(result.error).__name__}: {result.error}'} if result.error else {}
        rows.append({'depot': depot, 'customer': customer, **(result.answer or error)})
    output, seconds = arguments.output, round(console.seconds, 1)
    cli.write_private(output.parent, {output.name: cli.as_csv(COLUMNS, rows)})
    failed = sum(result.error is not None for result in results)
    console.line(f'{cli.place(output)}: {cli.count(len(pairs), "pair")}, '
                 f'{failed} without a strategy, in {seconds} s')
    console.result = {'table': cli.place(output), 'pairs': len(pairs), 'failed': failed,
                      'seconds': seconds}
    return cli.Exit.FINDING if failed else cli.Exit.HOLDS


def _numbers(strategy: Strategy) -> dict[str, float]:
    return {name: getattr(strategy, name) for name in NUMBERS}


def in_metres(places: Mapping[str, Position], risk_map: RiskMap) -> dict[str, tuple[float, float]]:
    """World positions [m] by name; raises InvalidCoordinates."""
    found = {name: place.xy(risk_map) for name, place in places.items()}
    return {name: (float(x), float(y)) for name, (x, y) in found.items()}


def read_places(path: Path) -> dict[str, Position]:
    """Read names and positions from a CSV file; raises InvalidPlaces, OSError."""
    places: dict[str, Position] = {}
    with path.open(encoding='utf-8-sig', newline='') as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        try:
            in_degrees = 'lat' in (reader.fieldnames or ())
            columns = ('lat', 'lon') if in_degrees else ('x', 'y')
            for row in reader:
                name = row['name'].strip()
                x, y = (float(row[column]) for column in columns)
                if not name or name in places:
                    raise ValueError(f'each place needs its own name, got {name!r}')
                if not (math.isfinite(x) and math.isfinite(y)):
                    raise ValueError(f'{" and ".join(columns)} must be finite, got {x} and {y}')
                places[name] = Position((x, y), in_degrees)
        except KeyError as error:
            raise InvalidPlaces(f'{path}: no column {error}') from error
        except (ValueError, TypeError, AttributeError, csv.Error) as error:
            raise InvalidPlaces(f'{path}, line {reader.line_num}: {error}') from error
    if not places:
        raise InvalidPlaces(f'{path}: no places')
    return places


main = cli.command(parser, _work)
