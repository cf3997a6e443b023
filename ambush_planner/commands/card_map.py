# SPDX-License-Identifier: Apache-2.0
"""The map on a driver's sheet, at a round scale: the ground around the only route on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.textpath import TextPath

from .. import figures, map_figures
from ..arrays import BoolArray, FloatArray
from ..colours import PROBABILITY
from ..labels import Labels
from ..maps.risk_map import RiskMap
from ..maps.road_file import RoadGraph
from ..maps.road_tags import ROUNDABOUT
from ..routes.legs import distances_along

if TYPE_CHECKING:
    from .card_page import Card

_ROUTE = PROBABILITY[2]
# Width of the map without its margins, those margins (left, bottom, right, top), and least space
# around the route [mm].
WIDTH, MARGINS, SPACE = 160.0, (14.0, 6.0, 12.0, 2.0), 10.0
_INCH, _POINT = 25.4, 25.4 / 72.0  # mm
# Scales, times any power of ten.
_SCALES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.5)
# Sizes of text [points]: of numbers and ends, where there are many of them, and of roads.
_FONT, _CROWDED, _SMALL, _MANY = 8.5, 7.0, 7.0, 20
# Half the size of the marks of ends and of way points [mm], and how many roads are named at most.
_END, _MARK, _NAMED = 2.2, 1.2, 30
# Distance of points along the route that labels keep off [mm].
_BUSY = 0.8


@dataclass(frozen=True)
class CardMap:
    """A picture with its width on paper [mm] and its scale, such as 1:50 000."""

    png: bytes
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
    box = np.array((corner, corner + extent))
    width, height = (box[1] - box[0]) / metres
    left, bottom, right, top = MARGINS
    full = np.array((left + width + right, bottom + height + top))
    figure = Figure(full / _INCH)
    axes = figure.add_axes((left / full[0], bottom / full[1], width / full[0], height / full[1]))
    map_figures.frame(axes, card.risk_map, box=box)
    map_figures.draw_risk_map(axes, cropped(card.risk_map, box))
    map_figures.north_arrow(axes, card.risk_map.crs)
    bar = map_figures.scale_bar(axes, card.path)
    if card.roads is not None:
        map_figures.draw_roads(axes, card.roads)
    axes.plot(*card.path.T, color=_ROUTE, linewidth=3.0, zorder=4, path_effects=[
        Stroke(linewidth=5.0, foreground='white'), Normal()])
    figures.draw_places(axes, card.places, card.secured_distance, named=False)
    _label(axes, card, box, metres, bar)
    return CardMap(map_figures.as_png(figure, tight=False), float(full[0]),
                   f'1:{scale:,.0f}'.replace(',', ' '))


def cropped(risk_map: RiskMap, box: FloatArray) -> RiskMap:
    """The cells of a map that a box of world positions meets."""
    (left, low), (right, high) = box
    corners = risk_map.to_map_axes([(left, low), (right, low), (right, high), (left, high)])
    shape = np.array(risk_map.alpha.shape)[::-1]
    first = np.clip(np.floor(corners.min(axis=0) / risk_map.resolution), 0, shape - 1).astype(int)
    last = np.clip(np.ceil(corners.max(axis=0) / risk_map.resolution), first + 1, shape).astype(int)
    return risk_map.part(slice(first[1], last[1]), slice(first[0], last[0]))


@dataclass(frozen=True)
class _Writer:
    """Labels on the map; ``metres`` is what a millimetre of paper is on the ground."""

    axes: Axes
    labels: Labels
    metres: float
    font: float

    def size(self, text: str, font: float) -> FloatArray:
        """Width and height of a text [m]."""
        extent = TextPath((0.0, 0.0), text, size=font, prop={'weight': 'bold'}).get_extents()
        return np.array((extent.width + 0.5 * font, 1.4 * font)) * _POINT * self.metres

    def beside(self, text: str, xy: FloatArray, size: FloatArray, gap: float,
               is_round: bool = False, **style: Any) -> None:
        """Write next to a place, with a thin dotted leader if it is farther than a gap [mm]."""
        spot = self.labels.beside(xy, size, gap * self.metres, is_round)
        leader = {'arrowstyle': '-', 'color': 'black', 'linestyle': ':', 'linewidth': 1.0,
                  'shrinkA': 0.0, 'shrinkB': 0.0}
        far = (np.abs(spot - xy) > size / 2.0 + 1.5 * gap * self.metres).any()
        self.axes.annotate(text, tuple(xy), tuple(spot), ha='center', va='center', weight='bold',
                           fontsize=self.font, arrowprops=leader if far else None, zorder=10,
                           **style)

    def on(self, text: str, places: FloatArray, **style: Any) -> None:
        """Write on one of some places (C, 2), unless the text would cover others."""
        if (spot := self.labels.on(places, self.size(text, _SMALL))) is not None:
            self.axes.text(*spot, text, ha='center', va='center', fontsize=_SMALL, zorder=9,
                           **style)


def _label(axes: Axes, card: Card, box: FloatArray, metres: float, bar: FloatArray) -> None:
    """Name start, stops and goal, number the way points, and name roads and places."""
    along = distances_along(card.path)
    at = np.arange(0.0, along[-1], _BUSY * metres)
    busy = np.column_stack([np.interp(at, along, axis) for axis in card.path.T])
    taken = np.vstack((bar, *(np.hstack((xy - size * metres, xy + size * metres)) for xy, size in (
        (card.places, _END), (card.points, _MARK)))))
    font = _FONT if len(card.way_points) <= _MANY else _CROWDED
    write = _Writer(axes, Labels(box, busy, taken), metres, font)
    for number, each in enumerate(card.way_points, start=1):
        if each.name:
            text = f'{number} {each.name}'
            write.beside(text, each.xy, write.size(text, font), 1.1 * _END,
                         path_effects=map_figures.HALO)
    round_size = np.full(2, 2.1 * font * _POINT * metres)
    for number, each in enumerate(card.way_points, start=1):
        if not each.name:
            axes.plot(*each.xy, marker='o', markersize=4.5, color='white', markeredgecolor='black',
                      zorder=6)
            write.beside(str(number), each.xy, round_size, 1.1 * _MARK, True, bbox={
                'boxstyle': 'circle,pad=0.2', 'facecolor': 'white', 'edgecolor': 'black'})
    if card.roads is None:
        return
    shield = {'boxstyle': 'round,pad=0.1', 'facecolor': 'white', 'edgecolor': '0.4',
              'linewidth': 0.5}
    for name, places in _named_roads(card.roads, box):
        write.on(name, places, bbox=shield)
    for x, y, name in card.roads.places[_inside(card.roads.places[:, :2], box)]:
        write.on(card.roads.names[int(name)], np.array([(x, y)]), style='italic',
                 path_effects=map_figures.HALO)


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
