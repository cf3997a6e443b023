"""The report as one HTML page that needs no network: its style, script and data are inline.

All text from files passes ``html.escape``. The Content-Security-Policy names the only script by its
hash, so nothing else would run.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from string import Template

from ..colours import ROUTES
from ..maps.coordinates import InvalidCoordinates
from ..recordings.report_data import Section, map_data
from . import report_words as words
from .audit import when
from .cli import count, resource

SEVERAL = (
    'The start, the goal or the settings changed a little, so {} strategies were computed for this '
    'trip. The page shows probabilities and numbers of the latest one; the table has the mean loss '
    'of each.'
)
FIXED_SEED = (
    'At least one of these departures was drawn with a fixed seed: anyone who knows the seed can '
    'predict the route. Use fixed seeds for tests only.'
)
NOT_VERIFIED = (
    'Not verified: this page shows what the recordings say. Run ambush verify on them, or make '
    'this page with --verify.'
)


@dataclass(frozen=True)
class Checks:
    """Result of verification and audit: the problems by file; findings and notes of the audit."""

    recordings: int
    problems: Mapping[str, Sequence[str]]
    findings: Sequence[str]
    notes: Sequence[str]


def page(sections: Sequence[Section], unreadable: int, checks: Checks | None) -> str:
    """Return the page; ``checks`` is None if the recordings were not verified."""
    departures = sum(len(section.departures) for section in sections)
    said = _checks(checks)
    if unreadable:
        said.append(_warning(f'Not shown, because unreadable: {count(unreadable, "recording")}.'))
    script = resource('report_map.js')
    return Template(resource('report_page.html')).substitute(
        digest=b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        title=f'Convoy routes: {count(departures, "departure")}', style=resource('report.css'),
        checks='\n'.join(said), script=script,
        sections='\n'.join(
            _section(section, f'Trip {k} of {len(sections)}: ' if len(sections) > 1 else '')
            for k, section in enumerate(sections, start=1)
        ),
    )


def colours(section: Section) -> dict[int, str]:
    """Colours of the latest departures by index; earlier ones have none."""
    total = len(section.departures)
    return {k: ROUTES[k % len(ROUTES)] for k in range(max(0, total - len(ROUTES)), total)}


def _checks(checks: Checks | None) -> list[str]:
    if checks is None:
        return _paragraphs([NOT_VERIFIED])
    said = [f'Verified: all {checks.recordings} recordings follow from their inputs, as checked by '
            'ambush_verify.']
    warnings = [f'The audit has a finding: {finding}.' for finding in checks.findings]
    if checks.problems:
        said = [f'{name}: {"; ".join(problems)}' for name, problems in checks.problems.items()]
        warnings.insert(0, f'VERIFICATION FAILED for {len(said)} of {checks.recordings} '
                           'recordings. Do not rely on this page.')
    return [*map(_warning, warnings), *_paragraphs([*said, *checks.notes])]


def _section(section: Section, name: str) -> str:
    departures, strategy = section.departures, section.strategy
    times = dict.fromkeys(when(departures[k].stamp_ns) for k in (0, -1))
    warnings = []
    if any(each.parameters.seed >= 0 for each in departures):
        warnings.append(_warning(FIXED_SEED))
    if (strategies := len({id(each.strategy) for each in departures})) > 1:
        warnings += _paragraphs([SEVERAL.format(strategies)])
    try:
        data = map_data(section)
    except InvalidCoordinates as error:
        warnings.append(_warning(f'No latitude and longitude at the pointer: {error}.'))
        data = map_data(section, with_degrees=False)
    coloured, rows = colours(section), words.departures(section)
    data['colours'] = [coloured.get(k) for k in range(len(departures))]
    dots = {k: f'&nbsp;<span style="color:{colour}">●</span>' for k, colour in coloured.items()}
    return Template(resource('report_section.html')).substitute(
        heading=f'{name}{count(len(departures), "departure")}, {" to ".join(times)}',
        warnings='\n'.join(warnings),
        tiles=''.join(f'<li><b>{escape(number)}</b> {escape(text)}</li>'
                      for number, text in words.tiles(strategy)),
        options=''.join(f'<option value="{k}">{escape(f"{row[0]}: {row[1]}, {row[4]}")}</option>'
                        for k, row in enumerate(rows[1:])),
        least=f'{min(data["levels"]):.3g}', most=f'{max(data["levels"]):.3g}',
        likeliest=words.percent(float(strategy.shown_probability.max(initial=0.0))),
        waits='' if strategy.value > 0.0 else 'hidden', held='' if data['held'] > 0.0 else 'hidden',
        data=json.dumps(data, allow_nan=False).replace('<', '\\u003c'),
        departures=_table(rows, 'tall', dots),
        certificate='\n'.join(_paragraphs(words.certificate(section))),
        measures=_table(words.measures(strategy), 'better'),
        quantities=_table([(), *words.quantities(strategy)], 'small'),
        settings=_table([(), *words.settings(section)], 'small'),
    )


def _paragraphs(texts: Iterable[str]) -> list[str]:
    return [f'<p>{escape(text)}</p>' for text in texts]


def _warning(text: str) -> str:
    return f'<p class="secret"><strong>Warning.</strong> {escape(text)}</p>'


def _table(rows: Sequence[Sequence[str]], kind: str, marks: Mapping[int, str] | None = None) -> str:
    """Return a table; the first row is its head, ``marks`` are HTML after the names of rows."""
    heads = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in rows[0])
    lines = []
    for k, (name, *cells) in enumerate(rows[1:]):
        data = ''.join(f'<td>{escape(cell)}</td>' for cell in cells)
        mark = (marks or {}).get(k, '')
        lines.append(f'<tr><th scope="row">{escape(name)}{mark}</th>{data}</tr>')
    return (f'<div class="wide {kind}" tabindex="0"><table><thead><tr>{heads}</tr></thead>\n'
            '<tbody>' + '\n'.join(lines) + '</tbody></table></div>')
