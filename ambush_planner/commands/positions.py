# SPDX-License-Identifier: Apache-2.0
"""Positions as they are typed, and the coordinate system of a map that does not say its own."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..maps.coordinates import Coordinates, InvalidCoordinates
from ..maps.grid_references import MGRS_REFERENCE, from_mgrs, mgrs_references
from ..maps.risk_map import RiskMap
from ..network.trip_graph import position_errors

_POSITIONS = {'--start': 'where trips begin', '--via': 'stops',
              '--goal': 'where trips end; the start again for a round trip'}


@dataclass(frozen=True)
class Position:
    """A position as it was typed: world coordinates [m], or latitude and longitude [degrees].

    ``as_mgrs``: the latter, typed as an MGRS reference.
    """

    numbers: tuple[float, float]
    in_degrees: bool
    as_mgrs: bool = False

    def like(self, xy: npt.ArrayLike, risk_map: RiskMap) -> str:
        """Another world position [m] on the map, written as this one was typed."""
        if not (self.in_degrees and risk_map.crs):
            x, y = np.asarray(xy, dtype=float).tolist()
            return f'({x:.1f}, {y:.1f})'
        lat, lon = Coordinates(risk_map.crs).to_lat_lon(xy).tolist()
        if self.as_mgrs:
            return mgrs_references(np.array([(lat, lon)]))[0]
        return f'{lat:.5f},{lon:.5f}'

    def __str__(self) -> str:
        return ('{:.10g},{:.10g}' if self.in_degrees else '{:.10g} {:.10g}').format(*self.numbers)

    def xy(self, risk_map: RiskMap) -> FloatArray:
        """World position [m]; raises InvalidCoordinates."""
        if not self.in_degrees:
            return np.array(self.numbers)
        if not risk_map.crs:
            raise InvalidCoordinates(
                f'{self} is a latitude and longitude, but the coordinate system of the map is '
                'unknown; name it (--crs), or give X Y [m]')
        return Coordinates(risk_map.crs).from_lat_lon(self.numbers)

    def is_on(self, risk_map: RiskMap) -> bool:
        """Whether the position lies on a map with a coordinate system."""
        try:
            return bool(risk_map.contains(risk_map.to_map_axes(self.xy(risk_map))))
        except InvalidCoordinates:
            return False


def written(xy: npt.ArrayLike, risk_map: RiskMap) -> str:
    """A world position [m] as latitude and longitude, or if these are unknown as (x, y)."""
    try:
        return Position((0.0, 0.0), True).like(xy, risk_map)
    except InvalidCoordinates:
        return Position((0.0, 0.0), False).like(xy, risk_map)


class _Positions(argparse.Action):
    """Parse ``X Y``, ``LAT,LON`` and MGRS references, one or several, and append them."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        texts = [''.join(values)] if MGRS_REFERENCE.match(''.join(values)) else values
        as_mgrs = any(MGRS_REFERENCE.match(text) for text in texts)
        in_degrees = any(',' in text or MGRS_REFERENCE.match(text) for text in texts)
        try:
            numbers = [float(part) for text in texts for part in _parts(text)]
            pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
        except ValueError:
            parser.error(f'argument {option_string}: must be X Y [m], LAT,LON [degrees] or an MGRS '
                         f'reference, got {" ".join(values)!r}')
        before = getattr(namespace, self.dest) or []
        if self.dest != 'via' and len(before) + len(pairs) != 1:
            parser.error(f'argument {option_string}: must be one position')
        setattr(namespace, self.dest,
                before + [Position(pair, in_degrees, as_mgrs) for pair in pairs])


def _parts(text: str) -> Sequence[str | float]:
    """The numbers of a position, or of a part of it."""
    if MGRS_REFERENCE.match(text):
        return from_mgrs(text)
    return [part for part in text.split(',') if part]


def add_places(parser: argparse.ArgumentParser, stops: bool) -> None:
    """Add the arguments ``--start``, ``--goal`` and perhaps ``--via``, lists of ``Position``."""
    for end in ('--start', '--goal', *['--via'] * stops):
        parser.add_argument(end, nargs='+', action=_Positions, required=end != '--via',
                            metavar='POSITION', help=_POSITIONS[end])


def places_on(arguments: argparse.Namespace,
              risk_map: RiskMap) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Start, goal and stops (x, y) [m] of ``add_places``.

    Raises InvalidCoordinates, and the errors of ``position_errors`` if a position is off the map.
    """
    (start,), (goal,) = arguments.start, arguments.goal
    stops = enumerate(getattr(arguments, 'via', None) or (), start=1)
    return (_xy('start', start, risk_map), _xy('goal', goal, risk_map),
            [_xy(f'stop {k}', stop, risk_map) for k, stop in stops])


def _xy(name: str, given: Position, risk_map: RiskMap) -> FloatArray:
    if not risk_map.crs or given.is_on(risk_map):
        return given.xy(risk_map)
    low, high = Coordinates(risk_map.crs).to_lat_lon(risk_map.bounds)
    (left, bottom), (right, top) = np.asarray(risk_map.bounds).tolist()
    extent = (f'latitude {low[0]:.4f} to {high[0]:.4f}, longitude {low[1]:.4f} to {high[1]:.4f}'
              if given.in_degrees else f'x {left:.0f} to {right:.0f}, y {bottom:.0f} to {top:.0f}')
    raise position_errors(name)[0](
        f'{name} {given} is outside the map ({extent}){_hint(given, risk_map)}')


def _hint(given: Position, risk_map: RiskMap) -> str:
    """The latitude and longitude on the map that was meant: other signs, or the other order."""
    a, b = given.numbers
    for (one, other), north, east in product(((a, b), (b, a)), (1.0, -1.0), (1.0, -1.0)):
        meant = Position((north * one, east * other), True)
        if meant.is_on(risk_map):
            return f'; did you mean {meant}? Write LAT,LON, negative in the south and west'
    return ''


def add_crs(parser: argparse._ActionsContainer) -> None:
    """Add the arguments ``--crs`` and ``--datum``, for ``crs_text``."""
    crs = parser.add_mutually_exclusive_group()
    crs.add_argument('--crs', default='', metavar='SYSTEM', help='coordinate system of a map '
                     'whose file does not say it, such as EPSG:32616')
    crs.add_argument('--datum', type=float, nargs=3, metavar=('LAT', 'LON', 'YAW'),
                     help="for a map in a robot's frame: position of its origin and direction of "
                     "x [rad from east], as in navsat_transform's parameter datum")


def crs_text(arguments: argparse.Namespace) -> str:
    """Return the coordinate system that the arguments name, as ``Coordinates`` reads it, or ''."""
    if arguments.datum:
        return 'datum ' + ' '.join(f'{number:.12g}' for number in arguments.datum)
    return str(arguments.crs)
