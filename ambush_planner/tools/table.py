"""``ambush_table``: what it costs to drive between all depots and all customers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from . import cli
from .table_run import run_table

EPILOG = """\
DEPOTS and CUSTOMERS are CSV files with the columns name, x, y (world positions [m]). The map is one
that map_server reads; ambush_terrain makes such maps. The table has a row for each pair: value,
lower_bound, expected_length and shortest_length [m], route_entropy [nats], and error where there is
no strategy. Options have the names of the node's parameters (map., network., game.,
strategy.), and the defaults of the Python functions.

Pairs are solved by processes on this machine, or by the workers of a dask.distributed cluster
(pip install 'ambush_planner[dask]' here, ambush_planner there). Rows are kept in TABLE.csv.part as
they come: after an interruption the same command goes on from there. Rows whose map, positions
and options are the same are not solved again, rows with an error are.
A pair without a strategy is a finding.
--json: {"verdict", "table", "pairs", "solved", "failed", "seconds"}
""" + cli.EXIT_CODES


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table and return the exit code."""
    return cli.run(parser(), run_table, arguments)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'table', 'Value, length and entropy of the strategies for all pairs of places.', EPILOG
    )
    made.add_argument('depots', type=Path, metavar='DEPOTS.csv', help='where trips begin')
    made.add_argument('customers', type=Path, metavar='CUSTOMERS.csv', help='where they end')
    made.add_argument('--map', type=Path, required=True, metavar='MAP.yaml', help='the risk map')
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='TABLE.csv', help='the table to write'
    )
    made.add_argument(
        '--set', nargs='+', default=[], metavar='NAME=VALUE',
        help='options, such as network.spacing=50 strategy.max_detour=1.3',
    )
    where = made.add_mutually_exclusive_group()
    where.add_argument(
        '--jobs', type=cli.positive, metavar='N', help='processes (default: one for each processor)'
    )
    where.add_argument(
        '--scheduler', metavar='ADDRESS', help='of a dask cluster, such as tcp://host:8786'
    )
    return made


if __name__ == '__main__':
    sys.exit(main())
