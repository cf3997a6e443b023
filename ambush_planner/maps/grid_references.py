# SPDX-License-Identifier: Apache-2.0
"""Positions (K, 2) in WGS 84 [degrees] as maps and receivers name them, and true bearings."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..errors import InvalidCoordinates
from .coordinates import WGS84, converter, horizontal, utm_zone

_BANDS = 'CDEFGHJKLMNPQRSTUVWXX'  # of MGRS, 8 degrees each, from 80 degrees south


def from_mgrs(zone_and_square: str, east: str, north: str) -> FloatArray:
    """Latitude and longitude of the south-west corner of the square of an MGRS reference.

    Raises InvalidCoordinates, and ModuleNotFoundError without the package mgrs.
    """
    from mgrs import MGRS
    from mgrs.core import MGRSError

    if len(east) == len(north) < 3:
        raise InvalidCoordinates(f'a square of {10 ** (5 - len(east))} m is no position; write 3 '
                                 'to 5 digits of easting and of northing')
    try:
        if len(east) == len(north):
            return np.array(MGRS().toLatLon(f'{zone_and_square}{east}{north}'.upper()))
    except MGRSError:
        pass
    raise InvalidCoordinates('no MGRS reference, such as 36S UG 68180 12179')


def from_utm(zone: int, letter: str, east: float, north: float) -> FloatArray:
    """Latitude and longitude of a UTM position; N and S are hemispheres, other letters bands.

    Raises InvalidCoordinates.
    """
    if not (1 <= zone <= 60 and 1e5 <= east < 1e6):
        raise InvalidCoordinates('UTM has the zones 1 to 60, and eastings from 100000 to 999999, '
                                 'before the northing')
    south = letter == 'S' or letter < 'N'
    system = horizontal(f'EPSG:{(32700 if south else 32600) + zone}')
    longitude, latitude = converter(system, horizontal(WGS84)).transform(east, north)
    if letter not in 'NS' and letter != _BANDS[int(np.clip((latitude + 80.0) // 8.0, 0, 20))]:
        raise InvalidCoordinates(f'at latitude {latitude:.4f}, it is not in band {letter}; write N '
                                 'or S for the hemisphere')
    return np.array((latitude, longitude))


def utm_references(lat_lon: FloatArray) -> list[str]:
    """Return zone, hemisphere, easting and northing, whole metres rounded down as in MGRS.

    Raises InvalidCoordinates near the poles, which have no UTM zone.
    """
    found = []
    for latitude, longitude in lat_lon.tolist():
        zone = utm_zone(latitude, longitude)
        east, north = converter(horizontal(WGS84), zone).transform(longitude, latitude)
        found.append(f'{zone.utm_zone[:-1]} {zone.utm_zone[-1]} {int(east)} {int(north)}')
    return found


def mgrs_references(lat_lon: FloatArray) -> list[str]:
    """Return MGRS references to 1 m; raises ModuleNotFoundError without the package mgrs."""
    from mgrs import MGRS

    found = [MGRS().toMGRS(*place) for place in lat_lon]
    return [f'{text[:-12]} {text[-12:-10]} {text[-10:-5]} {text[-5:]}' for text in found]


def true_bearings(lat_lon: FloatArray) -> FloatArray:
    """Directions (K - 1,) from each position to the next, clockwise from north [degrees]."""
    from pyproj import Geod

    (latitude, longitude), (next_latitude, next_longitude) = lat_lon[:-1].T, lat_lon[1:].T
    turned, *_ = Geod(ellps='WGS84').inv(longitude, latitude, next_longitude, next_latitude)
    return np.asarray(turned) % 360.0
