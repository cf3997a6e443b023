"""``ambush_terrain``: a risk map for map_server from an elevation model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import exit_code

EPILOG = """\
DEM is a GeoTIFF (pip install 'ambush_planner[terrain]'), or an npz file with elevation (H, W) [m],
the northernmost row first, NaN where unknown, and resolution [m] (or dx and dy [m]). --roads takes
the same kinds of file (npz: roads), not 0 where a road leads.

Values: 0..99 risk, 100 too steep, -1 unknown. Risk is the weighted mean of four shares: how deep
the cell lies below the ground within weapon range, from how much of that ground a vehicle is seen,
from how near it is reached unseen, and its slope. The formulas and their sources are in the package
ambush_planner.terrain. The map's origin is its south-west corner.

Beside MAP.yaml it writes MAP.pgm, in map_server's mode raw, and MAP.png, to look at.
Exit code: 0; 1 if anything could not be read or written; 2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the map and return the exit code."""
    options = _parser().parse_args(arguments)

    def run() -> bool:
        from .terrain_run import run_terrain

        return run_terrain(options)

    return exit_code('ambush_terrain', 'figures', run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='ambush_terrain',
        description='Make a risk map from an elevation model.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('elevation', type=Path, metavar='DEM', help='GeoTIFF or npz')
    parser.add_argument(
        '-o', '--output', type=Path, required=True, metavar='MAP.yaml', help='the map to write'
    )
    parser.add_argument('--roads', type=Path, metavar='FILE', help='where roads lead')
    number = {'type': float, 'metavar': 'M'}
    parser.add_argument(
        '--resolution', default=0.0, help="edge of a cell [m] (default: the DEM's)", **number
    )
    parser.add_argument('--weapon-range', default=300.0, help='[m] (default: 300)', **number)
    parser.add_argument('--vehicle-height', default=2.5, help='[m] (default: 2.5)', **number)
    parser.add_argument('--person-height', default=1.7, help='[m] (default: 1.7)', **number)
    parser.add_argument(
        '--slope-limit', type=float, default=0.42, metavar='S',
        help='rise over run that is not driven over (default: 0.42)',
    )
    parser.add_argument(
        '--road-factor', type=float, default=0.5, metavar='F',
        help='risk on roads over that beside them (default: 0.5)',
    )
    parser.add_argument(
        '--weights', type=float, nargs=4, default=(0.4, 0.2, 0.2, 0.2),
        metavar=('DEPTH', 'EXPOSURE', 'APPROACH', 'SLOPE'),
        help='of the four shares (default: 0.4 0.2 0.2 0.2)',
    )
    return parser


if __name__ == '__main__':
    sys.exit(main())
