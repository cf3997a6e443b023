"""``ambush_frontier``: what a longer way, or a little more risk, buys."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import exit_code

EPILOG = """\
MAP is a YAML file that map_server reads (ambush_terrain makes such maps), or an npz file with alpha
and obstacles (H, W), row 0 the lowest, resolution [m] and, if it is not 0, origin (x, y, yaw).
A strategy is solved for each detour, with the slack as set, and for each slack, with the detour as
set. The table has a row for each: value and lower_bound, expected_length [m], expected_exposure
[loss x m], route_entropy [nats], and error where there is no strategy. Beside TABLE.csv it writes
TABLE.png, to choose by looking. Options have the names of the node's parameters (map., network.,
game., strategy.), and the defaults of the Python functions.
Exit code: 0; 1 if a row has no strategy, or anything could not be read or written; 2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write table and picture and return the exit code."""
    options = _parser().parse_args(arguments)

    def run() -> bool:
        from .frontier_run import run_frontier

        return run_frontier(options)

    return exit_code('ambush_frontier', 'figures', run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='ambush_frontier',
        description='Value, length, exposure and entropy over the budgets.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('map', type=Path, metavar='MAP', help='the risk map, yaml or npz')
    place = {'type': float, 'nargs': 2, 'required': True, 'metavar': ('X', 'Y')}
    parser.add_argument('--start', help='world position [m]', **place)
    parser.add_argument('--goal', help='world position [m]', **place)
    parser.add_argument(
        '-o', '--output', type=Path, required=True, metavar='TABLE.csv', help='the table to write'
    )
    parser.add_argument(
        '--detours', type=float, nargs='+', metavar='D',
        help='expected lengths over the shortest (default: 1.02 to 1.5)',
    )
    parser.add_argument(
        '--slacks', type=float, nargs='+', metavar='E',
        help='shares of the value given up for unpredictability (default: 0 to 0.3)',
    )
    parser.add_argument(
        '--set', nargs='+', default=[], metavar='NAME=VALUE',
        help='options, such as network.spacing=50 game.ambush_radius=100',
    )
    return parser


if __name__ == '__main__':
    sys.exit(main())
