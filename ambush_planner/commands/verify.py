# SPDX-License-Identifier: Apache-2.0
"""``ambush verify``: do recorded departures follow from what is recorded with them?"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..errors import shown
from ..words import rounded
from . import cli, readers
from .console import when

if TYPE_CHECKING:
    from ..recordings.metadata import Metadata
    from ..recordings.verify import Verdict

EPILOG = """\
For each departure, checks the file's checksums, rebuilds the network from the recorded map and
parameters, recomputes the certificate from the recorded probabilities alone (it proves the value,
and that no strategy within the budgets has less than the lower bound), and redraws route and path
from the recorded entropy. Also finds random sources that are too short or repeat in the folder,
copies of a recording, and recordings that others, or the folder's list, say are missing.
--replan also solves each game again, without a warm start, and compares the values.

Not checked: whether the newest recordings were deleted, whether the plan is yours, and whether the
drawn route was driven; markers, diagnostics, request and response, times, and the poses of start
and goal. Anyone who can edit the files can forge a consistent departure: docs/recordings.md shows
how to sign a folder.

Output: one line per departure with its problems below it, then the plans if there are several, and
departures that were struck as unused; progress on standard error.
--json: {"verdict", "departures": [{"file", "number", "holds", "value", "problems", "notes"}],
"findings", "notes", "plans": [{"made", "value", "departures"}], "struck": [FILE]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'verify', 'Check that recorded departures follow from what is recorded with them.', EPILOG,
    )
    made.add_argument('--replan', action='store_true',
                      help='solve each game again and compare the values')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..recordings import recordings_in
    from ..recordings.recorded_departures import together
    from ..recordings.verify import Verifier

    paths = recordings_in(options.recordings)
    console.say(f'verifying {cli.count(len(paths), "recording")}')
    verifier = Verifier(options.replan)
    verdicts = [verifier.verify(path) for path in console.progress(paths, 'verified')]
    for verdict in verdicts:
        line = f'{"holds" if verdict.holds else "FAILS"}  {shown(verdict.path.name)}'
        if said := verdict.metadata:
            diverted = f' diverted ({said.diversion.number})' if said.diversion else ''
            line += (f': departure {said.departure}{diverted}, {verdict.nodes} nodes, '
                     f'value {_value(verdict, said)}')
        console.line(line)
        _print_below(console, verdict.problems, verdict.notes)
    findings, notes = together(verdicts)
    if findings:
        console.line('FAILS')
    _print_below(console, findings, notes)
    failing = [verdict for verdict in verdicts if not verdict.holds]
    departures = cli.count(len(verdicts), 'departure')
    if failing:
        console.line(f'{len(failing)} of {departures}: not consistent')
    else:
        console.line(f'{departures}: {"each holds, but not together" if findings else "all hold"}')
    known = [(each, each.metadata) for each in verdicts if each.metadata]
    plans = Counter((said.plan.made_ns, said.plan.id, each.plan_value)
                    for each, said in known if said.plan)
    if len(plans) > 1:
        each_plan = ', '.join(f'{number} of {when(made)} (value {rounded(value)})'
                              for (made, _, value), number in sorted(plans.items()))
        console.item(f'{cli.count(plans.total(), "departure")} of {len(plans)} plans: {each_plan}',
                     0)
    replaced = {said.day.replaces for _, said in known if said.day}
    struck = [each.path for each, said in known if said.departure_id in replaced]
    if struck:
        console.item(readers.struck_note(struck, len(verdicts)), 0)
    console.result = {
        'departures': [*map(_as_json, verdicts)], 'findings': findings, 'notes': notes,
        'plans': [{'made': when(made), 'value': value, 'departures': number}
                  for (made, _, value), number in sorted(plans.items())],
        'struck': [*map(cli.place, struck)],
    }
    if findings or any(verdict.readable for verdict in failing):
        return cli.Exit.FINDING
    return cli.Exit.UNREADABLE if failing else cli.Exit.HOLDS


def _value(verdict: Verdict, said: Metadata) -> str:
    if not (said.plan and said.plan.slots and said.day):
        return f'{verdict.value:.6g}'
    if not said.day.slot_drawn:
        return f'{verdict.value:.4g} at a known time'
    return f'{verdict.plan_value:.4g} ({verdict.value:.4g} if he knows the time)'


def _print_below(console: cli.Console, problems: Sequence[str], notes: Sequence[str]) -> None:
    for text in (*problems, *(f'({note})' for note in notes)):
        console.item(text)


def _as_json(verdict: Verdict) -> dict[str, Any]:
    return {
        'file': cli.place(verdict.path), 'holds': verdict.holds,
        'number': verdict.metadata.departure if verdict.metadata else 0,
        'value': verdict.value if math.isfinite(verdict.value) else None,
        'problems': verdict.problems, 'notes': verdict.notes,
    }


main = cli.command(parser, _work)
