"""The driver's sheet as one HTML page: map, way points and held ground of a single route.

Nothing on it tells of other routes: no probabilities, ambush sites or values.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from string import Template

import numpy as np
from matplotlib.figure import Figure

from .. import figures
from ..arrays import FloatArray
from ..colours import PROBABILITY
from ..maps.coordinates import Coordinates
from ..maps.grid_references import mgrs_references, true_bearings, utm_reference
from ..maps.risk_map import RiskMap
from ..routes.legs import Legs, bearings, held_stretches, legs
from .cli import Console, resource
from .report_words import distance, rounded

_ROUTE = PROBABILITY[2]
# Longer paths have distances in km [m], and slower trips times without seconds [s].
_KILOMETRES, _MINUTES = 2000.0, 3600.0
# The map shows at least this share of its longer side across the other, and around the route.
_LEAST_SIDE, _MARGIN = 0.7, 0.12


@dataclass(frozen=True, eq=False)
class Card:
    """A path (L, 2) [m], and what its driver may know.

    ``places`` (P, 2) are start, stops and goal, around which ground is held. ``speed`` [m/s];
    ``start`` is when he leaves, if it is known.
    """

    path: FloatArray
    risk_map: RiskMap
    places: FloatArray
    held_radius: float
    speed: float
    start: datetime | None

    @cached_property
    def legs(self) -> Legs:
        """The legs of the path, with way points at the stops."""
        return legs(self.path, self.places[1:-1])

    def time(self, metres: float) -> str:
        """When the convoy has gone so far: time of day, or minutes from departure."""
        seconds = metres / self.speed
        if self.start is None:
            return f'{seconds / 60.0:.1f}'
        long = self.legs.distances[-1] / self.speed >= _MINUTES
        return f'{self.start + timedelta(seconds=seconds):{"%H:%M" if long else "%H:%M:%S"}}'


def card_page(card: Card, console: Console) -> str:
    """Return the page; the console says if grid references are missing."""
    head, cells = _columns(card, console)
    end = card.legs.distances[-1]
    hours = '' if card.start is None else f', {card.time(0.0)} to {card.time(end)}'
    return Template(resource('card_page.html')).substitute(
        summary=f'{distance(end)} at {3.6 * card.speed:g} km/h: '
                f'{rounded(end / card.speed / 60.0)} minutes{hours}',
        map=b64encode(_picture(card)).decode(),
        head=''.join(f'<th scope="col">{name}</th>' for name in head),
        rows='\n'.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>'
                       for row in cells),
        notes=''.join(f'<li>{note}</li>' for note in _notes(card)),
    )


def _named(card: Card) -> dict[int, str]:
    """The way points that are start, stops or goal."""
    points = card.legs.way_points
    stops = {int(np.hypot(*(points - stop).T).argmin()): f'stop {k}'
             for k, stop in enumerate(card.places[1:-1], start=1)}
    return {0: 'start', **stops, len(points) - 1: 'goal'}


def _columns(card: Card, console: Console) -> tuple[list[str], list[Sequence[str]]]:
    """The heads of the columns, and the cells of each way point."""
    points, crs = card.legs.way_points, card.risk_map.crs
    scale, digits, unit = ((1000.0, 2, 'km') if card.legs.distances[-1] >= _KILOMETRES
                           else (1.0, 0, 'm'))
    # Rounded before they are subtracted, so that the legs add up to the total.
    total = np.round(card.legs.distances / scale, digits)
    named = _named(card)
    columns = {'way point': [f'{k + 1} {named.get(k, "")}' for k in range(len(points))]}
    if crs:
        lat_lon = Coordinates(crs).to_lat_lon(points)
        turns = true_bearings(lat_lon)
        try:
            columns['MGRS'] = mgrs_references(lat_lon)
        except ModuleNotFoundError:
            console.say("Without MGRS, which needs mgrs: pip install 'ambush_planner[gis]'")
        columns['UTM zone, east, north'] = [utm_reference(*place) for place in lat_lon]
        columns['latitude, longitude'] = [f'{lat:.5f}, {lon:.5f}' for lat, lon in lat_lon]
    else:
        turns = bearings(points)
        columns['x, y [m]'] = [f'{x:.1f}, {y:.1f}' for x, y in points]
    columns |= {
        'bearing to next': [*(f'{round(turn) % 360:03d}°' for turn in turns), ''],
        f'to next [{unit}]': [*(f'{leg:.{digits}f}' for leg in np.diff(total)), ''],
        f'from start [{unit}]': [f'{each:.{digits}f}' for each in total],
        'time' if card.start else 'minutes': [card.time(each) for each in card.legs.distances],
    }
    return list(columns), list(zip(*columns.values(), strict=True))


def _notes(card: Card) -> list[str]:
    north = ('true north; a compass differs by the local declination' if card.risk_map.crs
             else "the map's y axis")
    notes = [f'Bearings lead straight to the next way point, clockwise from {north}. Distances '
             'follow the path.']
    if card.risk_map.crs:
        notes.append('Positions are WGS 84; N or S after the UTM zone is the hemisphere.')
    if card.held_radius <= 0.0:
        return [*notes, 'No ground is held along the way.']
    minutes = '' if card.start else ' min'
    stretches = held_stretches(card.path, card.places, card.held_radius)
    held = '; '.join(f'{distance(first)} to {distance(last)} ({card.time(first)} to '
                     f'{card.time(last)}{minutes})' for first, last in stretches)
    names = 'start, stops and goal' if len(card.places) > 2 else 'start and goal'
    return [f'Held ground, within {distance(card.held_radius)} of {names}: {held}.', *notes]


def _picture(card: Card) -> bytes:
    """The ground around the route, which is the only one on it."""
    low, high = card.path.min(axis=0), card.path.max(axis=0)
    longer = (high - low).max()
    half = np.maximum((high - low) / 2.0 + _MARGIN * longer, _LEAST_SIDE / 2.0 * longer)
    first, last = card.risk_map.bounds
    middle = (low + high) / 2.0
    box = np.maximum(middle - half, first), np.minimum(middle + half, last)
    width, height = box[1] - box[0]
    figure = Figure((figures.WIDTH, figures.WIDTH * height / width), layout='compressed')
    axes = figure.subplots()
    figures.draw_ground(axes, card.risk_map, box=box)
    axes.plot(*card.path.T, color=_ROUTE, linewidth=2.2, path_effects=figures.HALO, zorder=4)
    figures.draw_places(axes, card.places, card.held_radius)
    for k, point in enumerate(card.legs.way_points):
        if k not in _named(card):
            figures.number_badge(axes, k + 1, point, _ROUTE)
    return figures.as_png(figure)
