# SPDX-License-Identifier: Apache-2.0
"""``ambush audit``: do departures follow the published strategy, and could one predict them?"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from . import cli, readers

if TYPE_CHECKING:
    from ..recordings.audit import Audit
    from ..recordings.recorded_departure import RecordedDeparture

SENSITIVITY = (
    'What the test can find: one route driven every time in 5 departures, a few routes in turn in '
    'about 20, a mild preference for some stretches in about 100.'
)
NUMBERS = ('left_out', 'p_value', 'impossible', 'value', 'observer_loss', 'observer_range')
EPILOG = """\
Tests all departures together, each under the strategy that it was drawn from: does the convoy
use every stretch, and every time of departure that was drawn, as often as published? The p-value
comes from 999 resamples. A p-value of at most 0.001 is a finding, so 1 of 1000 audits of honest
departures has one. Impossible steps, fixed seeds, and random sources that repeat or are too short
are findings, too. The audit also simulates an observer who learns from each departure: before the
next one he waits where an ambush would have cost the earlier ones most.

You need at least five departures from strategies without cycles.
--json: {"verdict", "departures", "left_out", "findings", "p_value", "impossible", "value",
"observer_loss", "observer_range", "unreadable", "struck": {FILE: WHY}}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    return readers.reader_parser(
        'audit', 'Test recorded departures: do they follow the published strategies?', EPILOG)


def audited(departures: list[RecordedDeparture]) -> tuple[Audit | None, list[str], list[str]]:
    """Audit departures; return the audit (None: too few departures), findings, and notes."""
    from ..recordings.audit import NotAuditable, audit
    from ..recordings.recorded_departures import drawn_twice, source_findings

    findings = source_findings((part.path.name, part.metadata) for each in departures
                               for part in each.parts) + [
        f'{each.path.name} was drawn with a fixed seed, so it can be predicted'
        for each in departures if each.parameters.values['seed'] >= 0
    ]
    copies, again = drawn_twice((each.path, each.metadata) for each in departures)
    findings += copies
    try:
        result = audit(departures)
    except NotAuditable as error:
        return None, findings, [f'Not enough data: {error}.', *(f'{each}.' for each in again)]
    timed = any(each.drawn_slot for each in departures)
    if result.impossible:
        findings.append(f'{result.impossible} steps or ends of routes cannot have been drawn: '
                        'the recorded routes are not those that were planned')
    elif result.finding:
        used = 'used some stretches' + ' or times of departure' * timed
        findings.append(f'the convoy {used} far more or less often than published '
                        f'(p = {result.p_value:.3g})')
    low, high = result.observer_range
    usual = ('low' if result.observer_loss < low else
             'high' if result.observer_loss > high else 'normal')
    notes = [
        SENSITIVITY,
        'Had an observer waited each time where earlier routes would have cost most, he would have '
        f'caused {result.observer_loss:.3g} per departure. Honest draws of {result.departures} '
        f'departures give {low:.3g} to {high:.3g} in nine cases of ten, so this is {usual}. Over '
        f'many departures, he can cause at most the value, {result.value:.3g}, on average.',
    ]
    if not findings:
        used = 'the stretches' + ' and times of departure' * timed
        notes.insert(0, f'Nothing suspicious: the convoy used {used} as often as published '
                     f'(p = {result.p_value:.2g}).')
    if result.left_out:
        notes.append('Not audited, because their strategies have cycles: '
                     f'{cli.count(result.left_out, "departure")}.')
    notes += [f'{each}.' for each in again]
    return result, findings, notes


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from .report_words import leaving

    departures, unreadable, struck = readers.read_all(options.recordings, console)
    result, findings, notes = audited(departures)
    if departures:
        times = [leaving(each) for each in departures]
        ends = dict.fromkeys((min(times), max(times)))
        console.line(f'{cli.count(len(departures), "departure")}, {" to ".join(ends)}')
    if struck:
        notes.append(readers.struck_note(struck, len(departures) + len(struck)))
    for line in [*(f'FINDING: {each}.' for each in findings), *notes,
                 *(f'UNREADABLE and not audited: {each}' for each in unreadable)]:
        console.item(line, 0)
    console.result = {
        'departures': len(departures), 'findings': findings,
        **{name: getattr(result, name, None) for name in NUMBERS},
        'unreadable': [str(error) for error in unreadable],
        'struck': readers.struck_json(struck),
    }
    if findings:
        return cli.Exit.FINDING
    if unreadable:
        return cli.Exit.UNREADABLE
    return cli.Exit.HOLDS if result and not result.left_out else cli.Exit.TOO_FEW


main = cli.command(parser, _work)
