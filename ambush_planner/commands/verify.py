"""``ambush_verify``: do recorded departures follow from their recorded inputs?"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from ..errors import shown
from ..recordings import recordings_in
from ..recordings.chain import together
from ..recordings.verify import Verdict, Verifier
from . import cli

EPILOG = """\
Each departure is planned again from its recorded map, start, goal and parameters, and its route
drawn again. It holds if network, strategy, value and route are the same (numbers to 1e-9, the
probabilities to 1e-6 where another processor or release of numpy or scipy rounds otherwise), if
path, markers, request, answer and the strategy's numbers in the diagnostics are what follows from
these, if the request came first and the answer last, and if the file is, record by record, what
the recorder writes of that. Of a folder it is also checked that each file states the SHA-256 of
the one before it, so that none is missing, exchanged, moved or inserted; that metadata.yaml says
just what the files hold; and that no two departures were drawn from the same random numbers. The
newest recording's hash is told last: note it elsewhere, or sign it, and give it with --expect the
next time.

The certificate is computed anew from the recorded probabilities alone, whatever time the solve
had: it proves the value, and that no strategy within the budgets has less than the lower bound. It
must close up to risk_slack, or, where time was up, up to strategy.max_gap of the value. Where the
solve took a fifth of max_planning_time or more, that is all: another strategy than the one that
follows with more time is then told, with both entropies, and is not a finding.

What is not found, by somebody who corrects checksums and hashes:
* a recording that was made anew as a whole, from another seed with all that follows, if no later
  one states its hash and it is not expected; the last files, taken away, and the first of all,
  if the recording that they follow is not here; a whole folder, made anew; files of other kinds
* another strategy of less entropy, within strategy.max_gap, where the diagnostics state that its
  solve took long: nothing recorded proves the time that it took
* times: only their order within a departure is checked; stamps of inputs, markers and diagnostics
* map cells whose change alters neither an edge (obstacles) nor the loss of a node (others); the
  height of the map, the covariance of a start that was estimated
* parameters that nothing recorded follows from, as replan.tolerance, queue.size and those of TF;
  max_planning_time; quality of service; versions of software; names of topics that were remapped
* in the diagnostics the state, the node's name, the solve's seconds, the kind of warning, how the
  strategy stands on a newer map, and trouble with a map or a recording, which the answer repeats
* orientation and height of a goal in another frame than the map's; frames that a decompressor
  skips; the last departures of a run that were not recorded at all (earlier ones get a note)

Output: a line a departure, what does not hold below it; progress on standard error.
--json: {"verdict", "departures": [{"file", "sha256", "number", "holds", "value", "problems",
"notes"}], "findings", "notes", "newest_sha256"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'verify',
        'Plan recorded departures again and compare: do they follow from their inputs?',
        EPILOG,
    )
    made.add_argument(
        '--expect', type=_hash, metavar='HASH',
        help='the SHA-256 of a recording that was noted elsewhere: it must be among these',
    )
    return made


def verify_files(
    paths: Sequence[Path], console: cli.Console
) -> list[Verdict]:
    """Verify files one after the other, with progress."""
    solves: list[Path] = []
    with Verifier(solves.append) as verifier:
        verdicts = [verifier.verify(path) for path in console.progress(paths, 'verified')]
    console.say(f'planned {cli.count(len(solves), "time")}')
    return verdicts


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    paths = recordings_in(options.recordings)
    console.say(f'verifying {cli.count(len(paths), "recording")}')
    verdicts = verify_files(paths, console)
    folder = None
    for verdict in verdicts:
        if verdict.path.parent != folder:
            folder = verdict.path.parent
            console.line(f'in {cli.place(folder)}:')
        _tell(verdict, console)
    # Of a file alone, nothing says which other ones should be there.
    faults, notes = together(verdicts, options.expect or '') if options.recordings.is_dir() or (
        options.expect) else ([], [])
    notes += _gaps(verdicts) if options.recordings.is_dir() else []
    for fault in faults:
        console.line(console.marked('FAILS', False))
        console.item(fault)
    for note in notes:
        console.item(f'({note})')
    failed = sum(not verdict.holds for verdict in verdicts)
    code = _exit_code(verdicts, faults)
    _conclude(verdicts, faults, failed, console)
    console.result = {
        'departures': [*map(_as_json, verdicts)], 'findings': faults, 'notes': notes,
        'newest_sha256': verdicts[-1].sha256,
    }
    return code


def _exit_code(verdicts: Iterable[Verdict], faults: list[str]) -> cli.Exit:
    failing = [verdict for verdict in verdicts if not verdict.holds]
    if faults or any(verdict.readable for verdict in failing):
        return cli.Exit.FINDING
    return cli.Exit.UNREADABLE if failing else cli.Exit.HOLDS


def _tell(verdict: Verdict, console: cli.Console) -> None:
    mark = console.marked('holds' if verdict.holds else 'FAILS', verdict.holds)
    said = f'departure {verdict.number}' if verdict.readable else ''
    if verdict.nodes:
        said += f', {verdict.nodes} nodes, value {verdict.value:.6g}'
    console.line(f'{mark}  {shown(verdict.path.name)}' + (f': {said}' if said else ''))
    for problem in verdict.problems:
        console.item(problem)
    for note in verdict.notes:
        console.item(f'({note})')


def _conclude(
    verdicts: list[Verdict], faults: list[str], failed: int, console: cli.Console
) -> None:
    departures = cli.count(len(verdicts), 'departure')
    if failed:
        console.line(f'{failed} of {departures}: not consistent')
    else:
        console.line(f'{departures}: {"each holds, but not together" if faults else "all hold"}')
    if verdicts[-1].sha256:
        console.line(f'SHA-256 of the newest: {verdicts[-1].sha256}')


def _as_json(verdict: Verdict) -> dict[str, Any]:
    return {
        'file': cli.place(verdict.path),
        'sha256': verdict.sha256,
        'number': verdict.number,
        'holds': verdict.holds,
        'value': verdict.value if math.isfinite(verdict.value) else None,
        'problems': verdict.problems,
        'notes': verdict.notes,
    }


def _gaps(verdicts: Iterable[Verdict]) -> list[str]:
    """Which departures of a run of the node were not recorded, a line for each such place."""
    read = [(each, each.metadata) for each in verdicts if each.metadata]
    known = {each.sha256: (each.path.parent, each.number) for each, _ in read}
    numbers: dict[Path, set[int]] = {}
    for each, metadata in read:
        folder = each.path.parent
        found = numbers.setdefault(folder, {0})  # before the first
        found.add(each.number)
        before, number = known.get(metadata.link.sha256, (folder, 0))
        if before != folder and number == each.number - 1:
            # That folder was full, and the run went on in this one.
            found.discard(0)
            found.add(number)
    return [
        f'{cli.place(folder)}: no recording of departures '
        + (f'after {before} and before {after}; ' if before else f'before {after}; ')
        + 'recording was off, it failed, or the files are missing'
        for folder, found in numbers.items()
        for before, after in pairwise(sorted(found)) if after > before + 1
    ]


def _hash(text: str) -> str:
    if not re.fullmatch(r'[0-9a-fA-F]{64}', text):
        raise argparse.ArgumentTypeError('must be a SHA-256, 64 hexadecimal digits')
    return text.lower()


main = cli.command(parser, _work)
