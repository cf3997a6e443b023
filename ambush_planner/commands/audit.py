"""``ambush_audit``: do recorded departures follow their strategies, and do they show patterns?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..game.acyclic import is_acyclic
from ..recordings import RecordedDeparture, UnreadableRecording, recordings_in
from ..recordings.audit_departures import FEWEST_DEPARTURES, LEAST_RATE, Driven, audit
from ..recordings.audit_draws import ManyRoutes
from ..recordings.recorded_departures import read_departures, source_findings
from . import audit_text, cli
from .audit_figures import audit_figure
from .audit_text import Solution
from .figures import as_png

TEXT, PICTURE, PASSAGES = 'audit.txt', 'audit.png', 'audit_passages.csv'
EPILOG = """\
Each departure is tested under its own strategy (where the map had changed since, under that
strategy with only the routes that were still clear), and all of them together: whether
stretches are driven as often as published, whether routes are as likely as they should be,
whether the order shows a rhythm, and whether routes repeat. A start that moves a little does not
keep departures apart. Also whether each was drawn from random numbers of its own, of full length;
a fixed seed is a finding. It also says what an observer would have learnt.

The result is printed. With -o, DIR gets audit.txt (the same), audit.png (published and
recorded frequencies on the map) and audit_passages.csv (stretch by stretch). These show secret
routes: files have mode 0600, a new folder 0700.

Fewer than five departures are not enough to tell, nor are strategies with cycles; what cannot
have been drawn at all is found all the same.
--json: {"verdict", "departures", "strategies", "false_alarm_rate", "findings", "tests": {name:
{"recorded", "by_chance", "p_value", "finding"}}, "impossible", "random_source", "unreadable",
"not_audited", "needed"}
""" + cli.EXIT_CODES


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'audit',
        'Test recorded departures: do they follow their strategies, do they show patterns?',
        EPILOG,
    )
    cli.add_output(made, 'the result')
    made.add_argument(
        '--false-alarm-rate', type=cli.number(LEAST_RATE, 0.5), default=0.01, metavar='RATE',
        help='chance of any finding where there is nothing to find (default: %(default)s)',
    )
    return made


def read_all(
    place: Path, console: cli.Console
) -> tuple[list[RecordedDeparture], list[UnreadableRecording]]:
    """Return the departures below ``place`` in time, and the errors of unreadable files.

    Raises
    ------
    UnreadableRecording
        There is nothing to read at all.
    """
    paths = recordings_in(place)
    console.say(f'reading {cli.count(len(paths), "recording")}')
    errors: list[UnreadableRecording] = []
    return read_departures(console.progress(paths, 'read'), errors.append), errors


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    files = [TEXT, PICTURE, PASSAGES]
    if options.output:
        cli.refuse_existing(options.output, files, options.replace)
    found = _outcome(*read_all(options.recordings, console), options.false_alarm_rate, console)
    lines = audit_text.lines(found)
    for line in lines:
        console.line(console.marked(line, False) if line.startswith('FINDING') else line)
    console.result = _as_json(found)
    if options.output:
        # Names of unreadable files need not be UTF-8.
        text = '\n'.join([*lines, '']).encode(errors='backslashreplace')
        written = {TEXT: text, **(_pictures(found) if found.audit else {})}
        cli.write_private(options.output, written)
        console.line(f'\nIn {cli.place(options.output)}: {", ".join(written)}. They are secret.')
    return found.code


def _outcome(
    departures: list[RecordedDeparture], unreadable: list[UnreadableRecording], rate: float,
    console: cli.Console,
) -> Solution:
    laws = {id(each.drawn_from): each.drawn_from for each in departures}
    acyclic = {key for key, law in laws.items() if is_acyclic(law.network, law.edge_probability)}
    audited = [each for each in departures if id(each.drawn_from) in acyclic]
    console.say(f'auditing {cli.count(len(audited), "departure")}')
    result = None
    if len(audited) >= FEWEST_DEPARTURES:
        driven = [Driven(each.drawn_from, each.route) for each in audited]
        result = audit(driven, rate, console.bar('audited'))
    # What cannot have been drawn at all can be said of any number of departures.
    impossible = result.impossible if result else sum(
        ManyRoutes(law.network, law.edge_probability).recorded([each.route])[1]
        for each in audited for law in (each.drawn_from,)
    )
    sources = source_findings(departures)
    sources += [
        f'{each.path.name}: drawn with a fixed seed, which can be foretold'
        for each in departures if each.parameters.seed >= 0
    ]
    return Solution(departures, audited, result, impossible, sources, unreadable)


def _pictures(found: Solution) -> dict[str, bytes]:
    return {
        PICTURE: as_png(audit_figure(found.departures[-1].risk_map, found.audit)),
        PASSAGES: audit_text.passages_csv(found.audit).encode(),
    }


def _as_json(found: Solution) -> dict[str, Any]:
    result = found.audit
    tests = {
        name: {'recorded': test.observed, 'by_chance': test.expected, 'p_value': test.p_value,
               'finding': test.finding}
        for name, test in (result.tests.items() if result else ())
    }
    return {
        'departures': len(found.departures),
        'strategies': found.strategies,
        'false_alarm_rate': result.false_alarm_rate if result else None,
        'findings': list(result.findings) if result else [],
        'tests': tests,
        'impossible': found.impossible,
        'random_source': found.sources,
        'unreadable': [str(error) for error in found.unreadable],
        'not_audited': found.left_out,
        'needed': found.missing,
    }


main = cli.command(parser, _work)
