"""The audit in words and tables. Positions stand in the CSV only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from io import StringIO
from textwrap import fill

import numpy as np

from ..recordings import RecordedDeparture
from ..recordings.audit_departures import FEWEST_DEPARTURES, Audit
from ..recordings.audit_learning import LEARNT
from . import cli

CHECKS = {
    'frequency': 'each stretch is driven as often as published',
    'surprise': 'routes are as likely as they should be',
    'order': 'no rhythm from one departure to another',
    'repeats': 'pairs of departures on the very same route',
}
# Over this number, words say more than digits.
UNTOLD = 1e12
# Of findings of one kind.
MOST_TOLD = 10


@dataclass(frozen=True, eq=False)
class Solution:
    """What an audit found.

    Attributes
    ----------
    departures, audited
        All that could be read, and those of strategies without cycles.
    audit
        Of the latter; None where they are too few.
    impossible
        Steps and ends of routes that cannot have been drawn.
    sources
        What is wrong with random sources, a line each.
    unreadable
        The errors of files that could not be read.
    """

    departures: Sequence[RecordedDeparture]
    audited: Sequence[RecordedDeparture]
    audit: Audit | None
    impossible: int
    sources: Sequence[str]
    unreadable: Sequence[Exception]

    @property
    def strategies(self) -> int:
        """How many strategies the departures were drawn from."""
        return len({id(each.strategy) for each in self.departures})

    @property
    def left_out(self) -> int:
        """How many departures were not audited."""
        return len(self.departures) - len(self.audited)

    @property
    def missing(self) -> int:
        """How many more departures an audit needs."""
        return max(0, FEWEST_DEPARTURES - len(self.audited))

    @property
    def code(self) -> cli.Exit:
        """The exit code."""
        if self.impossible or self.sources or (self.audit and self.audit.findings):
            return cli.Exit.FINDING
        if self.unreadable:
            return cli.Exit.UNREADABLE
        return cli.Exit.HOLDS if self.audit and not self.left_out else cli.Exit.TOO_FEW


def lines(found: Solution) -> list[str]:
    """Return the whole text, line by line."""
    audit, sources = found.audit, found.sources
    said = [title(found), ''] if found.departures else []
    if audit:
        said += [*table(audit).splitlines(), '', *findings(audit), '', *learning_lines(audit)]
    elif found.impossible:
        said.append(f'FINDING (impossible): {impossible_steps(found.impossible)}')
    said += [f'FINDING (random source): {each}' for each in sources[:MOST_TOLD]]
    if len(sources) > MOST_TOLD:
        said.append(f'FINDING (random source): {len(sources) - MOST_TOLD} more')
    if found.left_out:
        left_out = cli.count(found.left_out, 'departure')
        said.append(f'Not audited, as their strategies have cycles: {left_out}.')
    if audit is None:
        said.append(
            f'Not enough to tell: {FEWEST_DEPARTURES} departures are needed, {found.missing} more '
            'than these.'
        )
    said += [f'UNREADABLE, and no part of the audit: {error}' for error in found.unreadable]
    return [part for line in said for part in _wrapped(line)]


def title(found: Solution) -> str:
    """Say how many departures, of how many strategies, and when they were."""
    strategies = f'{found.strategies} strateg{"ies" if found.strategies != 1 else "y"}'
    departures = cli.count(len(found.departures), 'departure')
    return f'{departures} of {strategies}, {span(found.departures)}'


def span(departures: Sequence[RecordedDeparture]) -> str:
    """Return from when to when the departures were."""
    ends = (when(departures[k].stamp_ns) for k in (0, -1))
    return ' to '.join(dict.fromkeys(ends))


def when(stamp_ns: int) -> str:
    """Return a time as date and minute, UTC."""
    moment = datetime.fromtimestamp(stamp_ns // 1_000_000_000, tz=timezone.utc)
    return moment.strftime('%Y-%m-%d %H:%M UTC')


def table(audit: Audit) -> str:
    """One row a check: the statistic, what chance makes of it, and the chance of as much."""
    rows = [('check', 'recorded', 'by chance', 'p-value', '')]
    rows.append(('nothing that the strategy cannot draw', str(audit.impossible), '0', '-',
                 _mark(audit.impossible > 0)))
    for name, verdict in audit.tests.items():
        rows.append((CHECKS[name], f'{verdict.observed:.4g}', f'{verdict.expected:.4g}',
                     f'{verdict.p_value:.5f}', _mark(verdict.finding)))
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    lines = [
        f'{row[0]:<{widths[0]}}'
        + ''.join(f'  {cell:>{width}}' for cell, width in zip(row[1:4], widths[1:], strict=True))
        + f'  {row[4]}'
        for row in rows
    ]
    return '\n'.join(line.rstrip() for line in lines)


def findings(audit: Audit) -> list[str]:
    """Say what was found and what it means, or that nothing was."""
    rate = f'{100.0 * audit.false_alarm_rate:g} %'
    if not audit.findings:
        return [
            'Nothing suspicious. Departures of this strategy, drawn as published, raise an alarm '
            f'in at most {rate} of audits. Few departures show gross deviations only.'
        ]
    expected = audit.tests['repeats'].expected
    said = {
        'impossible': impossible_steps(audit.impossible),
        'frequency': 'Some stretches are driven far more often, others less often, than the '
        'published probabilities say. The picture shows which.',
        'surprise': f'The routes are on the whole {_likelier(audit)} than routes drawn '
        'as published: the draw does not weigh the choices as it should.',
        'order': _rhythm(audit),
        'repeats': f'Only {audit.different} of {audit.departures} routes are different, where '
        f'{expected:.3g} identical pairs are expected by chance: routes '
        'are used again, or the source of randomness repeats itself.',
    }
    return [f'FINDING ({name}): {said[name]}' for name in audit.findings] + [
        f'Departures of this strategy, drawn as published, raise an alarm in at most {rate} of '
        'audits.'
    ]


def impossible_steps(count: int) -> str:
    """Say how many steps and ends of routes the strategy cannot have drawn."""
    return (
        f'Steps and ends of routes that cannot have been drawn: {count}. Something else was driven '
        'than was planned, or the files do not belong together.'
    )


def learning_lines(audit: Audit) -> list[str]:
    """Say what an observer of these departures has learnt."""
    learning, n = audit.learning, audit.departures
    lines = [
        'To guess the next route is as hard as among '
        f'{plain(learning.effective_routes)} equally likely ones. Two identical routes are to be '
        f'expected among {plain(learning.departures_to_repeat)} departures.'
    ]
    share = f'{100.0 * LEARNT:.0f} %'
    known = (
        f'An ambusher who knows the strategy causes a mean loss of {learning.value:.4g} a '
        'departure, and nobody can expect more. One who has only watched, and then waits where it '
        'would have cost most so far, '
    )
    if learning.departures_to_learn is None:
        lines.append(f'{known}had not come to {share} of that for good after all {n} departures.')
    else:
        lines.append(
            f'{known}causes at least {share} of that from '
            f'{cli.count(learning.departures_to_learn, "watched departure")} on.'
        )
    lines.append(
        f'Watching and waiting at once, he would have met {learning.ambushes} of the {n - 1} '
        'departures after the first, by luck or for want of it: a mean loss of '
        f'{learning.ambusher_loss:.3g}. Had one of their routes been driven every time, he would '
        f'have met all, a mean loss of {learning.fixed_loss:.3g}.'
    )
    return lines


def passages_csv(audit: Audit) -> str:
    """Every stretch that is published or was driven, with both frequencies. A secret."""
    stream = StringIO()
    rows = np.column_stack((audit.segments.reshape(-1, 4), audit.expected, audit.passages))
    np.savetxt(
        stream, rows, ['%.3f'] * 4 + ['%.6g', '%d'], delimiter=',', comments='',
        header='tail_x,tail_y,head_x,head_y,expected_passages,passages',
    )
    return stream.getvalue()


def plain(number: float) -> str:
    """Return a number of things as people read it; huge ones as a power of ten."""
    if number >= UNTOLD:
        return f'10^{math.floor(math.log10(number))}' if math.isfinite(number) else 'countless'
    return f'{number:,.0f}' if number >= 100.0 else f'{number:.3g}'


def _mark(finding: bool) -> str:
    return 'FINDING' if finding else 'ok'


def _likelier(audit: Audit) -> str:
    return 'too likely' if audit.mean_surprise < audit.mean_entropy else 'too unlikely'


def _rhythm(audit: Audit) -> str:
    order = audit.order
    centre = order.expected - order.expected.mean() + order.mean
    deviation = (order.by_lag - centre) / np.maximum(order.band, 1e-9)
    worst = int(np.argmax(np.abs(deviation)))
    alike = 'more' if deviation[worst] > 0.0 else 'less'
    apart = 'that follow each other' if worst == 0 else f'{worst + 1} apart'
    return (
        f'Departures {apart} share {100.0 * order.by_lag[worst]:.0f} % of their ground, '
        f'{alike} than the {100.0 * order.mean:.0f} % of any two: who watches can tell what comes '
        'next.'
    )


def _wrapped(line: str) -> list[str]:
    """Lines of sentences at the width of a terminal; those of tables are short already."""
    return fill(line, cli.WIDTH, break_on_hyphens=False).splitlines() or ['']
