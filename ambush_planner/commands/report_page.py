# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML page that needs no network: its style and pictures are inline.

All text from files passes ``html.escape``. The Content-Security-Policy lets no script run.
"""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from string import Template
from urllib.parse import quote

from ..colours import OBSTACLE, PROBABILITY
from ..map_figures import as_png
from ..recordings.report_data import Section
from ..route_files import Drawn
from . import report_words as words
from .cli import count, resource

# The colours of the page by their names in CSS.
COLOURS = {'accent': PROBABILITY[2], 'text': OBSTACLE}
SEVERAL = (
    '{} strategies were computed for this trip: its network was refined, or the start, the goal or '
    'the settings changed a little. The page shows probabilities and numbers of the latest one; '
    'the table has the mean loss of each.'
)
FIXED_SEED = (
    'At least one of these departures was drawn with a fixed seed: anyone who knows the seed can '
    'predict the route. Use fixed seeds for tests only.'
)
NOT_VERIFIED = 'Not verified: this page shows what the recordings say; --verify checks them.'
VERIFIED = (
    'Verified: all {} recordings are complete, the numbers follow from the recorded map, and each '
    'route from the recorded random numbers.'
)


@dataclass(frozen=True)
class Checks:
    """Result of verification and audit: the problems by file; findings and notes of the audit."""

    recordings: int
    problems: Mapping[str, Sequence[str]]
    findings: Sequence[str]
    notes: Sequence[str]


def page(sections: Sequence[Section], folder: Path, warnings: Sequence[str],
         checks: Checks | None) -> str:
    """Return the page for a folder; ``checks`` is None if the recordings were not verified."""
    problems = _problems(checks) if checks else []
    return Template(resource('report_page.html')).substitute(
        colours=' '.join(f'--{name}: {each};' for name, each in COLOURS.items()),
        style=resource('report.css'), warnings=_warnings([*problems, *warnings]),
        status=_status(checks),
        audit=_audit(checks, sum(len(section.departures) for section in sections)),
        sections='\n'.join(
            _section(section, folder, f'Trip {k} of {len(sections)}: ' * (len(sections) > 1))
            for k, section in enumerate(sections, start=1)
        ),
    )


def _problems(checks: Checks) -> list[str]:
    """That verification or audit have found something; the end of the page has all of it."""
    failed = [f'VERIFICATION FAILED for {len(checks.problems)} of {checks.recordings} recordings. '
              'Do not rely on this page; its end has the reasons.'] * bool(checks.problems)
    others = len(checks.findings) - 1
    more = f' The end of the page has {others} more.' if others > 0 else ''
    return failed + [f'The audit found: {each}.{more}' for each in checks.findings[:1]]


def _status(checks: Checks | None) -> str:
    if checks is None:
        return NOT_VERIFIED
    return '' if checks.problems else VERIFIED.format(checks.recordings)


def _audit(checks: Checks | None, departures: int) -> str:
    if checks is None:
        return ''
    return f'<h3>What {count(departures, "departure")} can show</h3>\n' + _paragraphs([
        *(f'{name}: {"; ".join(problems)}.' for name, problems in checks.problems.items()),
        *(f'Finding: {each}.' for each in checks.findings), *checks.notes,
    ])


def _section(section: Section, folder: Path, name: str) -> str:
    departures = section.departures
    times = dict.fromkeys(words.leaving(departures[k]) for k in (0, -1))
    warnings, several = [], len({id(each.trip) for each in departures})
    if any(each.parameters.values['seed'] >= 0 for each in departures):
        warnings.append(FIXED_SEED)
    times_drawn = [datetime.fromtimestamp(each.stamp_ns // 10**9, timezone.utc)
                   for each in departures]
    drawn = Drawn(section.trip, section.risk_map, [each.path_poses for each in departures],
                  times_drawn, covered=departures[-1].covered)
    return Template(resource('report_section.html')).substitute(
        heading=f'{name}{count(len(departures), "departure")}, {" to ".join(times)}',
        warnings=_warnings(warnings) + _paragraphs([SEVERAL.format(several)] * (several > 1)),
        picture=b64encode(as_png(drawn.picture())).decode(),
        tiles=''.join(f'<li><b>{escape(number)}</b> {escape(text)}</li>'
                      for number, text in words.tiles(section)),
        departures=_departures(section, folder),
        certificate=_paragraphs(words.certificate(section)),
        measures=_table(words.measures(section), 'first'),
        quantities=_table([(), *words.quantities(section)]),
    )


def _paragraphs(texts: Iterable[str]) -> str:
    return '\n'.join(f'<p>{escape(text)}</p>' for text in texts)


def _warnings(texts: Iterable[str]) -> str:
    return '\n'.join(f'<p class="secret"><strong>Warning.</strong> {escape(text)}</p>'
                     for text in texts)


def _departures(section: Section, folder: Path) -> str:
    """The table of departures: the number of each on the map, and its recording."""
    head, *rows = words.departures(section)
    lines = []
    for each, (number, *cells) in zip(section.departures, rows, strict=True):
        file = quote(os.path.relpath(each.path, folder))
        name = escape(each.metadata.departure_id)
        lines.append(f'<tr title="departure {name}"><th scope="row">{number}</th>'
                     f'{_cells(cells)}<td><a href="{file}">MCAP</a></td></tr>')
    return _framed([*head, 'recording'], lines, 'departures')


def _table(rows: Sequence[Sequence[str]], kind: str = '') -> str:
    """Return a table; the first row is its head."""
    return _framed(rows[0], [f'<tr><th scope="row">{escape(name)}</th>{_cells(cells)}</tr>'
                             for name, *cells in rows[1:]], kind)


def _cells(texts: Iterable[str]) -> str:
    return ''.join(f'<td>{escape(text)}</td>' for text in texts)


def _framed(head: Iterable[str], lines: Iterable[str], kind: str) -> str:
    heads = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    return (f'<table class="{kind}"><thead><tr>{heads}</tr></thead>'
            f'<tbody>{"".join(lines)}</tbody></table>')
