"""The report as one HTML page that needs nothing else: no network, its one script inline.

Everything that comes from files passes ``html.escape``; the Content-Security-Policy names the one
script by its hash, and forbids whatever might get through all the same.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from types import MappingProxyType

from ..recordings.verify import Verdict
from . import report_words as words
from .audit_text import span
from .cli import count
from .report_map import map_figure, script
from .report_sections import Section

STYLE = """\
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1c1714; background: #fff; margin: 0 auto;
  max-width: 58rem; padding: 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 1rem 0 0.5rem; }
h2 { font-size: 1.35rem; border-bottom: 2px solid #1146b0; margin: 2.2rem 0 0.8rem; }
h3 { font-size: 1.1rem; margin: 1.8rem 0 0.4rem; }
.secret { border: 2px solid #b00020; background: #fdf1f2; padding: 0.6rem 0.9rem; }
.secret strong { color: #b00020; }
.tiles { display: flex; flex-wrap: wrap; gap: 0.7rem; padding: 0; list-style: none; }
.tiles li { flex: 1 1 11rem; border: 1px solid #c9c9c9; border-top: 4px solid #1146b0;
  padding: 0.5rem 0.8rem; }
.tiles b { display: block; font-size: 1.6rem; }
figure { margin: 1.2rem 0; break-inside: avoid; }
figcaption { color: #444; max-width: 46rem; }
.map .controls { display: flex; flex-wrap: wrap; align-items: center;
  gap: 0.4rem 1.2rem; padding: 0.3rem 0; }
.map label { white-space: nowrap; padding: 0.2rem 0.4rem 0.2rem 0; }
.map .controls > label { display: flex; align-items: center; gap: 0.4rem; max-width: 100%; }
.map input { width: 1.1rem; height: 1.1rem; vertical-align: -0.15rem; margin-right: 0.25rem; }
.map button, .map select { font: inherit; min-height: 2rem; min-width: 2rem; }
.map .canvas { position: relative; overflow: hidden; line-height: 0; }
.map canvas { width: 100%; touch-action: none; cursor: crosshair; background: #eee; }
.map canvas:focus-visible { outline: 3px solid #1146b0; outline-offset: -3px; }
.map .reach { display: none; position: absolute; transform: translate(-50%, -50%);
  border: 1.5px solid #e66100; border-radius: 50%; box-sizing: border-box; pointer-events: none;
  min-width: 8px; min-height: 8px; }
.map .readout { min-height: 3rem; margin: 0.4rem 0; }
.legend { list-style: none; padding: 0; margin: 0.4rem 0; display: flex; flex-wrap: wrap;
  gap: 0.2rem 1.4rem; }
.legend i { display: inline-block; width: 1rem; height: 1rem; margin-right: 0.4rem;
  vertical-align: -0.15rem; box-sizing: border-box; outline: 1px solid #999; }
.wide { overflow-x: auto; }
.tall { overflow-y: auto; max-height: 36rem; }
table { border-collapse: collapse; font-size: 0.93rem; min-width: 60%; }
th, td { text-align: left; padding: 0.3rem 0.7rem 0.3rem 0; border-bottom: 1px solid #ddd;
  vertical-align: top; }
thead th { border-bottom: 2px solid #888; }
tbody th { font-weight: normal; }
.better tbody tr:first-child * { font-weight: bold; }
.small td, .small th { font-size: 0.85rem; }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; }
  h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
  .wide { overflow: visible; max-height: none; }
  .map .controls, .map .readout { display: none; }
  section { break-before: page; } section:first-of-type { break-before: auto; } }
"""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{}'"
SECRET = (
    'This page shows where convoys drive and drove. Whoever has it knows the routes of past '
    'departures and the odds of coming ones. Treat it like the recordings that it was made from: '
    'keep it off shared disks and chats, and delete it when it has been read.'
)
ABOUT = (
    'A convoy drives between the same two places again and again, and an ambusher may be waiting. '
    'A route that is driven twice can be learnt. The planner therefore worked out odds: how '
    'likely each stretch of ground is driven, so that the best ambush does the least harm. For '
    'each departure one route was drawn by these odds. This page shows the ground, the odds, the '
    'routes that were drawn, and how much safety can be promised.'
)
UNITS = (
    'Losses are in the units of the risk map: they say how bad places are compared with each '
    'other, as set by map.alpha_min and map.alpha_max.'
)
SEVERAL = (
    'The start, the goal or the settings moved a little, so that {} strategies were worked out for '
    'this trip. Odds and numbers here are those of the latest; the table has the mean loss of each.'
)
FIXED_SEED = (
    'At least one of these departures was drawn with a fixed seed: whoever knows the seed can '
    'foretell such routes. Use fixed seeds for tests only.'
)
MAP = (
    'Grey: the darker, the more an ambush would cost there. Blue: where the convoy may drive; the '
    'darker and thicker, the likelier. Orange: where the best ambusher waits, one place at a time; '
    'these lie where the ways are few. Each route was drawn afresh by the odds that held then; '
    'colours and numbers are those of the table below, and thin lines are earlier departures.'
)
MEASURES = (
    'E is the mean length of the way. P_1 is the chance of meeting the ambusher who plays best '
    'against an unknown draw; P_inf and V_inf are chance and mean loss once he knows how this '
    'planner chooses: a fixed route he meets every time, at its worst place.'
)


def page(
    sections: Sequence[Section],
    unreadable: int,
    verdicts: Sequence[Verdict],
    faults: Sequence[str],
) -> str:
    """Return the whole page.

    Parameters
    ----------
    sections
        One for each trip.
    unreadable
        How many files could not be read and are missing here.
    verdicts, faults
        What verifying the files one by one and together found; empty where it was not done.
    """
    departures = sum(len(section.departures) for section in sections)
    title = f'Convoy routes: {count(departures, "departure")}'
    body = [
        _element('h1', title),
        f'<p class="secret"><strong>Secret.</strong> {escape(SECRET)}</p>',
        _element('p', ABOUT),
        *_verification(verdicts, faults),
    ]
    if unreadable:
        missing = 'Recordings that could not be read and are missing here'
        body.append(_warning(f'{missing}: {unreadable}.'))
    for number, section in enumerate(sections, start=1):
        several = f'Trip {number} of {len(sections)}' if len(sections) > 1 else ''
        body += ['<section>', *_section(section, several), '</section>']
    policy = POLICY.format(b64encode(hashlib.sha256(script().encode()).digest()).decode('ascii'))
    return '\n'.join((
        '<!DOCTYPE html>',
        '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="referrer" content="no-referrer"><meta name="robots" content="noindex">',
        f'<title>{escape(title)}</title>',
        f'<style>\n{STYLE}</style></head><body>',
        *body,
        f'<script>{script()}</script></body></html>\n',
    ))


def _verification(verdicts: Sequence[Verdict], faults: Sequence[str]) -> list[str]:
    said = words.verification(list(verdicts), list(faults))
    wrong = bool(faults) or any(not verdict.holds for verdict in verdicts)
    if wrong:
        return [_warning(said[0]), *(_element('p', each) for each in said[1:])]
    return [_element('p', each) for each in said]


def _section(section: Section, several: str) -> list[str]:
    strategy, records = section.strategy, section.departures
    heading = f'{count(len(records), "departure")}, {span(records)}'
    parts = [_element('h2', f'{several}: {heading}' if several else heading)]
    if any(record.parameters.seed >= 0 for record in records):
        parts.append(_warning(FIXED_SEED))
    if section.strategies > 1:
        parts.append(_element('p', SEVERAL.format(section.strategies)))
    parts += [
        _tiles(words.tiles(section)), _element('p', UNITS),
        _element('h3', 'The ground, the odds and the routes'),
        map_figure(section),
        _element('p', MAP),
        _element('h3', 'Departures'),
        _departures(section),
        _element('h3', 'What is promised'),
        *(_element('p', sentence) for sentence in words.certificate(section)),
        _element('h3', 'Beside planners that leave no choice'),
        _table(words.measures(strategy), 'better'),
        _element('p', MEASURES),
        _element('h3', 'The strategy in numbers'),
        _pairs(words.quantities(strategy)),
        _element('h3', 'Settings of the planner'),
        _pairs(words.settings(section)),
        _element('h3', 'Where this comes from'),
        _pairs(words.origins(section)),
    ]
    return parts


def _departures(section: Section) -> str:
    """The table of departures; those in colours have a dot of theirs."""
    dots = {
        row: f'&nbsp;<span style="color:{colour}">●</span>'
        for row, colour in section.colours().items()
    }
    return _table(words.departures(section), 'tall', dots)


def _element(tag: str, text: str) -> str:
    return f'<{tag}>{escape(text)}</{tag}>'


def _warning(text: str) -> str:
    return f'<p class="secret"><strong>Warning.</strong> {escape(text)}</p>'


def _tiles(tiles: Sequence[tuple[str, str]]) -> str:
    items = (f'<li><b>{escape(number)}</b> {escape(text)}</li>' for number, text in tiles)
    return f'<ul class="tiles">{"".join(items)}</ul>'


def _table(
    rows: Sequence[Sequence[str]], kind: str, marks: Mapping[int, str] = MappingProxyType({})
) -> str:
    """A table with a head; ``marks`` is the HTML behind the name of a row below it."""
    head, *body = rows
    heads = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = []
    for k, (name, *cells) in enumerate(body):
        data = ''.join(f'<td>{escape(cell)}</td>' for cell in cells)
        lines.append(f'<tr><th scope="row">{escape(name)}{marks.get(k, "")}</th>{data}</tr>')
    content = '\n'.join(lines)
    return (
        f'<div class="wide {kind}" tabindex="0"><table><thead><tr>{heads}</tr></thead>\n'
        f'<tbody>{content}</tbody></table></div>'
    )


def _pairs(rows: Sequence[tuple[str, str]]) -> str:
    lines = '\n'.join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<div class="wide small"><table><tbody>{lines}</tbody></table></div>'
