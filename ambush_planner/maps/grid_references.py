# SPDX-License-Identifier: Apache-2.0
"""MGRS references of positions (K, 2) in WGS 84 [degrees], and true bearings."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray
from ..errors import InvalidCoordinates


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
