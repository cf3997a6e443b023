# SPDX-License-Identifier: Apache-2.0
"""Arguments of commands that plan; ``inputs`` reads the options from them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .cli import WORDS, existing, new_parser
from .positions import add_crs, add_places, as_typed_places

# Options of all commands that plan which their short help shows.
COMMON = ('-o', '--start', '--goal', '--via', '--roads', '--reach', '--held', '--detour', '--slack',
          '--crs', '--set')
HELP = """\
MAP is a map of map_server (.yaml), a GeoTIFF, or an npz file; ambush risk makes one.
A POSITION is X Y in its metres, LAT,LON in decimal degrees, or an MGRS reference.
"""
DETAILS = """
A GeoTIFF has the values of map_server, -1..100; an npz file has alpha and obstacles (H, W), row 0
the lowest, resolution [m] and, if they are known, origin (x, y, yaw) and crs, the coordinate
system. LAT and LON are negative in the south and west.
The options of --set are named like the node's parameters (map., network., game., strategy.,
route.), which docs/ros_interface.md explains, and have the defaults of the Python functions, except
that strategy.time_limit is 60 s.
"""


def planner_parser(command: str, description: str, epilog: str, details: str, usage: str,
                   common: Sequence[str] = (), stops: bool = True,
                   hidden: str = '') -> argparse.ArgumentParser:
    """Return the parser of a command that plans: with a map, places, options, ``--crs``.

    ``epilog``, ``details`` and ``usage`` are as in ``new_parser``; ``common`` are the command's own
    options in its short help. Help omits the option ``hidden``.
    """
    parser = new_parser(command, description, HELP + epilog, (*COMMON, *common), DETAILS + details,
                        f'ambush {command} MAP {usage}')
    parser.add_argument('map', type=existing, metavar='MAP', help='the risk map')
    add_places(parser, stops)
    _add_options(parser, hidden)
    add_crs(parser)
    parser.set_defaults(wording=_wording)
    return parser


def _wording(arguments: argparse.Namespace, text: str) -> str:
    """A message that names options and places as they are typed."""
    from .inputs import as_typed

    return as_typed(as_typed_places(arguments, text))


def source_names(arguments: argparse.Namespace) -> list[str]:
    """The names of the files that the arguments name: map, roads, tracks and candidates."""
    named = [str(arguments.map), arguments.roads, *getattr(arguments, 'tracks', ()),
             getattr(arguments, 'candidates', None)]
    return [Path(each).name for each in named if each]


def _add_options(parser: argparse.ArgumentParser, hidden: str) -> None:
    """Add ``--roads``, the arguments of ``WORDS`` and ``--set``, for ``options_from``.

    Help omits the option ``hidden``.
    """
    parser.add_argument('--roads', metavar='FILE', help='drive only on the roads of this file')
    for word, (_, unit, text) in WORDS.items():
        parser.add_argument(f'--{word}', metavar=unit,
                            help=argparse.SUPPRESS if word == hidden else text)
    parser.add_argument('--node-crossings', action='store_true', help='roads also meet where they '
                        'cross or touch without a shared vertex')
    parser.add_argument('--road-column', metavar='COLUMN=VALUES', help='column that says which '
                        'lines are roads, and its values for roads: class=road,track')
    parser.add_argument('--all-lines-are-roads', action='store_true', help='no column says which')
    parser.add_argument('--two-way', action='store_true', help='no road is one-way, whatever a '
                        'column that is not known may say')
    parser.add_argument('--set', nargs='+', action='extend', default=[], metavar='NAME=VALUE',
                        help='other options: network.spacing=50 strategy.time_limit=300')
