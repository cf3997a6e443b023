"""``ambush_verify``: do recorded departures follow from what is recorded with them?"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ..errors import shown
from ..recordings import recordings_in
from ..recordings.verify import Verdict, Verifier, together
from . import cli

EPILOG = """\
For each departure the file's checksums are checked, the network is built again from the recorded
map and parameters, the certificate is computed from the recorded probabilities alone (it proves
the value, and that no strategy within the budgets has less than the lower bound), and route and
path are drawn again from the recorded entropy. Across a folder, random sources that repeat or are
too short are found. --replan also solves every game again, from cold, and compares the values.

Not checked: markers, diagnostics, request and answer, times, and the poses of start and goal.
Somebody who edits files can make a departure anew with all that follows; docs/recordings.md shows
how to sign a folder.

Output: one line per departure with its problems below it; progress on standard error.
--json: {"verdict", "departures": [{"file", "number", "holds", "value", "problems", "notes"}],
"findings", "notes"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'verify', 'Check that recorded departures follow from what is recorded with them.', EPILOG,
    )
    made.add_argument(
        '--replan', action='store_true', help='solve each game again and compare the values'
    )
    return made


def verify_files(
    paths: Sequence[Path], console: cli.Console, replan: bool = False
) -> list[Verdict]:
    """Verify files one after the other, with progress."""
    verifier = Verifier(replan)
    return [verifier.verify(path) for path in console.progress(paths, 'verified')]


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    paths = recordings_in(options.recordings)
    console.say(f'verifying {cli.count(len(paths), "recording")}')
    verdicts = verify_files(paths, console, options.replan)
    folder = None
    for verdict in verdicts:
        if verdict.path.parent != folder:
            folder = verdict.path.parent
            console.line(f'in {cli.place(folder)}:')
        _print(verdict, console)
    findings, notes = together(verdicts)
    for finding in findings:
        console.line(console.marked('FAILS', False))
        console.item(finding)
    for note in notes:
        console.item(f'({note})')
    failed = sum(not verdict.holds for verdict in verdicts)
    departures = cli.count(len(verdicts), 'departure')
    if failed:
        console.line(f'{failed} of {departures}: not consistent')
    else:
        console.line(f'{departures}: {"each holds, but not together" if findings else "all hold"}')
    console.result = {
        'departures': [*map(_as_json, verdicts)], 'findings': findings, 'notes': notes,
    }
    return _exit_code(verdicts, findings)


def _exit_code(verdicts: Iterable[Verdict], findings: list[str]) -> cli.Exit:
    failing = [verdict for verdict in verdicts if not verdict.holds]
    if findings or any(verdict.readable for verdict in failing):
        return cli.Exit.FINDING
    return cli.Exit.UNREADABLE if failing else cli.Exit.HOLDS


def _print(verdict: Verdict, console: cli.Console) -> None:
    mark = console.marked('holds' if verdict.holds else 'FAILS', verdict.holds)
    line = f'{mark}  {shown(verdict.path.name)}'
    if verdict.id:
        line += (f': departure {verdict.number}, {verdict.nodes} nodes, '
                 f'value {verdict.value:.6g}')
    console.line(line)
    for problem in verdict.problems:
        console.item(problem)
    for note in verdict.notes:
        console.item(f'({note})')


def _as_json(verdict: Verdict) -> dict[str, Any]:
    return {
        'file': cli.place(verdict.path),
        'number': verdict.number,
        'holds': verdict.holds,
        'value': verdict.value if math.isfinite(verdict.value) else None,
        'problems': verdict.problems,
        'notes': verdict.notes,
    }


main = cli.command(parser, _work)
