"""``ambush_frontier``: what a longer way, or a little more risk, buys."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from . import cli
from .frontier_run import run_frontier

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Write table and picture and return the exit code."""
    return cli.run(parser(), run_frontier, arguments)


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


if __name__ == '__main__':
    sys.exit(main())
