# SPDX-License-Identifier: Apache-2.0
"""Positions (K, 2) in WGS 84 [degrees] as maps and receivers name them, and true bearings."""

from __future__ import annotations

import re

import numpy as np

from ..arrays import FloatArray
from .coordinates import WGS84, utm_zone

MGRS_REFERENCE = re.compile(r'(?i)\d{1,2}[C-X][A-Z]{2}(\d\d){1,5}$')


def from_mgrs(text: str) -> tuple[float, float]:
    """Latitude and longitude of the south-west corner of the square of an MGRS reference.

    Raises ModuleNotFoundError without the package mgrs.
    """
    from mgrs import MGRS

    latitude, longitude = MGRS().toLatLon(text.upper())
    return latitude, longitude


def utm_references(lat_lon: FloatArray) -> list[str]:
    """Return zone, hemisphere, easting and northing, whole metres rounded down as in MGRS.

    Raises InvalidCoordinates near the poles, which have no UTM zone.
    """
    from pyproj import Transformer

    found, zones = [], {}  # it takes 0.2 s to look up a zone
    for place in lat_lon:
        latitude, longitude = place
        key = longitude // 3.0, latitude // 8.0  # finer than zones and their exceptions
        if key not in zones:
            zones[key] = utm_zone(latitude, longitude)
        zone = zones[key]
        east, north = Transformer.from_crs(WGS84, zone).transform(*place)
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
