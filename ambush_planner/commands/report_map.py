"""The report's map of a trip: data and markup; ``report_map.js`` draws it in the browser."""

from __future__ import annotations

import json
import math
import zlib
from base64 import b64encode
from html import escape
from importlib import resources

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..maps.risk_map import RiskMap
from . import report_words as words
from .report_sections import Section

# Larger maps are shown by the worst losses of blocks of cells.
MOST_CELLS = 2000
OBSTACLE = 255
# Stretches that are driven less often do not count at the pointer.
LEAST = 1e-7
TEMPLATE = """\
<figure class="map"><div class="controls"><span>Show:
<label><input type="checkbox" data-layer="risk" checked>risk</label>
<label><input type="checkbox" data-layer="chances" checked>odds</label>
<label><input type="checkbox" data-layer="sites" checked>ambusher</label>
<label><input type="checkbox" data-layer="routes" checked>routes</label></span>
<label>Route: <select><option value="all">of all departures</option>{options}</select></label>
<span><button type="button" data-zoom="in" aria-label="zoom in">+</button>
<button type="button" data-zoom="out" aria-label="zoom out">&minus;</button>
<button type="button" data-zoom="all">whole map</button></span></div>
<div class="canvas"><canvas tabindex="0" role="application" aria-label="Map of risk, odds, \
places of the ambusher and routes. Arrow keys move it, plus and minus zoom, 0 shows all; numbers \
are those of its centre."></canvas><div class="reach"></div></div>
<p class="readout" aria-live="polite">Point at a place to see what an ambush there would cost. \
Drag to move; click the map, and the wheel zooms; or use the arrow keys, + and &minus;.</p>
<noscript><p>The map needs JavaScript. Everything else on this page does without.</p></noscript>
<ul class="legend">
<li><i style="width:4rem;background:linear-gradient(90deg,#fff,#848484)"></i>loss if ambushed \
here: {least} to {most}</li>
<li><i style="background:#3a3531"></i>impassable</li>
<li><i style="width:4rem;background:linear-gradient(90deg,#7fb8e6,#2f7fd0,#1146b0,#14075c)"></i>\
chance that a departure drives here: 0.1 % to {likeliest}</li>
{waits}{held}</ul>
<script type="application/json">{data}</script></figure>
"""
WAITS = (
    '<li><i style="background:#e66100;border-radius:50%"></i>here the best ambusher waits: the '
    'larger, the likelier</li>\n'
)
HELD = (
    '<li><i style="border:2px dashed #000;border-radius:50%"></i>held ground: nobody can wait '
    'here</li>\n'
)


def script() -> str:
    """What draws the maps."""
    return resources.files(__package__).joinpath('report_map.js').read_text('utf-8')


def map_figure(section: Section) -> str:
    """The explorable map of a trip as HTML: its ground, its latest strategy, all its routes."""
    data = map_data(section)
    options = ''.join(
        f'<option value="{k}">{escape(name)}</option>' for k, name in enumerate(_names(section))
    )
    chances = section.strategy.edge_probability
    return TEMPLATE.format(
        options=options,
        least=f'{min(data["levels"]):.3g}',
        most=f'{max(data["levels"]):.3g}',
        likeliest=words.percent(float(chances.max(initial=0.0))),
        waits=WAITS if section.strategy.value > 0.0 else '',
        held=HELD if data['held'] > 0.0 else '',
        data=json.dumps(data, allow_nan=False).replace('<', '\\u003c'),
    )


def map_data(section: Section) -> dict[str, object]:
    """What the script draws and measures; positions count from the map's corner [m].

    Arrays are deflated, little-endian and base64; ``levels`` are the losses that ``cells`` number.
    """
    risk_map, strategy = section.risk_map, section.strategy
    network, game = strategy.network, strategy.game
    ends = [network.source, network.target, *network.stops]
    secured = section.departures[-1].parameters.planning.game.secured_radius
    cells, levels, cell = _cells(risk_map)
    used = np.flatnonzero(strategy.edge_probability > LEAST)
    corner = np.array(risk_map.origin[:2])
    width, height = risk_map.size
    corners = risk_map.to_world([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    routes = [each.strategy.network.points[each.route] - corner for each in section.departures]
    colours = section.colours()
    return {
        'columns': cells.shape[1], 'rows': cells.shape[0], 'cell': cell, 'levels': levels,
        'origin': corner.tolist(), 'yaw': risk_map.origin[2],
        'box': [*(corners.min(0) - corner).tolist(), *(corners.max(0) - corner).tolist()],
        'ends': (network.points[ends] - corner).tolist(),
        'reach': game.ambush_radius, 'held': max(secured, game.ambush_radius),
        'value': strategy.value,
        'cells': _packed(cells, 'u1'), 'points': _packed(network.points - corner, '<f4'),
        'edges': _packed(network.edges[used], '<u4'),
        'chances': _packed(strategy.edge_probability[used], '<f4'),
        'sites': _packed(_sites(section) - [*corner, 0.0], '<f4'),
        'routes': _packed(np.concatenate(routes), '<f4'), 'counts': [len(r) for r in routes],
        'colours': [colours.get(k) for k in range(len(routes))],
    }


def _cells(risk_map: RiskMap) -> tuple[npt.NDArray[np.uint8], list[float], float]:
    """Cells by number of their loss, the losses, and the edge of a cell [m]."""
    block = math.ceil(max(risk_map.alpha.shape) / MOST_CELLS)
    free = ~risk_map.obstacles
    alpha = _blocks(np.maximum, np.where(free, risk_map.alpha, 0.0), block)
    obstacles = _blocks(np.logical_and, risk_map.obstacles, block)
    levels = np.unique(alpha[~obstacles]) if not obstacles.all() else np.zeros(1)
    if len(levels) > OBSTACLE:
        levels = np.linspace(levels[0], levels[-1], OBSTACLE)
    middle = (levels[1:] + levels[:-1]) / 2.0
    number = np.where(obstacles, OBSTACLE, np.searchsorted(middle, alpha))
    return number.astype(np.uint8), levels.tolist(), block * risk_map.resolution


def _blocks(function: np.ufunc, cells: npt.NDArray[np.generic], block: int) -> FloatArray:
    for axis in (0, 1):
        cells = function.reduceat(cells, np.arange(0, cells.shape[axis], block), axis=axis)
    return cells


def _sites(section: Section) -> FloatArray:
    """Where the ambusher waits, and how likely beside the likeliest place (K, 3)."""
    q, points = section.strategy.ambush_probability, section.strategy.network.points
    most = q.max(initial=0.0) if section.strategy.value > 0.0 else 0.0
    at = np.flatnonzero(q > 1e-3 * most) if most > 0.0 else np.empty(0, np.int64)
    return np.column_stack((points[at], q[at] / most if most > 0.0 else q[at]))


def _packed(array: npt.ArrayLike, kind: str) -> str:
    return b64encode(zlib.compress(np.ascontiguousarray(array, kind).tobytes())).decode('ascii')


def _names(section: Section) -> list[str]:
    """The departures by their numbers in the table."""
    _, *rows = words.departures(section)
    return [f'{number}: {time}, {length}' for number, time, _, _, _, length, _ in rows]
