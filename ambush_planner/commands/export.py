# SPDX-License-Identifier: Apache-2.0
"""``ambush export``: recorded departures for GIS programs, phones and GPS receivers."""

from __future__ import annotations

import argparse
from datetime import datetime, timezone

from . import cli, readers
from .card import departure_card
from .geo_files import FORMATS_HELP, add_outputs, check_outputs, tell_outputs
from .positions import add_crs, in_named_system

EPILOG = f"""\
Routes are the recorded paths, numbered in order of time; strategy, map and ground are those of the
last departure. The column slot has the day and time that departures from a plan file are for. The
coordinate system is the node's parameter map.crs, unless --crs names another one.
{FORMATS_HELP}
--json: {{"verdict", "files", "departures", "unreadable"}}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'export', 'Write recorded routes to files for a GPS or a GIS.', EPILOG)
    add_outputs(made)
    add_crs(made)
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..route_files import Drawn, write_routes
    from .report_words import leaving

    check_outputs(options.output, console)
    departures, unreadable, _ = readers.read_all(options.recordings, console)
    for error in unreadable:
        console.error(error)
    if not departures:
        console.error('no recording could be read, so nothing was exported')
        return cli.Exit.UNREADABLE
    last = departures[-1]
    risk_map = in_named_system(last.newest_risk_map, options, console)
    times = [datetime.fromtimestamp(each.stamp_ns // 10**9, timezone.utc) for each in departures]
    slots = [leaving(each) for each in departures] if any(
        each.metadata.day for each in departures) else ()
    drawn = Drawn(last.departed_on, risk_map, [each.path_poses for each in departures], times,
                  slots=slots, covered=last.covered,
                  way_points=[departure_card(each).way_points for each in departures],
                  sources=[options.recordings.name])
    write_routes(options.output, drawn)
    tell_outputs(options.output, drawn, console)
    console.result['unreadable'] = len(unreadable)
    return cli.Exit.UNREADABLE if unreadable else cli.Exit.HOLDS


main = cli.command(parser, _work)
