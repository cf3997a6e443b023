# SPDX-License-Identifier: Apache-2.0
"""``ambush verify``: do recorded departures follow from what is recorded with them?"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import shown
from ..words import distance, rounded
from . import cli, readers
from .console import when
from .positions import written

if TYPE_CHECKING:
    from ..recordings.metadata import Metadata
    from ..recordings.verify import Verdict

EPILOG = """\
For each departure, checks the file's checksums, rebuilds the network from the recorded map and
parameters, recomputes the certificate from the recorded probabilities alone (it proves the value,
and that no strategy within the budgets has less than the lower bound), and redraws route and path
from the recorded entropy. Also finds random sources that are too short or repeat in the folder,
copies of a recording, and diversions without the recording that they left.
--replan also solves each game again, without a warm start, and compares the values. With --map or
--roads, the ground as it is now: is each departure clear there, and what does the best ambush cost?
The exit code is 1 if one is not clear. A plan file can be verified, too.

Not checked: whether the newest recordings were deleted, whether the plan is yours, and whether the
drawn route was driven; markers, diagnostics, request and response, times, and the poses of start
and goal. Anyone who can edit the files can forge a consistent departure: docs/recordings.md shows
how to sign a folder.

Output: one line per departure with its problems below it, then the plans if there are several, and
departures that were struck as unused; progress on standard error.
--json: {"verdict", "departures": [{"file", "number", "holds", "value", "problems", "notes",
"now": null, or with --map or --roads {"clear", "value", "clear_share", "blocked_at"}}],
"findings", "notes", "plans": [{"made", "value", "departures"}], "struck": {FILE: WHY}}
"""


# Share of clear routes from which all are called clear.
CLEAR = 0.9995


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'verify', 'Check that recorded departures follow from what is recorded with them.', EPILOG,
    )
    made.add_argument('--replan', action='store_true',
                      help='solve each game again and compare the values')
    made.add_argument('--map', type=Path, metavar='MAP',
                      help='is each departure clear on this map, and what does it cost now?')
    made.add_argument('--roads', type=Path, metavar='FILE', help='and on these roads')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..recordings.recorded_departures import recordings_in, together
    from ..recordings.verify import Verifier

    paths = recordings_in(options.recordings)
    console.say(f'verifying {cli.count(len(paths), "recording")}')
    verifier = Verifier(options.replan, options.map, options.roads)
    verdicts = [verifier.verify(path) for path in console.progress(paths, 'verified')]
    for verdict in verdicts:
        word = 'holds' if verdict.holds else 'CLOSED' if verdict.denied else 'FAILS'
        line = f'{word:<5}  {shown(verdict.path.name)}'
        if said := verdict.metadata:
            diverted = f' diverted ({said.diversion.number})' if said.diversion else ''
            line += (f': departure {said.departure}{diverted}, {verdict.nodes} nodes, '
                     f'value {_value(verdict, said)}')
        if plan := verdict.plan:
            line += (f': plan of {when(plan.plan.made_ns)}, {verdict.nodes} nodes, '
                     f'value {verdict.value:.4g}')
        console.line(line)
        _print_below(console, [*verdict.problems, *_now(verdict)], verdict.notes)
    findings, notes = together(verdicts)
    if findings:
        console.line('FAILS')
    _print_below(console, findings, notes)
    known = [(each, each.metadata) for each in verdicts if each.metadata]
    replaced = {said.day.replaces: said.day.why for _, said in known if said.day}
    struck = {each.path: replaced[said.departure_id] for each, said in known
              if said.departure_id in replaced}
    blocked = [verdict for verdict in verdicts
               if _is_blocked(verdict) and verdict.path not in struck]
    failing = [verdict for verdict in verdicts if not (verdict.holds or verdict.denied)]
    denied = [verdict for verdict in verdicts if verdict.denied]
    departures = cli.count(len(verdicts), 'plan' if verdicts[0].plan else 'departure')
    if denied:
        console.line(f'{len(denied)} of {departures}: no permission to read')
    if failing:
        console.line(f'{len(failing)} of {departures}: not consistent')
    elif denied:
        console.line(f'{len(verdicts) - len(denied)} of {departures}: all hold')
    else:
        console.line(f'{departures}: {"each holds, but not together" if findings else "all hold"}')
    plans = Counter((said.plan.made_ns, said.plan.id, each.plan_value)
                    for each, said in known if said.plan)
    if len(plans) > 1:
        each_plan = ', '.join(f'{number} of {when(made)} (value {rounded(value)})'
                              for (made, _, value), number in sorted(plans.items()))
        console.item(f'{cli.count(plans.total(), "departure")} of {len(plans)} plans: {each_plan}',
                     0)
    if options.map or options.roads:
        console.line(f'{len(blocked)} of {departures}: not clear on the new ground')
    if struck:
        console.item(readers.struck_note(struck, len(verdicts)), 0)
    console.result = {
        'departures': [*map(_as_json, verdicts)], 'findings': findings, 'notes': notes,
        'plans': [{'made': when(made), 'value': value, 'departures': number}
                  for (made, _, value), number in sorted(plans.items())],
        'struck': readers.struck_json(struck),
    }
    if findings or blocked or any(verdict.readable for verdict in failing):
        return cli.Exit.FINDING
    return cli.Exit.UNREADABLE if failing or denied else cli.Exit.HOLDS


def _value(verdict: Verdict, said: Metadata) -> str:
    if not (said.plan and said.plan.slots and said.day):
        return f'{verdict.value:.6g}'
    if not said.day.slot_drawn:
        return f'{verdict.value:.4g} at a known time'
    return f'{verdict.value:.4g} ({verdict.value / verdict.covered:.4g} if he knows the time)'


def _is_blocked(verdict: Verdict) -> bool:
    """Return whether the path, or some route of a plan, is blocked on the new ground."""
    now = verdict.now
    return bool(now and (now.clear_share < CLEAR if verdict.plan else now.blocked))


def _now(verdict: Verdict) -> list[str]:
    """Say what is clear on the new ground, and what it costs there."""
    if (now := verdict.now) is None:
        return []
    costs = (f'value {now.value:.4g}, before {now.before:.4g}' if now.clear_share > 0.0 else
             'no route of its plan is clear')
    if 0.0 < now.clear_share < CLEAR:
        costs += f', on the {now.clear_share:.0%} of the routes of its plan that are clear'
    if verdict.plan:
        return [f'now: {costs}']
    if now.blocked is None:
        return [f'now: clear; {costs}']
    more = now.blocked.places - 1
    others = f' and in {cli.count(more, "more place")}' * bool(more)
    return [f'now: BLOCKED at {written(now.blocked.xy, now.risk_map)}, '
            f'{distance(now.blocked.along)} from the start{others}; {costs}']


def _print_below(console: cli.Console, problems: Sequence[str], notes: Sequence[str]) -> None:
    for text in (*problems, *(f'({note})' for note in notes)):
        console.item(text)


def _as_json(verdict: Verdict) -> dict[str, Any]:
    now = verdict.now
    return {
        'file': cli.place(verdict.path), 'holds': verdict.holds,
        'number': verdict.metadata.departure if verdict.metadata else 0,
        'value': verdict.value if math.isfinite(verdict.value) else None,
        'problems': verdict.problems, 'notes': verdict.notes, 'now': now and {
            'clear': not _is_blocked(verdict), 'value': now.value, 'clear_share': now.clear_share,
            'blocked_at': now.blocked and now.blocked.xy},
    }


main = cli.command(parser, _work)
