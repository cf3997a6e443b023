# SPDX-License-Identifier: Apache-2.0
"""The driver's sheet as one HTML page: map, way points and secured area of a single route.

Nothing on it tells of other routes: no probabilities, ambush sites or values.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from html import escape
from string import Template

import numpy as np

from ..arrays import FloatArray
from ..game.route_sampler import route_edges
from ..game.strategy import TripStrategy
from ..maps.coordinates import Coordinates, mgrs_references, true_bearings
from ..maps.risk_map import RiskMap
from ..maps.road_file import RoadGraph
from ..planning.plan import Route
from ..routes.legs import bearings, distances_along, secured_stretches
from ..routes.way_points import WayPoint, way_points
from ..words import distance, duration, ends, rounded
from .cli import Console, resource

# Minimum length of a path with distances in km [m].
_KILOMETRES = 2000.0
_TO_DO = 'what to do'
# Columns of positions, of which two tables next to each other have the first one only.
_PLACES = ('MGRS', 'latitude, longitude', 'x y [m]')
# Rows of one table at most; characters in a line of its texts, and in those of one of two tables.
_MOST_ROWS, _WIDE, _NARROW = 20, 28, 26
# Height [mm] of a page of A4 or Letter that is left for the map and the rows of way points, of a
# row and of a further line in it, and of the map at least and at most.
_FREE, _ROW, _LINE, _LOWEST, _HIGHEST = 172.0, 4.95, 3.75, 60.0, 120.0


@dataclass(frozen=True, eq=False)
class Card:
    """A path (L, 2) [m], and what its driver may know.

    ``places`` (P, 2) are start, stops and goal, around which the area is secured. ``clock`` has
    distances along the path [m] and when they are reached [s], None if that is unknown; ``start``
    is when the convoy leaves, in a time ``zone``. ``title`` and ``day`` are for the head.
    """

    path: FloatArray
    risk_map: RiskMap
    places: FloatArray
    secured_distance: float
    way_points: Sequence[WayPoint]
    roads: RoadGraph | None
    clock: tuple[FloatArray, FloatArray] | None
    start: datetime | None
    title: str
    day: str = ''
    zone: str = ''
    training: bool = False

    @property
    def points(self) -> FloatArray:
        """The way points (W, 2) [m]."""
        return np.array([each.xy for each in self.way_points])

    @property
    def distances(self) -> FloatArray:
        """Distances (W,) to the way points along the path [m]."""
        return np.array([each.distance for each in self.way_points])

    def seconds(self, metres: float) -> float:
        """Return the time at which the convoy has gone so far [s]."""
        return float(np.interp(metres, *self.clock)) if self.clock else 0.0

    def time(self, metres: float) -> str:
        """Return the time for a distance along the path: of day, or minutes from departure."""
        minutes = self.seconds(metres) / 60.0
        return (f'{self.start + timedelta(minutes=round(minutes)):%H:%M}' if self.start
                else f'{minutes:.1f}')


def card_of(path: FloatArray, risk_map: RiskMap, trip: TripStrategy,
            drawn: tuple[TripStrategy, Route], roads: RoadGraph | None, names: Sequence[str],
            speed: float | None, start: str | None, title: str, day: str = '', zone: str = '',
            training: bool = False) -> Card:
    """The card of a path (L, 2 or 3): ``drawn`` is its route, and the strategies of that.

    ``names`` are those of start and goal, '' if they have none. Without a ``speed`` [km/h], times
    are those that the roads allow. ``start`` is HH:MM, if it is known.
    """
    path, points = path[:, :2], trip.game.network.points
    places = points[[trip.legs[0].network.source, *(leg.network.target for leg in trip.legs)]]
    roles = ['start', *(f'stop {k}' for k in range(1, len(places) - 1)), 'goal']
    roles[0], roles[-1] = f'start {names[0]}'.strip(), f'goal {names[1]}'.strip()
    line, seconds = _driven(*drawn)
    end, clock = float(distances_along(path)[-1]), None
    if speed:
        clock = np.array((0.0, end)), np.array((0.0, 3.6 * end / speed))
    elif seconds is not None:
        along = distances_along(line)
        clock = along * end / along[-1], seconds
    return Card(path, risk_map, places, trip.game.options.secured_distance,
                way_points(path, roles, places[1:-1], line, roads), roads, clock,
                datetime.strptime(start, '%H:%M') if start else None, title, day, zone, training)


def _driven(trip: TripStrategy, route: Route) -> tuple[FloatArray, FloatArray | None]:
    """The nodes (K, 2) of a route, and when each is passed [s], None if that is unknown."""
    networks = [leg.network for leg in trip.legs]
    line = np.concatenate([networks[0].points[route[0][:1]], *(
        network.points[nodes[1:]] for network, nodes in zip(networks, route, strict=True))])
    steps = [network.seconds[route_edges(network, nodes)]
             for network, nodes in zip(networks, route, strict=True)
             if network.seconds is not None]
    return line, np.concatenate(([0.0], *steps)).cumsum() if steps else None


def _near(card: Card) -> str:
    """The places nearest to start and goal that the roads' file names, with their distances."""
    if card.roads is None or not len(card.roads.places):
        return ''
    said = []
    for xy in card.places[[0, -1]]:
        away = np.hypot(*(card.roads.places[:, :2] - xy).T)
        nearest = int(away.argmin())
        name = card.roads.names[int(card.roads.places[nearest, 2])]
        said.append(f'{distance(float(away[nearest]))} from {escape(name)}')
    return f'Start {said[0]}, goal {said[1]}; '


def card_page(card: Card, console: Console) -> str:
    """Return the page; the console says if MGRS is missing."""
    from .card_map import card_map

    end = card.distances[-1]
    tables, height = _tables(card, _columns(card, console))
    picture = card_map(card, min(max(_FREE - height, _LOWEST), _HIGHEST))
    times = ''
    if card.clock:
        hours = f', {card.time(0.0)} to {card.time(end)}' if card.start else ''
        seconds = card.seconds(end)
        times = f' at {rounded(3.6 * end / seconds)} km/h: {duration(seconds)}{hours}'
    elif card.start:
        times = f', departure {card.time(0.0)}'
    zone = f' local time{card.zone and f", {card.zone}"}' if card.start else ''
    title = ', '.join(filter(None, (card.title, card.day)))
    return Template(resource('card_page.html')).substitute(
        training='<span>TRAINING</span>' * (3 * card.training), title=escape(title),
        secret='Training: do not drive this' if card.training else 'Secret: destroy after use',
        summary=f'{_near(card)}{distance(end)}{times}{zone}',
        map=b64encode(picture.svg.encode()).decode(), width=f'{picture.width:.1f}',
        scale=picture.scale, tables=tables, two=' two' * (tables.count('<table>') > 1),
        notes=''.join(f'<li>{note}</li>' for note in _notes(card)),
    )


def _tables(card: Card, columns: dict[str, list[str]]) -> tuple[str, float]:
    """One table, or two with fewer columns next to each other; and their height, about [mm]."""
    rows, wide = len(card.way_points), _WIDE
    parts = [slice(0, rows)]
    if card.roads is not None and rows > _MOST_ROWS:
        columns, wide = _narrow(card, columns), _NARROW
        parts = [slice(0, -(-rows // 2)), slice(-(-rows // 2), rows)]
    texts = columns.get(_TO_DO, [''] * rows)
    high = [_ROW + _LINE * (max(len(text) - 1, 0) // wide) for text in texts]
    kinds = {name: ' class="text"' * (name == _TO_DO) for name in columns}
    head = ''.join(f'<th scope="col"{kind}>{name}</th>' for name, kind in kinds.items())
    body = ['<tr>' + ''.join(f'<td{kinds[name]}>{escape(cell)}</td>'
                             for name, cell in zip(columns, row, strict=True)) + '</tr>'
            for row in zip(*columns.values(), strict=True)]
    return '\n'.join(
        '\n'.join((f'<table><thead><tr>{head}</tr></thead><tbody>', *body[part],
                   '</tbody></table>')) for part in parts), max(sum(high[part]) for part in parts)


def _narrow(card: Card, columns: dict[str, list[str]]) -> dict[str, list[str]]:
    """The columns of one of two tables next to each other."""
    first, *_ = (name for name in columns if name in _PLACES)
    cells, head = columns[first], first
    if first == 'MGRS' and len(zones := {cell.partition(' ')[0] for cell in cells}) == 1:
        cells, head = [cell.partition(' ')[2] for cell in cells], f'MGRS {zones.pop()}'
    return {'': [str(k) for k in range(1, len(cells) + 1)],
            _TO_DO: [each.label for each in card.way_points], head: cells,
            **{name: column for name, column in columns.items()
               if name.startswith(('from start', 'time', 'minutes'))}}


def _unit(card: Card) -> tuple[float, int, str]:
    """Metres of the unit of all distances, its decimals, and its name."""
    return (1000.0, 2, 'km') if card.distances[-1] >= _KILOMETRES else (1.0, 0, 'm')


def _columns(card: Card, console: Console) -> dict[str, list[str]]:
    """The cells of all way points by the heads of the columns."""
    points, crs, on_roads = card.points, card.risk_map.crs, card.roads is not None
    scale, digits, unit = _unit(card)
    # Rounded before they are subtracted, so that the legs add up to the total.
    total = np.round(card.distances / scale, digits)
    columns = {'way point': [f'{k} {each.name}'.strip()
                             for k, each in enumerate(card.way_points, start=1)]}
    if on_roads:
        columns[_TO_DO] = [each.text for each in card.way_points]
    if crs:
        lat_lon = Coordinates(crs).to_lat_lon(points)
        turns = true_bearings(lat_lon)
        try:
            columns['MGRS'] = mgrs_references(lat_lon)
        except ModuleNotFoundError:
            console.say("Without MGRS: in a checkout of ambush_planner, run pip install '.[gis]'")
        columns['latitude, longitude'] = [f'{lat:.5f}, {lon:.5f}' for lat, lon in lat_lon]
    else:
        turns = bearings(points)
        columns['x y [m]'] = [f'{x:.1f} {y:.1f}' for x, y in points]
    if not on_roads:
        columns['bearing to next'] = [*(f'{round(turn) % 360:03d}°' for turn in turns), '']
    return columns | {
        f'to next [{unit}]': [*(f'{leg:.{digits}f}' for leg in np.diff(total)), ''],
        f'from start [{unit}]': [f'{each:.{digits}f}' for each in total],
        **({'time' if card.start else 'minutes': [card.time(each) for each in card.distances]}
           if card.clock else {}),
    }


def _notes(card: Card) -> list[str]:
    on_roads, minutes = card.roads is not None, '' if card.start else ' min'
    scale, digits, unit = _unit(card)
    stretches = [f'{first / scale:.{digits}f} to {last / scale:.{digits}f} {unit}' + (
                     f' ({card.time(first)} to {card.time(last)}{minutes})' if card.clock else '')
                 for first, last in secured_stretches(card.path, card.places,
                                                      card.secured_distance)]
    secured = (f'Secured area (circles), {distance(card.secured_distance)} around '
               f'{ends(len(card.places) - 2)}: {"; ".join(stretches)}.'
            if card.secured_distance > 0.0 else 'No area on the way is secured.')
    north, systems = (
        ('true north; a compass differs by the local declination', ' Positions are WGS 84.')
        if card.risk_map.crs else ("the map's y axis", ''))
    passed = ' Then pass 2: go straight on at the next two junctions.' * any(
        each.passed for each in card.way_points)
    follow = (f'Distances follow the road.{passed}' if on_roads else
              f'Bearings lead straight to the next way point, clockwise from {north}. Distances '
              'follow the path.')
    return [f'<b>If the {"road" if on_roads else "way"} is blocked, do not look for another '
            'one.</b> Turn back, report, and wait in a secured area for a new card.',
            secured,
            'On the map, the darker the ground, the more dangerous it is; hatched: impassable'
            f'{"; grey lines: other roads" * on_roads}.',
            f'{follow}{systems}']
