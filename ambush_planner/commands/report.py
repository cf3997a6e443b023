"""``ambush_report``: recorded departures on one HTML page that any browser shows offline."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from ..recordings import recordings_in
from ..recordings.verify import together
from . import cli
from .audit import read_all
from .report_page import page
from .report_sections import Section, sections_of
from .verify import verify_files

PAGE = 'report.html'
EPILOG = """\
The page, report.html, has the map, the strategy, the routes, how they compare with planners that
leave no choice, and what is promised, in words; a section for a map and a pair of places. The map
can be moved and zoomed, its layers switched, departures picked one by one; it tells what an ambush
at the pointer would cost. The page needs no network, and its one script is its own. It shows
secret routes: it has mode 0600, a new folder 0700. It says "verified" only with --verify, which
checks every departure as ambush_verify does.
--json: {"verdict", "page", "departures", "sections", "unreadable", "verified"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'report', 'Recorded departures on one HTML page, for people without RViz or Foxglove.',
        EPILOG,
    )
    cli.add_output(made, PAGE)
    made.add_argument(
        '--verify', action='store_true', help='verify the recordings, and say what was found'
    )
    return made


@dataclass(frozen=True, eq=False)
class Written:
    """A report: how it went, the trips that are in it, how many files could not be read."""

    code: cli.Exit
    sections: list[Section]
    unreadable: int


def write_report(place: Path, output: Path, verify: bool, console: cli.Console) -> Written:
    """Write the page for the recordings that ``place`` stands for.

    Raises
    ------
    AmbushPlannerError, OSError
        What went wrong, in words for the user.
    """
    departures, unreadable = read_all(place, console)
    for error in unreadable:
        console.error(error)
    if not departures:
        console.error('no recording could be read, so there is no report')
        return Written(cli.Exit.UNREADABLE, [], len(unreadable))
    verdicts, faults = [], []
    if verify:
        verdicts = verify_files(recordings_in(place), console)
        if place.is_dir():
            faults, _ = together(verdicts)
    sections = sections_of(departures)
    html = page(sections, len(unreadable), verdicts, faults)
    cli.write_private(output, {PAGE: html.encode()})
    wrong = bool(faults) or any(each.readable and not each.holds for each in verdicts)
    code = cli.Exit.FINDING if wrong else (
        cli.Exit.UNREADABLE if unreadable else cli.Exit.HOLDS
    )
    return Written(code, sections, len(unreadable))


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    if options.output is None:
        raise cli.UsageError('-o DIR says where the page goes')
    cli.refuse_existing(options.output, [PAGE], options.replace)
    written = write_report(options.recordings, options.output, options.verify, console)
    page_place = cli.place(options.output / PAGE) if written.sections else None
    if page_place:
        console.line(page_place)
        console.line('It shows secret routes; only this user can read it.')
    console.result = {
        'page': page_place,
        'departures': sum(len(each.departures) for each in written.sections),
        'sections': len(written.sections), 'unreadable': written.unreadable,
        'verified': written.code == cli.Exit.HOLDS if options.verify else None,
    }
    return written.code


main = cli.command(parser, _work)
