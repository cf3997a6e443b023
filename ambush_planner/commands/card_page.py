# SPDX-License-Identifier: Apache-2.0
"""The driver's sheet as one HTML page: map, way points and secured area of a single route.

Nothing on it tells of other routes: no probabilities, ambush sites or values.
"""

from __future__ import annotations

import argparse
from base64 import b64encode
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from string import Template

import numpy as np
from matplotlib.figure import Figure

from .. import figures, map_figures
from ..arrays import FloatArray, IndexArray
from ..colours import PROBABILITY
from ..game.route_sampler import route_edges
from ..game.strategy import TripStrategy
from ..maps.coordinates import Coordinates
from ..maps.grid_references import mgrs_references, true_bearings, utm_references
from ..maps.risk_map import RiskMap
from ..planning.plan import Route, path_lengths
from ..routes.legs import bearings, distances_along, secured_stretches, way_points
from ..words import distance, duration, ends, rounded
from .cli import Console, number, resource

_ROUTE = PROBABILITY[2]
# Minimum length of a path with distances in km [m].
_KILOMETRES = 2000.0
# Margin around the route on the map, as a share of the map's longer side.
_MARGIN = 0.12
# Minimum of the map's shorter side, as a share of the longer one.
_MIN_SIDE = 0.7


@dataclass(frozen=True, eq=False)
class Card:
    """A path (L, 2) [m], and what its driver may know.

    ``places`` (P, 2) are start, stops and goal, around which the area is secured. ``speed`` is in
    km/h, None if that is unknown; ``start`` is when he leaves, on which ``day``.
    """

    path: FloatArray
    risk_map: RiskMap
    places: FloatArray
    secured_distance: float
    speed: float | None
    start: datetime | None
    day: str = ''

    @cached_property
    def at(self) -> IndexArray:
        """Where in the path the way points are."""
        return way_points(self.path, self.places[1:-1])

    @property
    def points(self) -> FloatArray:
        """The way points (W, 2) [m]."""
        return self.path[self.at]

    @property
    def distances(self) -> FloatArray:
        """Distances (W,) to the way points along the path [m]."""
        return distances_along(self.path)[self.at]

    @cached_property
    def names(self) -> dict[int, str]:
        """The way points that are start, stops or goal."""
        stops = {int(np.hypot(*(self.points - stop).T).argmin()): f'stop {k}'
                 for k, stop in enumerate(self.places[1:-1], start=1)}
        return {0: 'start', **stops, len(self.points) - 1: 'goal'}

    def time(self, metres: float) -> str:
        """When the convoy has gone so far: time of day, or minutes from departure."""
        minutes = 0.06 * metres / (self.speed or 1.0)
        return (f'{self.start + timedelta(minutes=round(minutes)):%H:%M}' if self.start
                else f'{minutes:.1f}')


def card_of(path: FloatArray, risk_map: RiskMap, trip: TripStrategy,
            drawn: tuple[TripStrategy, Route], speed: float | None, start: str | None,
            day: str = '') -> Card:
    """The card of a path (L, 2 or 3): ``drawn`` is its route, and the strategies of that.

    Without a ``speed``, the networks' speeds give the mean one; ``start`` is HH:MM, if it is known.
    """
    return Card(path[:, :2], risk_map, figures.places_of(trip),
                trip.game.options.secured_distance,
                speed or _mean_speed(*drawn, float(path_lengths([path])[0])),
                datetime.strptime(start, '%H:%M') if start else None, day)


def _mean_speed(trip: TripStrategy, route: Route, length: float) -> float | None:
    """The mean speed [km/h] over a route, None if the networks have no speeds."""
    if trip.game.network.seconds is None:
        return None
    steps = [leg.network.travel_costs[route_edges(leg.network, nodes)].sum()
             for leg, nodes in zip(trip.legs, route, strict=True)]
    return 3.6 * length / float(sum(steps))


def add_speed(parser: argparse.ArgumentParser) -> None:
    """Add the argument ``--speed``."""
    parser.add_argument('--speed', type=number(0.01, 1000.0), metavar='KM/H',
                        help='mean speed, for the times on the card (default: as the roads allow, '
                        'if the plan has their speeds)')


def card_page(card: Card, console: Console) -> str:
    """Return the page; the console says if MGRS is missing."""
    columns, end = _columns(card, console), card.distances[-1]
    times = ''
    if card.speed:
        hours = f', {card.time(0.0)} to {card.time(end)} local time' if card.start else ''
        times = f' at {rounded(card.speed)} km/h: {duration(3.6 * end / card.speed)}{hours}'
    elif card.start:
        times = f', departure {card.time(0.0)} local time'
    return Template(resource('card_page.html')).substitute(
        summary=f'{card.day}{card.day and ": "}{distance(end)}{times}',
        map=b64encode(_picture(card)).decode(),
        head=''.join(f'<th scope="col">{name}</th>' for name in columns),
        rows='\n'.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>'
                       for row in zip(*columns.values(), strict=True)),
        notes=''.join(f'<li>{note}</li>' for note in _notes(card)),
    )


def _columns(card: Card, console: Console) -> dict[str, list[str]]:
    """The cells of all way points by the heads of the columns."""
    points, crs = card.points, card.risk_map.crs
    scale, digits, unit = ((1000.0, 2, 'km') if card.distances[-1] >= _KILOMETRES
                           else (1.0, 0, 'm'))
    # Rounded before they are subtracted, so that the legs add up to the total.
    total = np.round(card.distances / scale, digits)
    columns = {'way point': [f'{k + 1} {card.names.get(k, "")}' for k in range(len(points))]}
    if crs:
        lat_lon = Coordinates(crs).to_lat_lon(points)
        turns = true_bearings(lat_lon)
        try:
            columns['MGRS'] = mgrs_references(lat_lon)
        except ModuleNotFoundError:
            console.say("Without MGRS: in a checkout of ambush_planner, run pip install '.[gis]'")
        columns['UTM zone, east, north'] = utm_references(lat_lon)
        columns['latitude, longitude'] = [f'{lat:.5f}, {lon:.5f}' for lat, lon in lat_lon]
    else:
        turns = bearings(points)
        columns['x, y [m]'] = [f'{x:.1f}, {y:.1f}' for x, y in points]
    return columns | {
        'bearing to next': [*(f'{round(turn) % 360:03d}°' for turn in turns), ''],
        f'to next [{unit}]': [*(f'{leg:.{digits}f}' for leg in np.diff(total)), ''],
        f'from start [{unit}]': [f'{each:.{digits}f}' for each in total],
        **({'time' if card.start else 'minutes': [card.time(each) for each in card.distances]}
           if card.speed else {}),
    }


def _notes(card: Card) -> list[str]:
    unit = '' if card.start else ' min'
    stretches = [f'{distance(first)} to {distance(last)}' + (
                     f' ({card.time(first)} to {card.time(last)}{unit})' if card.speed else '')
                 for first, last in secured_stretches(card.path, card.places,
                                                      card.secured_distance)]
    secured = (f'Secured area (circles), {distance(card.secured_distance)} around '
               f'{ends(len(card.places) - 2)}: {"; ".join(stretches)}.'
            if card.secured_distance > 0.0 else 'No area on the way is secured.')
    north, systems = (
        ('true north; a compass differs by the local declination',
         ' Positions are WGS 84; N or S after the UTM zone is the hemisphere.')
        if card.risk_map.crs else ("the map's y axis", ''))
    colour = 'darker' if card.risk_map.heights is None else 'browner'
    return [secured,
            f'On the map, the {colour} the ground, the more dangerous it is; black: obstacles.',
            f'Bearings lead straight to the next way point, clockwise from {north}. Distances '
            f'follow the path.{systems}']


def _picture(card: Card) -> bytes:
    """The ground around the route, which is the only one on it."""
    low, high = card.path.min(axis=0), card.path.max(axis=0)
    longer, middle = (high - low).max(), (low + high) / 2.0
    half = np.maximum((high - low) / 2.0 + _MARGIN * longer, _MIN_SIDE / 2.0 * longer)
    first, last = card.risk_map.bounds
    box = np.maximum(middle - half, first), np.minimum(middle + half, last)
    width, height = box[1] - box[0]
    figure = Figure((map_figures.WIDTH, map_figures.WIDTH * height / width), layout='compressed')
    axes = figure.subplots()
    map_figures.draw_map(axes, card.risk_map, box=box, avoid=card.places)
    axes.plot(*card.path.T, color=_ROUTE, linewidth=2.2, path_effects=map_figures.HALO, zorder=4)
    figures.draw_places(axes, card.places, card.secured_distance)
    numbered = sorted(set(range(len(card.points))) - set(card.names))
    apart = figures.BADGE * max(width, height)
    spots = figures.free_spots(card.points[numbered], card.places, apart)
    for k, spot in zip(numbered, spots, strict=True):
        figures.number_badge(axes, k + 1, card.points[k], _ROUTE, spot)
    return map_figures.as_png(figure)
