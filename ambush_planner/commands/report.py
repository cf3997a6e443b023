# SPDX-License-Identifier: Apache-2.0
"""``ambush report``: recorded departures on one HTML page that any browser shows offline."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from . import cli, readers

if TYPE_CHECKING:
    from ..recordings.report_data import Section

PAGE = 'report.html'
EPILOG = """\
The page, report.html, shows the map, the strategy, the routes, a comparison with planners that
always drive the same route, and what is guaranteed, with one section per map and trip. The list of
departures links their recordings. The page needs neither network nor scripts; for a map to move and
zoom, ambush export writes a GeoPackage for QGIS. It shows secret routes: its mode is 0600, that of
a new folder 0700. With --verify it also says what ambush verify and ambush audit find; the exit
code is 1 if a recording fails verification.
--json: {"verdict", "page", "departures", "sections", "unreadable", "verified",
"struck": {FILE: WHY}}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'report', 'Show recorded departures on one HTML page, for people without RViz or Foxglove.',
        EPILOG,
    )
    made.add_argument('-o', '--output', type=_folder, metavar='DIR', required=True,
                      help=f'folder for {PAGE}; made if missing')
    made.add_argument('--replace', action='store_true', help='overwrite an existing page in DIR')
    made.add_argument('--verify', action='store_true', help='verify and audit the recordings')
    return made


def _folder(text: str) -> Path:
    if Path(text).suffix.lower() == '.html':
        raise argparse.ArgumentTypeError('must be a folder, such as report')
    return Path(text)


def write_report(place: Path, output: Path, verify: bool,
                 console: cli.Console) -> tuple[cli.Exit, list[Section]]:
    """Write the page of the recordings in a file or folder; return the exit code and sections."""
    from ..recordings.durable_files import write_all_durably
    from ..recordings.recorded_departures import recordings_in
    from ..recordings.report_data import sections_of
    from ..recordings.verify import Verifier
    from .audit import audited
    from .report_page import Checks, page

    departures, unreadable, struck = readers.read_all(place, console)
    for error in unreadable:
        console.error(error)
    sections, checks = sections_of(departures), None
    code = cli.Exit.UNREADABLE if unreadable else cli.Exit.HOLDS
    if verify and departures:
        verifier, missing = Verifier(), {error.path for error in unreadable}
        paths = [path for path in recordings_in(place) if path not in missing]
        verdicts = [verifier.verify(path) for path in console.progress(paths, 'verified')]
        problems = {each.path.name: each.problems for each in verdicts if each.problems}
        checks = Checks(len(departures), problems, *audited(departures)[1:])
        code = cli.Exit.FINDING if problems else code
    if departures:
        warnings = [f'Not shown, because unreadable: {cli.count(len(unreadable), "recording")}.'
                    ] * bool(unreadable)
        if struck:
            warnings.append(readers.struck_note(struck, len(departures) + len(struck)))
        text = page(sections, output, warnings, checks)
        write_all_durably({output / PAGE: text.encode()})
        console.secret([output / PAGE])
    else:
        console.error('no recording could be read, so there is no report')
    console.result = {
        'page': cli.place(output / PAGE) if departures else None, 'departures': len(departures),
        'sections': len(sections), 'unreadable': len(unreadable),
        'verified': code == cli.Exit.HOLDS if verify else None,
        'struck': readers.struck_json(struck),
    }
    return code, sections


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    if (page := options.output / PAGE).exists() and not options.replace:
        raise cli.UsageError(f'{cli.place(page)} exists already; add --replace, or choose another '
                             'folder with -o')
    return write_report(options.recordings, options.output, options.verify, console)[0]


main = cli.command(parser, _work)
