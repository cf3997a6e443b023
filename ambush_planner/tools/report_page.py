"""The report as one HTML page that needs nothing else: no network, no scripts, pictures inline.

Everything that comes from files passes ``html.escape``; the Content-Security-Policy forbids
whatever might get through all the same.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape

from ..review.verify import Verdict
from . import report_words as words
from .audit_text import how_many, span
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
figure img { width: 100%; max-width: 46rem; height: auto; display: block; }
figcaption { color: #444; max-width: 46rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.93rem; min-width: 60%; }
th, td { text-align: left; padding: 0.3rem 0.7rem 0.3rem 0; border-bottom: 1px solid #ddd;
  vertical-align: top; }
thead th { border-bottom: 2px solid #888; }
tbody th { font-weight: normal; }
.better td, .better th { font-weight: bold; }
.small td, .small th { font-size: 0.85rem; }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; }
  h2, h3 { break-after: avoid; } tr { break-inside: avoid; } .wide { overflow: visible; }
  figure img { max-height: 21cm; width: auto; max-width: 100%; }
  section { break-before: page; } section:first-of-type { break-before: auto; } }
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
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
MEASURES = (
    'E is the mean length of the way. P_1 is the chance of meeting the ambusher who plays best '
    'against an unknown draw; P_inf and V_inf are chance and mean loss once he knows how this '
    'planner chooses: a fixed route he meets every time, at its worst place.'
)


def page(
    sections: Sequence[tuple[Section, Sequence[bytes]]],
    unreadable: int,
    verdicts: Sequence[Verdict],
    faults: Sequence[str],
) -> str:
    """Return the whole page.

    Parameters
    ----------
    sections
        Each with its pictures (PNG): ground, odds, routes.
    unreadable
        How many files could not be read and are missing here.
    verdicts, faults
        What verifying the files one by one and together found; empty where it was not done.
    """
    count = sum(len(section.departures) for section, _ in sections)
    title = f"Convoy routes: {count} departure{'s' * (count != 1)}"
    body = [
        _element('h1', title),
        f'<p class="secret"><strong>Secret.</strong> {escape(SECRET)}</p>',
        _element('p', ABOUT),
        *_verification(verdicts, faults),
    ]
    if unreadable:
        missing = 'Recordings that could not be read and are missing here'
        body.append(_warning(f'{missing}: {unreadable}.'))
    for number, (section, pictures) in enumerate(sections, start=1):
        several = f'Trip {number} of {len(sections)}' if len(sections) > 1 else ''
        body += ['<section>', *_section(section, pictures, several), '</section>']
    return '\n'.join((
        '<!DOCTYPE html>',
        '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="referrer" content="no-referrer"><meta name="robots" content="noindex">',
        f'<title>{escape(title)}</title>',
        f'<style>\n{STYLE}</style></head><body>',
        *body,
        '</body></html>\n',
    ))


def _verification(verdicts: Sequence[Verdict], faults: Sequence[str]) -> list[str]:
    said = words.verification(list(verdicts), list(faults))
    wrong = bool(faults) or any(not verdict.holds for verdict in verdicts)
    if wrong:
        return [_warning(said[0]), *(_element('p', each) for each in said[1:])]
    return [_element('p', each) for each in said]


def _section(section: Section, pictures: Sequence[bytes], several: str) -> list[str]:
    strategy, records = section.strategy, section.departures
    ground, odds, routes = pictures
    count = how_many(records)
    heading = (f'{several}: ' if several else '') + f'{count}, {span(records)}'
    parts = [_element('h2', heading)]
    if any(record.parameters.seed >= 0 for record in records):
        parts.append(_warning(FIXED_SEED))
    if section.strategies > 1:
        parts.append(_element('p', SEVERAL.format(section.strategies)))
    parts += [
        _tiles(words.tiles(section)), _element('p', UNITS),
        _element('h3', 'The ground'),
        _figure(ground, 'Map of the risk with start and goal',
                'The redder, the more an ambush would cost there. Black: nobody can drive.'),
        _element('h3', 'Where the convoy may drive, and where the ambusher waits'),
        _figure(odds, 'Map of the odds of each stretch, with the places of the ambusher',
                'Blue: where the convoy may drive; the darker and thicker, the likelier. Orange: '
                'where the best ambusher waits, one place at a time; the larger, the likelier. '
                'They lie where the ways are few. The grey is the risk of the picture above.'),
        _element('h3', 'The routes that were drawn'),
        _figure(routes, 'Map of the routes of the departures',
                f'{count}; each route was drawn afresh by the odds that held then. The numbers are '
                'those of the table below.'),
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
    head, *rows = words.departures(section)
    colours = section.colours()
    heads = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = []
    for number, (name, *cells) in enumerate(rows):
        dot = f'&nbsp;<span style="color:{colours[number]}">●</span>' if number in colours else ''
        data = ''.join(f'<td>{escape(cell)}</td>' for cell in cells)
        lines.append(f'<tr><th scope="row">{escape(name)}{dot}</th>{data}</tr>')
    content = '\n'.join(lines)
    return (
        f'<div class="wide"><table><thead><tr>{heads}</tr></thead>\n'
        f'<tbody>{content}</tbody></table></div>'
    )


def _element(tag: str, text: str) -> str:
    return f'<{tag}>{escape(text)}</{tag}>'


def _warning(text: str) -> str:
    return f'<p class="secret"><strong>Warning.</strong> {escape(text)}</p>'


def _tiles(tiles: Sequence[tuple[str, str]]) -> str:
    items = (f'<li><b>{escape(number)}</b> {escape(text)}</li>' for number, text in tiles)
    return f'<ul class="tiles">{"".join(items)}</ul>'


def _figure(png: bytes, alternative: str, caption: str) -> str:
    data = b64encode(png).decode('ascii')
    return (
        f'<figure><img alt="{escape(alternative)}" src="data:image/png;base64,{data}">'
        f'<figcaption>{escape(caption)}</figcaption></figure>'
    )


def _table(rows: Sequence[Sequence[str]], first: str = '') -> str:
    """A table with a head; ``first`` is the class of the first row below it."""
    head, *body = rows
    heads = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = []
    for k, (name, *cells) in enumerate(body):
        attribute = f' class="{first}"' if first and k == 0 else ''
        data = ''.join(f'<td>{escape(cell)}</td>' for cell in cells)
        lines.append(f'<tr{attribute}><th scope="row">{escape(name)}</th>{data}</tr>')
    content = '\n'.join(lines)
    return (
        f'<div class="wide"><table><thead><tr>{heads}</tr></thead>\n'
        f'<tbody>{content}</tbody></table></div>'
    )


def _pairs(rows: Sequence[tuple[str, str]]) -> str:
    lines = '\n'.join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<div class="wide small"><table><tbody>{lines}</tbody></table></div>'
