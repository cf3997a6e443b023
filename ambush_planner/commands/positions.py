# SPDX-License-Identifier: Apache-2.0
"""Positions as they are typed, and the coordinate system of a map that does not say its own."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

from ..errors import InvalidCoordinates

if TYPE_CHECKING:
    import numpy.typing as npt

    from ..arrays import FloatArray
    from ..maps.occupancy import OccupancyOptions
    from ..maps.risk_map import RiskMap
    from .console import Console

_POSITIONS = {'--start': 'where trips begin', '--via': 'stops',
              '--goal': 'where trips end; the start again for a round trip'}
KINDS = 'X Y [m], LAT,LON in decimal degrees, or an MGRS reference'
_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?'
# How positions are typed, the signs of angles being blanks.
_PATTERNS = {kind: re.compile(rf'{pattern}(?=[\s,;]|$)', re.IGNORECASE) for kind, pattern in {
    'mgrs': r'(\d{1,2}[C-HJ-NP-X])\s*([A-HJ-NP-Z]{2})\s*(?:(\d{1,5})\s+(\d{1,5})|(\d{2,10}))',
    'degrees': rf'({_NUMBER})\s*,\s*({_NUMBER})',
    'metres': rf'({_NUMBER})\s+({_NUMBER})',
}.items()}
_SIGNS = re.compile('[°º˚]')
# A place [m] in a message.
_PLACE = re.compile(r'\((-?\d+\.\d+), (-?\d+\.\d+)\)')


@dataclass(frozen=True)
class Position:
    """A position as it was typed: world coordinates [m], or latitude and longitude [degrees].

    ``kind`` is a key of the patterns of this module.
    """

    numbers: tuple[float, float]
    kind: str
    text: str

    @property
    def in_degrees(self) -> bool:
        """True if the numbers are latitude and longitude."""
        return self.kind != 'metres'

    def like(self, xy: npt.ArrayLike, risk_map: RiskMap) -> str:
        """Another world position [m] on the map, written as this one was typed."""
        import numpy as np

        from ..maps.coordinates import Coordinates, mgrs_references

        if not (self.in_degrees and risk_map.crs):
            x, y = np.asarray(xy, dtype=float).tolist()
            return f'({x:.1f}, {y:.1f})'
        place = Coordinates(risk_map.crs).to_lat_lon(xy)
        if self.kind == 'mgrs':
            return mgrs_references(place[None])[0]
        return '{:.5f},{:.5f}'.format(*place)

    def __str__(self) -> str:
        return self.text

    def xy(self, risk_map: RiskMap) -> FloatArray:
        """World position [m]; raises InvalidCoordinates."""
        import numpy as np

        from ..maps.coordinates import Coordinates

        if not self.in_degrees:
            return np.array(self.numbers)
        if not risk_map.crs:
            raise InvalidCoordinates(
                f'{self} is a latitude and longitude, but the coordinate system of the map is '
                'unknown; name it (--crs), or give X Y [m]')
        return Coordinates(risk_map.crs).from_lat_lon(self.numbers)

    def is_on(self, risk_map: RiskMap) -> bool:
        """Return whether the position lies on the map."""
        try:
            return bool(risk_map.contains(risk_map.to_map_axes(self.xy(risk_map))))
        except InvalidCoordinates:
            return False


def positions_in(text: str) -> list[Position]:
    """Read the positions that a text consists of; raises InvalidCoordinates."""
    found, plain, at = [], _SIGNS.sub(' ', text), 0
    while rest := plain[at:].lstrip(' ,;'):
        at = len(plain) - len(rest)
        kind, match = next(((kind, match) for kind, pattern in _PATTERNS.items()
                            if (match := pattern.match(plain, at))), ('', None))
        if match is None:
            raise InvalidCoordinates(f'must be {KINDS}, got {text[at:]}')
        typed, at = text[at: match.end()].strip(), match.end()
        try:
            a, b = map(float, _numbers(kind, *match.groups()))
        except InvalidCoordinates as error:
            raise InvalidCoordinates(f'{typed}: {error}') from error
        found.append(Position((a, b), kind, typed))
    return found


def _numbers(kind: str, *parts: str) -> Iterable[Any]:
    """The numbers of a position (2,) from the groups of its pattern."""
    if kind == 'mgrs':
        from ..maps.coordinates import from_mgrs

        zone, square, east, north, both = parts
        half = (len(both or '') + 1) // 2
        return from_mgrs(zone + square, *((both[:half], both[half:]) if both else (east, north)))
    if kind == 'metres':
        return parts
    latitude, longitude = map(float, parts)
    is_comma = re.fullmatch(r'0\d+', parts[1])  # as in 37,06096
    if is_comma or not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
        raise InvalidCoordinates('no latitude and longitude; write LAT,LON with decimal points, or '
                                 'X Y [m] with a blank')
    return parts


def written(xy: npt.ArrayLike, risk_map: RiskMap) -> str:
    """A world position [m] as latitude and longitude, or if these are unknown as (x, y)."""
    kind = 'degrees' if risk_map.crs else 'metres'
    return Position((0.0, 0.0), kind, '').like(xy, risk_map)


class _Positions(argparse.Action):
    """Parse positions, one or several, and append them."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        try:
            found = positions_in(' '.join(values))
        except InvalidCoordinates as error:
            parser.error(f'argument {option_string}: {error}')
        before = getattr(namespace, self.dest) or []
        if self.dest != 'via' and len(before) + len(found) != 1:
            parser.error(f'argument {option_string}: must be one position, got '
                         f'{len(before) + len(found)}; in LAT,LON, write decimal points')
        setattr(namespace, self.dest, before + found)


def add_places(parser: argparse.ArgumentParser, stops: bool) -> None:
    """Add the arguments ``--start``, ``--goal`` and perhaps ``--via``, lists of ``Position``."""
    for end in ('--start', '--goal', *['--via'] * stops):
        parser.add_argument(end, nargs='+', action=_Positions, required=end != '--via',
                            metavar='POSITION', help=_POSITIONS[end])


def read_ground(arguments: argparse.Namespace, options: OccupancyOptions) -> tuple[
        RiskMap, FloatArray, FloatArray, list[FloatArray]]:
    """Read the map; also returns start, goal and stops (x, y) [m] of ``add_places`` on it.

    From then on, ``as_typed_places`` writes places as the start was typed. Raises
    InvalidCoordinates, and the errors of ``position_errors`` if a position is off the map.
    """
    from ..maps.risk_map_file import read_risk_map

    risk_map = read_risk_map(arguments.map, options)
    (start,), (goal,) = arguments.start, arguments.goal
    arguments.places_as = start, risk_map
    stops = enumerate(getattr(arguments, 'via', None) or (), start=1)
    return (risk_map, _xy('start', start, risk_map), _xy('goal', goal, risk_map),
            [_xy(f'stop {k}', stop, risk_map) for k, stop in stops])


def as_typed_places(arguments: argparse.Namespace, text: str) -> str:
    """A message with its places (x, y) [m] in the system in which positions were typed."""
    position, risk_map = getattr(arguments, 'places_as', (None, None))
    if position is None or not position.in_degrees:
        return text
    return _PLACE.sub(lambda found: position.like([*map(float, found.groups())], risk_map), text)


def _xy(name: str, given: Position, risk_map: RiskMap) -> FloatArray:
    import numpy as np

    from ..maps.coordinates import Coordinates
    from ..network.trip_graph import position_errors

    if given.is_on(risk_map) or given.in_degrees and not risk_map.crs:
        return given.xy(risk_map)
    (left, bottom), (right, top) = np.asarray(risk_map.bounds).tolist()
    extent = f'x {left:.0f} to {right:.0f}, y {bottom:.0f} to {top:.0f}'
    if given.in_degrees:
        low, high = Coordinates(risk_map.crs or '').to_lat_lon(risk_map.bounds)
        extent = (f'latitude {low[0]:.4f} to {high[0]:.4f}, longitude {low[1]:.4f} to '
                  f'{high[1]:.4f}')
    raise position_errors(name)[0](
        f'{name} {given} is outside the map ({extent}){_hint(given, risk_map)}')


def _hint(given: Position, risk_map: RiskMap) -> str:
    """The position on the map that was meant: other signs or order."""
    a, b = given.numbers
    meant = [(Position((one * x, other * y), 'degrees', f'{one * x:.10g},{other * y:.10g}'),
              'Write LAT,LON, negative in the south and west')
             for (x, y), one, other in product(((a, b), (b, a)), (1.0, -1.0), (1.0, -1.0))]
    if not given.in_degrees:
        meant.insert(0, (Position((b, a), 'metres', f'{b:.10g} {a:.10g}'), 'Write X before Y'))
    for position, rule in meant:
        if position.is_on(risk_map):
            return f'; did you mean {position}? {rule}'
    return ''


def add_crs(parser: argparse._ActionsContainer) -> None:
    """Add the argument ``--crs``."""
    parser.add_argument('--crs', default='', metavar='SYSTEM', help='coordinate system, if no file '
                        "says it: EPSG:32616, or 'datum LAT LON YAW' of a robot's frame")


def in_named_system(risk_map: RiskMap, arguments: argparse.Namespace,
                    console: Console) -> RiskMap:
    """The map of a recording in the system that the arguments name; warns if it differs."""
    from ..maps.coordinates import agree

    crs = arguments.crs
    if crs and risk_map.crs and not agree(crs, risk_map.crs):
        console.warn(f'{crs} takes the place of the recorded coordinate system, {risk_map.crs}')
    return replace(risk_map, crs=crs) if crs else risk_map
