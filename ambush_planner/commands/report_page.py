# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML page that needs no network: its style, script and data are inline.

All text from files passes ``html.escape``. The Content-Security-Policy names the only script by its
hash, so nothing else would run.
"""

from __future__ import annotations

import hashlib
import json
import os
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from urllib.parse import quote

from ..colours import AMBUSHER, ENDS, OBSTACLE, PROBABILITY, RISK, ROUTES
from ..errors import InvalidCoordinates
from ..recordings.report_data import Section, map_data
from ..words import percent, rounded
from . import report_words as words
from .cli import count, resource

# The colours of the page by their names in CSS and in the script.
COLOURS = {'risk': RISK, 'chances': PROBABILITY, 'accent': PROBABILITY[2:3],
           'routes': ROUTES, 'obstacle': [OBSTACLE], 'ambusher': [AMBUSHER], 'ends': [ENDS]}
# Least and greatest ratio of width to height of the map on the page.
MIN_RATIO, MAX_RATIO = 0.6, 2.5
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
    script = resource('report_map.js')
    return Template(resource('report_page.html')).substitute(
        digest=b64encode(hashlib.sha256(script.encode()).digest()).decode(), script=script,
        colours=' '.join(f'--{name}: {", ".join(each)};' for name, each in COLOURS.items()),
        style=resource('report.css'), warnings=_warnings([*problems, *warnings]),
        status=_status(checks),
        audit=_audit(checks, sum(len(section.departures) for section in sections)),
        sections='\n'.join(
            _section(section, folder, f'Trip {k} of {len(sections)}: ' * (len(sections) > 1))
            for k, section in enumerate(sections, start=1)
        ),
    )


def colours(section: Section) -> list[str | None]:
    """Colours of the departures; all but the latest have none."""
    total = len(section.departures)
    return [ROUTES[k % len(ROUTES)] if k >= total - len(ROUTES) else None for k in range(total)]


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
    departures, trip = section.departures, section.trip
    times = dict.fromkeys(words.leaving(departures[k]) for k in (0, -1))
    warnings, several = [], len({id(each.trip) for each in departures})
    if any(each.parameters.values['seed'] >= 0 for each in departures):
        warnings.append(FIXED_SEED)
    try:
        data = map_data(section)
    except InvalidCoordinates as error:
        warnings.append(f'No latitude and longitude at the pointer: {error}.')
        data = map_data(section, with_degrees=False)
    data['colours'] = colours(section)
    left, bottom, right, top = data['box']
    ratio = min(max((right - left) / (top - bottom), MIN_RATIO), MAX_RATIO)
    return Template(resource('report_section.html')).substitute(
        heading=f'{name}{count(len(departures), "departure")}, {" to ".join(times)}',
        warnings=_warnings(warnings) + _paragraphs([SEVERAL.format(several)] * (several > 1)),
        ratio=f'{ratio:.3f}', picture=_picture(section, ratio),
        data=json.dumps(data, allow_nan=False).replace('<', '\\u003c'),
        tiles=''.join(f'<li><b>{escape(number)}</b> {escape(text)}</li>'
                      for number, text in words.tiles(section)),
        least=rounded(min(data['levels'])), most=rounded(max(data['levels'])),
        likeliest=percent(float(trip.ground_uses[1].max(initial=0.0))),
        **{name: '' if there else 'hidden' for name, there in (
            ('waits', trip.value > 0.0), ('holds', data['discs']),
            ('blocks', section.risk_map.obstacles.any()))},
        north='; N is true north' if data['degrees'] else '',
        departures=_departures(section, folder),
        certificate=_paragraphs(words.certificate(section)),
        measures=_table(words.measures(section), 'first'),
        quantities=_table([(), *words.quantities(section)]),
    )


def _picture(section: Section, ratio: float) -> str:
    """The map as a picture for those who run no scripts; nothing without matplotlib."""
    try:
        from .report_picture import map_picture
    except ModuleNotFoundError:
        return ''
    return ('<img alt="Map of risk, probabilities, ambush sites and routes" src="data:image/jpeg;'
            f'base64,{b64encode(map_picture(section, ratio)).decode()}">')


def _paragraphs(texts: Iterable[str]) -> str:
    return '\n'.join(f'<p>{escape(text)}</p>' for text in texts)


def _warnings(texts: Iterable[str]) -> str:
    return '\n'.join(f'<p class="secret"><strong>Warning.</strong> {escape(text)}</p>'
                     for text in texts)


def _departures(section: Section, folder: Path) -> str:
    """The table of departures: a button that selects the route, its numbers, and its recording."""
    head, *rows = words.departures(section)
    lines = []
    for each, colour, (number, *cells) in zip(section.departures, colours(section), rows,
                                              strict=True):
        dot = f'<i style="background:{colour or "none"}"></i>'
        button = f'<button type="button" aria-pressed="false">{dot}{number}</button>'
        file = quote(os.path.relpath(each.path, folder))
        name = escape(each.metadata.departure_id)
        lines.append(f'<tr title="departure {name}"><th scope="row">{button}</th>'
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
