"""``ambush_audit``: do recorded departures follow their strategies, and do they show patterns?"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..audit.departures import FEWEST_DEPARTURES, Audit, Driven, audit
from ..audit.draws import ManyRoutes, NotAuditable
from ..core.strategy import Strategy
from ..recording import UnreadableRecording, recordings_in
from ..review.departures import Departure, read_departures, source_findings
from . import audit_text, cli
from .audit_figures import audit_figure
from .figures import as_png

TEXT, PICTURE, PASSAGES = 'audit.txt', 'audit.png', 'audit_passages.csv'
EPILOG = """\
Each departure is tested under its own strategy, and all of them together: whether stretches are
driven as often as published, whether routes are as likely as they should be, whether the order
shows a rhythm, and whether routes repeat. A start that moves a little does not keep departures
apart. Also whether each was drawn from random numbers of its own, of full length; a fixed seed is
a finding. It also says what an observer would have learnt.

The result is printed. With -o, DIR gets audit.txt (the same), audit.png (published and
recorded frequencies on the map) and audit_passages.csv (stretch by stretch). These show secret
routes: files have mode 0600, a new folder 0700.

Fewer than five departures are not enough to tell, nor are strategies with cycles; what cannot
have been drawn at all is found all the same.
--json: {"verdict", "departures", "strategies", "false_alarm_rate", "findings", "tests": {name:
{"recorded", "by_chance", "p_value", "finding"}}, "impossible", "random_source", "unreadable",
"not_audited", "needed"}
""" + cli.EXIT_CODES


def main(arguments: Sequence[str] | None = None) -> int:
    """Audit recordings and return the exit code."""
    return cli.run(parser(), _work, arguments)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'audit',
        'Test recorded departures: do they follow their strategies, do they show patterns?',
        EPILOG,
    )
    cli.add_recordings(made)
    cli.add_output(made, 'the result')
    made.add_argument(
        '--false-alarm-rate', type=_rate, default=0.01, metavar='RATE',
        help='chance of any finding where there is nothing to find (default: %(default)s)',
    )
    return made


def read_all(
    place: Path, console: cli.Console
) -> tuple[list[Departure], list[UnreadableRecording]]:
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
    departures, unreadable = read_all(options.recordings, console)
    audited, others = _auditable(departures)
    console.say(f'auditing {cli.count(len(audited), "departure")}')
    result = None
    if len(audited) >= FEWEST_DEPARTURES:
        driven = [Driven(each.strategy, each.route) for each in audited]
        result = audit(driven, options.false_alarm_rate, console.bar('audited'))
    impossible = result.impossible if result else _impossible(audited)
    sources = source_findings((each.path.name, each.metadata) for each in departures)
    sources += [
        f'{each.path.name}: drawn with a fixed seed, which can be foretold'
        for each in departures if each.parameters.seed >= 0
    ]
    code = _exit_code(result, impossible, sources, unreadable, others)
    lines = audit_text.lines(departures, audited, result, impossible, sources, unreadable, others)
    for line in lines:
        console.line(console.marked(line, False) if line.startswith('FINDING') else line)
    console.result = _as_json(
        code, departures, result, impossible, sources, unreadable, len(others), len(audited)
    )
    if options.output:
        texts = {TEXT: '\n'.join([*lines, ''])}
        _write(options.output, texts, departures, result)
        console.line(f'\nIn {cli.place(options.output)}: {", ".join(files if result else texts)}. '
                     'They are secret.')
    return code


def _auditable(departures: Sequence[Departure]) -> tuple[list[Departure], list[Departure]]:
    """Those of strategies without cycles, and the others."""
    good: dict[int, bool] = {}
    for each in departures:
        if id(each.strategy) not in good:
            good[id(each.strategy)] = _walkers(each.strategy) is not None
    return (
        [each for each in departures if good[id(each.strategy)]],
        [each for each in departures if not good[id(each.strategy)]],
    )


def _walkers(strategy: Strategy) -> ManyRoutes | None:
    try:
        return ManyRoutes(strategy.network, strategy.edge_probability)
    except NotAuditable:
        return None


def _impossible(departures: Sequence[Departure]) -> int:
    """What can be said of any number of departures: how much cannot have been drawn at all."""
    return sum(_walkers(each.strategy).recorded([each.route])[1] for each in departures)


def _exit_code(
    result: Audit | None,
    impossible: int,
    sources: Sequence[str],
    unreadable: Sequence[object],
    others: Sequence[object],
) -> cli.Exit:
    if impossible or sources or (result and result.findings):
        return cli.Exit.FINDING
    if unreadable:
        return cli.Exit.UNREADABLE
    return cli.Exit.TOO_FEW if result is None or result.blind or others else cli.Exit.HOLDS


def _write(
    output: Path, texts: dict[str, str], departures: Sequence[Departure], result: Audit | None
) -> None:
    # Names of unreadable files need not be UTF-8.
    files = {name: text.encode(errors='backslashreplace') for name, text in texts.items()}
    if result:
        files[PICTURE] = as_png(audit_figure(departures[-1].risk_map, result))
        files[PASSAGES] = audit_text.passages_csv(result).encode()
    cli.write_private(output, files)


def _as_json(
    code: cli.Exit,
    departures: Sequence[Departure],
    result: Audit | None,
    impossible: int,
    sources: list[str],
    unreadable: Sequence[UnreadableRecording],
    others: int,
    audited: int,
) -> dict[str, Any]:
    tests = {
        name: {'recorded': test.observed, 'by_chance': test.expected, 'p_value': test.p_value,
               'finding': test.finding}
        for name, test in (result.tests.items() if result else ())
    }
    return {
        'verdict': code.name.lower(),
        'departures': len(departures),
        'strategies': len({id(each.strategy) for each in departures}),
        'false_alarm_rate': result.false_alarm_rate if result else None,
        'findings': list(result.findings) if result else [],
        'tests': tests,
        'impossible': impossible,
        'random_source': sources,
        'unreadable': [str(error) for error in unreadable],
        'not_audited': others,
        'needed': max(0, FEWEST_DEPARTURES - audited),
    }


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0.001 <= rate <= 0.5:
        raise argparse.ArgumentTypeError(f'must be a number from 0.001 to 0.5, got {text!r}')
    return rate


if __name__ == '__main__':
    sys.exit(main())
