# SPDX-License-Identifier: Apache-2.0
"""The map on a driver's sheet, at a round scale: the ground around the only route on it.

It is a picture in SVG, which takes no drawing program, so that a departure is drawn at once.
"""

from __future__ import annotations

import struct
import zlib
from base64 import b64encode
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray
from ..colours import ENDS, OBSTACLE, PROBABILITY, RISK
from ..labels import Labels
from ..maps.risk_map import RiskMap
from ..maps.road_file import RoadGraph
from ..maps.road_tags import ROUNDABOUT
from ..routes.legs import distances_along
from ..rulers import north, scale_bar, ticks

if TYPE_CHECKING:
    from .card_page import Card

# Width of the map without its margins, those margins (left, top, right, bottom), and least space
# around the route [mm].
WIDTH, MARGINS, SPACE = 160.0, (14.0, 2.0, 12.0, 6.0), 10.0
_POINT = 25.4 / 72.0  # mm
# Scales, times any power of ten.
_SCALES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.5)
# Sizes of text [points]: of numbers and ends, where there are many of them, and of roads; and the
# mean width of a bold letter, as a share of that.
_FONT, _CROWDED, _SMALL, _MANY, _LETTER = 8.5, 7.0, 7.0, 20, 0.64
# Half the size of the marks of ends and of way points [mm], and how many roads are named at most.
_END, _MARK, _NAMED = 2.2, 0.8, 30
# Distance of points along the route that labels keep off [mm].
_BUSY = 0.8
# Dots of the ground in a millimetre, and from one line of a hatch to the next.
_DOTS, _HATCH = 6, 9
# Places of a palette after the grades of risk: obstacle and unknown ground, each with its hatch.
_GRADES, _BLOCKED, _UNKNOWN = 251, 251, 253
_STYLE = f"""
text {{ font-family: sans-serif; font-size: {_SMALL * _POINT:.2f}px; text-anchor: middle; }}
.name {{ font-weight: bold; }} .place {{ font-style: italic; }}
.over {{ stroke: white; stroke-width: .8px; stroke-linejoin: round; paint-order: stroke; }}
path, polyline, circle {{ fill: none; stroke: black; stroke-linejoin: round;
  stroke-linecap: round; }}
.halo {{ stroke: white; }}
.road {{ stroke: #555; stroke-width: .5px; }} .road.halo {{ stroke: white; stroke-width: 1.1px; }}
.route {{ stroke: {PROBABILITY[2]}; stroke-width: 1px; }}
.route.halo {{ stroke: white; stroke-width: 1.8px; }}
.bar {{ stroke-width: 1px; stroke-linecap: butt; }} .north {{ fill: black; stroke-width: .5px; }}
.bar.halo {{ stroke: white; stroke-width: 1.8px; }}
.secured {{ stroke-width: .4px; stroke-dasharray: 1.6 1.2; }}
.leader {{ stroke-width: .35px; stroke-dasharray: .1 .9; }}
.end {{ fill: {ENDS}; stroke-width: .3px; }} .mark {{ fill: white; stroke-width: .35px; }}
rect {{ fill: white; stroke: #666; stroke-width: .2px; }}
"""


@dataclass(frozen=True)
class CardMap:
    """A picture in SVG with its width on paper [mm] and its scale, such as 1:50 000."""

    svg: str
    width: float
    scale: str


def card_map(card: Card, height: float) -> CardMap:
    """Draw the map of a card, at most ``height`` [mm] high without its margins."""
    size = np.array((WIDTH, height))
    low, high = card.path.min(axis=0), card.path.max(axis=0)
    least = float(((high - low) / (size - 2.0 * SPACE)).max()) * 1000.0
    power = 10.0 ** float(np.floor(np.log10(least)))
    scale = power * next((each for each in _SCALES if each * power >= least), 10.0)
    metres = scale / 1000.0  # in a millimetre
    # Around the path's middle, moved or cut so as to be on the map.
    first, last = card.risk_map.bounds
    extent = np.minimum(size * metres, last - first)
    corner = np.clip((low + high - extent) / 2.0, first, last - extent)
    sheet = _Sheet(np.array((corner, corner + extent)), metres)
    if card.roads is not None:
        pieces = card.roads.points[card.roads.pairs]
        near = (pieces.min(axis=1) < sheet.box[1]) & (pieces.max(axis=1) > sheet.box[0])
        steps = ''.join(f'M{x:.2f} {y:.2f}L{u:.2f} {v:.2f}'
                        for (x, y), (u, v) in sheet.at(pieces[near.all(axis=1)]).tolist())
        sheet.parts.extend(f'<path class="road{halo}" d="{steps}"/>' for halo in (' halo', ''))
    sheet.line(card.path, 'route', halo=True)
    bar = scale_bar(sheet.box, card.path)
    (left, bottom), length = bar.xy, bar.length
    sheet.line(np.array([(left, bottom), (left + length, bottom)]), 'bar', halo=True)
    aside = 2.4 if bar.is_low else -2.6
    middle = np.array((left + length / 2.0, bottom + aside * metres))
    sheet.text(bar.text, middle, 'name over')
    _draw_ends(sheet, card)
    tall = 4.2 * metres
    _label(sheet, card, np.array((left, bottom - tall * (not bar.is_low), left + length,
                                  bottom + tall * bar.is_low)))
    return CardMap(_framed(sheet, card.risk_map),
                   float(sheet.size[0] + MARGINS[0] + MARGINS[2]),
                   f'1:{scale:,.0f}'.replace(',', ' '))


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The parts of a picture of a ``box`` (2, 2) [m], in which ``metres`` are a millimetre."""

    box: FloatArray
    metres: float
    parts: list[str] = field(default_factory=list)

    @property
    def size(self) -> FloatArray:
        """Width and height [mm]."""
        return np.asarray((self.box[1] - self.box[0]) / self.metres)

    def at(self, xy: npt.ArrayLike) -> FloatArray:
        """World positions (..., 2) [m] on the paper, from the upper left corner [mm]."""
        corner = self.box[0, 0], self.box[1, 1]
        return (np.asarray(xy) - corner) / self.metres * (1.0, -1.0)

    def line(self, xy: FloatArray, kind: str, halo: bool = False) -> None:
        """Draw a line (L, 2) [m]."""
        points = ' '.join(f'{x:.2f},{y:.2f}' for x, y in self.at(xy).tolist())
        self.parts.extend(f'<polyline class="{kind}{more}" points="{points}"/>'
                          for more in (' halo', '')[not halo:])

    def mark(self, xy: npt.ArrayLike, kind: str, steps: str) -> None:
        """Draw the steps [mm] of a path around a place [m]."""
        x, y = self.at(xy).tolist()
        self.parts.append(f'<path class="{kind}" transform="translate({x:.2f} {y:.2f})" '
                          f'd="{steps}"/>')

    def disc(self, xy: npt.ArrayLike, radius: float, kind: str) -> None:
        """Draw a circle with a radius [mm] around a place [m]."""
        x, y = self.at(xy).tolist()
        self.parts.append(f'<circle class="{kind}" cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}"/>')

    def text(self, text: str, xy: npt.ArrayLike, kind: str, font: float = _SMALL) -> None:
        """Write a text around a place [m]."""
        x, y = self.at(xy).tolist()
        self.parts.append(f'<text class="{kind}" x="{x:.2f}" y="{y + 0.36 * font * _POINT:.2f}" '
                          f'style="font-size: {font * _POINT:.2f}px">{escape(text)}</text>')

    def size_of(self, text: str, font: float) -> FloatArray:
        """Width and height of a text [m]."""
        return np.array((_LETTER * len(text) + 0.5, 1.4)) * font * _POINT * self.metres


def _framed(sheet: _Sheet, risk_map: RiskMap) -> str:
    """The picture: the ground below all parts, and around it ticks and north."""
    (width, height), (left, top, right, bottom) = sheet.size.tolist(), MARGINS
    around = [f'<path d="M0 0H{width:.2f}V{height:.2f}H0Z" stroke-width=".25"/>']
    along, unit = ticks(risk_map, sheet.box, 4)
    for (at, texts), is_x in zip(along, (True, False), strict=True):
        for place, text in zip(at.tolist(), texts, strict=True):
            x, y = sheet.at((place, place)).tolist()
            text += f' {unit}'
            where = f'x="{x:.2f}" y="{height + 4.2:.2f}"' if is_x else (
                f'x="-1.2" y="{y + 0.8:.2f}" style="text-anchor: end"')
            around.append(f'<text {where}>{text}</text>')
    if (away := north(risk_map.crs, sheet.box.mean(axis=0))) is not None:
        turn = np.degrees(np.arctan2(*away))
        around.append(f'<g transform="translate({width + 6.0:.2f} 14) rotate({turn:.1f})">'
                      '<path class="north" d="M0 3.5V-2M0-4.5L-1.3-1.5H1.3Z"/>'
                      '<text class="name" y="7">N</text></g>')
    ground = b64encode(_ground(risk_map, sheet)).decode()
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="{-left} {-top} {left + width + right:.2f} {top + height + bottom:.2f}">'
        f'<style>{_STYLE}</style><clipPath id="map"><path d="M0 0H{width:.2f}V{height:.2f}H0Z"/>'
        f'</clipPath><image width="{width:.2f}" height="{height:.2f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{ground}"/><g clip-path="url(#map)">'
        f'{"".join(sheet.parts)}</g>{"".join(around)}</svg>')


def _ground(risk_map: RiskMap, sheet: _Sheet) -> bytes:
    """The ground as a PNG file: the darker, the more dangerous; obstacles and unknown hatched."""
    columns, rows = np.maximum(np.rint(sheet.size * _DOTS), 1).astype(int).tolist()
    part = _cropped(risk_map, sheet.box).coarser(max(columns, rows))
    across, down = np.meshgrid((np.arange(columns) + 0.5) / columns,
                               (np.arange(rows)[::-1] + 0.5) / rows)
    uv = part.to_map_axes(sheet.box[0] + np.stack((across, down), axis=-1)
                          * (sheet.box[1] - sheet.box[0]))
    cells = part.cells(uv)
    least, most = part.loss_range or (0.0, 0.0)
    dots = np.rint((part.alpha[cells] - least) / (most - least or 1.0) * (_GRADES - 1))
    dots = np.where(part.obstacles[cells], _BLOCKED, dots)
    unknown = ~part.contains(uv)
    if part.unknown is not None:
        unknown |= part.unknown[cells]
    dots = np.where(unknown, _UNKNOWN, dots).astype(np.uint8)
    hatch = (np.add.outer(np.arange(rows), np.arange(columns)) % _HATCH == 0) & (dots >= _BLOCKED)
    white, dark = (np.array([*bytes.fromhex(each[1:])]) for each in RISK)
    shades = np.linspace(white, dark, _GRADES).round().astype(np.uint8).tobytes()
    others = bytes.fromhex(f'{OBSTACLE}ffffff''f2f2f2''a8a8a8'.replace('#', ''))
    return _png(dots + hatch, shades + others)


def _png(dots: npt.NDArray[np.uint8], palette: bytes) -> bytes:
    """A PNG file of dots (H, W), each a place in a palette of red, green and blue bytes."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        check = zlib.crc32(kind + data)
        return struct.pack('>I', len(data)) + kind + data + struct.pack('>I', check)

    rows, columns = dots.shape
    lines = np.pad(dots, ((0, 0), (1, 0)))  # each line begins with the number of its filter, 0
    return (b'\x89PNG\r\n\x1a\n'
            + chunk(b'IHDR', struct.pack('>IIBBBBB', columns, rows, 8, 3, 0, 0, 0))
            + chunk(b'PLTE', palette) + chunk(b'IDAT', zlib.compress(lines.tobytes(), 6))
            + chunk(b'IEND', b''))


def _cropped(risk_map: RiskMap, box: FloatArray) -> RiskMap:
    """The cells of a map that a box of world positions meets."""
    (left, low), (right, high) = box
    corners = risk_map.to_map_axes([(left, low), (right, low), (right, high), (left, high)])
    shape = np.array(risk_map.alpha.shape)[::-1]
    first = np.clip(np.floor(corners.min(axis=0) / risk_map.resolution), 0, shape - 1).astype(int)
    last = np.clip(np.ceil(corners.max(axis=0) / risk_map.resolution), first + 1, shape).astype(int)
    return risk_map.part(slice(first[1], last[1]), slice(first[0], last[0]))


def _draw_ends(sheet: _Sheet, card: Card) -> None:
    """Mark start (square), stops (diamonds) and goal (star), and the secured area around them."""
    angles = np.pi * np.arange(10) / 5.0
    far = _END * np.where(np.arange(10) % 2, 0.42, 1.1)
    star = 'M' + 'L'.join(f'{x:.2f} {y:.2f}' for x, y in zip(
        far * np.sin(angles), -far * np.cos(angles), strict=True)) + 'Z'
    stops = ['M0-1.8L1.8 0L0 1.8L-1.8 0Z'] * (len(card.places) - 2)
    for place, steps in zip(card.places, ['M-1.5-1.5H1.5V1.5H-1.5Z', *stops, star], strict=True):
        if card.secured_distance > 0.0:
            sheet.disc(place, card.secured_distance / sheet.metres, 'secured')
        sheet.mark(place, 'end', steps)


def _label(sheet: _Sheet, card: Card, bar: FloatArray) -> None:
    """Name start, stops and goal, number the way points, and name roads and places.

    Names keep off the ``bar`` (left, bottom, right, top), too.
    """
    metres, along = sheet.metres, distances_along(card.path)
    at = np.arange(0.0, along[-1], _BUSY * metres)
    busy = np.column_stack([np.interp(at, along, axis) for axis in card.path.T])
    taken = np.vstack((bar, *(np.hstack((xy - size * metres, xy + size * metres)) for xy, size in (
        (card.places, _END), (card.points, _MARK)))))
    font = _FONT if len(card.way_points) <= _MANY else _CROWDED
    labels = Labels(sheet.box, busy, taken)

    def annotate(text: str, xy: FloatArray, size: FloatArray, gap: float, is_round: bool) -> None:
        """Write next to a place, with a thin dotted leader if it is farther than a gap [mm]."""
        spot = labels.place(xy, size, gap * metres, is_round)
        if (np.abs(spot - xy) > size / 2.0 + 1.5 * gap * metres).any():
            sheet.line(np.array((xy, spot)), 'leader')
        if is_round:
            sheet.disc(spot, float(size[0]) / metres / 2.0, 'mark')
        sheet.text(text, spot, 'name' if is_round else 'name over', font)

    numbered = [*enumerate(card.way_points, start=1)]
    for number, each in numbered:
        if each.name:
            text = f'{number} {each.name}'
            annotate(text, each.xy, sheet.size_of(text, font), 1.1 * _END, False)
    round_size = np.full(2, 1.75 * font * _POINT * metres)
    for number, each in numbered:
        if not each.name:
            sheet.disc(each.xy, _MARK, 'mark')
            annotate(str(number), each.xy, round_size, 1.6 * _MARK, True)
    if card.roads is None:
        return
    for name, places in _named_roads(card.roads, sheet.box):
        size = sheet.size_of(name, _SMALL)
        if (spot := labels.choose(places, size)) is not None:
            (x, y), (wide, high) = sheet.at(spot), size / metres
            sheet.parts.append(f'<rect x="{x - wide / 2.0:.2f}" y="{y - high / 2.0:.2f}" '
                               f'width="{wide:.2f}" height="{high:.2f}" rx=".5"/>')
            sheet.text(name, spot, 'shield')
    for x, y, name in card.roads.places[_inside(card.roads.places[:, :2], sheet.box)]:
        text = card.roads.names[int(name)]
        if (spot := labels.choose(np.array([(x, y)]), sheet.size_of(text, _SMALL))) is not None:
            sheet.text(text, spot, 'place over')


def _named_roads(roads: RoadGraph, box: FloatArray) -> list[tuple[str, FloatArray]]:
    """The names of the longest roads in a box, and places (C, 2) on each."""
    middles = roads.points[roads.pairs].mean(axis=1)
    lengths = np.hypot(*(roads.points[roads.pairs[:, 1]] - roads.points[roads.pairs[:, 0]]).T)
    shown = _inside(middles, box) & (roads.name >= 0)
    longest = np.argsort(-np.bincount(roads.name[shown], lengths[shown], len(roads.names)))
    return [(roads.names[k], middles[shown & (roads.name == k)]) for k in longest[:_NAMED].tolist()
            if roads.names[k] not in ('', ROUNDABOUT) and (shown & (roads.name == k)).any()]


def _inside(xy: FloatArray, box: FloatArray) -> BoolArray:
    return np.asarray(((xy > box[0]) & (xy < box[1])).all(axis=1))
