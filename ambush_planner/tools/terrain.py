"""``ambush_terrain``: a risk map for map_server from an elevation model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from . import cli
from .terrain_run import run_terrain

EPILOG = """\
DEM is a GeoTIFF (pip install 'ambush_planner[terrain]'), or an npz file with elevation (H, W) [m],
the northernmost row first, NaN where unknown, and resolution [m] (or dx and dy [m]). --roads takes
the same kinds of file (npz: roads), not 0 where a road leads.

Values: 0..99 risk, 100 too steep, -1 unknown. Risk is the weighted mean of four shares: how deep
the cell lies below the ground within weapon range, from how much of that ground a vehicle is seen,
from how near it is reached unseen, and its slope. The formulas and their sources are in the package
ambush_planner.terrain. The map's origin is its south-west corner.

Beside MAP.yaml it writes MAP.pgm, in map_server's mode raw, and MAP.png, to look at.
--json: {"verdict", "files"}
""" + cli.EXIT_CODES


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the map and return the exit code."""
    return cli.run(parser(), run_terrain, arguments)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('terrain', 'Make a risk map from an elevation model.', EPILOG)
    made.add_argument('elevation', type=Path, metavar='DEM', help='GeoTIFF or npz')
    made.add_argument(
        '-o', '--output', type=Path, required=True, metavar='MAP.yaml', help='the map to write'
    )
    made.add_argument('--roads', type=Path, metavar='FILE', help='where roads lead')
    number = {'type': float, 'metavar': 'M'}
    made.add_argument(
        '--resolution', default=0.0, help="edge of a cell [m] (default: the DEM's)", **number
    )
    made.add_argument('--weapon-range', default=300.0, help='[m] (default: 300)', **number)
    made.add_argument('--vehicle-height', default=2.5, help='[m] (default: 2.5)', **number)
    made.add_argument('--person-height', default=1.7, help='[m] (default: 1.7)', **number)
    made.add_argument(
        '--slope-limit', type=float, default=0.42, metavar='S',
        help='rise over run that is not driven over (default: 0.42)',
    )
    made.add_argument(
        '--road-factor', type=float, default=0.5, metavar='F',
        help='risk on roads over that beside them (default: 0.5)',
    )
    made.add_argument(
        '--weights', type=float, nargs=4, default=(0.4, 0.2, 0.2, 0.2),
        metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
        help='of the four shares (default: 0.4 0.2 0.2 0.2)',
    )
    return made


if __name__ == '__main__':
    sys.exit(main())
