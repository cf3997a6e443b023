"""Positions as maps and receivers name them: UTM and MGRS references, true bearings."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
from .coordinates import WGS84, utm_zone


def utm_reference(latitude: float, longitude: float) -> str:
    """Return zone, hemisphere, easting and northing of a position in WGS 84 [degrees].

    They are whole metres, rounded down as in MGRS.

    Raises InvalidCoordinates near the poles, which have no UTM zone.
    """
    from pyproj import Transformer

    zone = utm_zone(latitude, longitude)
    east, north = Transformer.from_crs(WGS84, zone).transform(latitude, longitude)
    return f'{zone.utm_zone[:-1]} {zone.utm_zone[-1]} {int(east)} {int(north)}'


def mgrs_references(lat_lon: FloatArray) -> list[str]:
    """Return the MGRS references, to 1 m, of positions (K, 2) in WGS 84 [degrees].

    Raises ModuleNotFoundError without the package mgrs.
    """
    from mgrs import MGRS

    return [_spaced(MGRS().toMGRS(latitude, longitude)) for latitude, longitude in lat_lon]


def true_bearings(lat_lon: FloatArray) -> FloatArray:
    """Directions (K - 1,) from each position (K, 2) to the next, clockwise from north [degrees]."""
    from pyproj import Geod

    latitude, longitude = lat_lon.T
    turned: Any = Geod(ellps='WGS84').inv(longitude[:-1], latitude[:-1], longitude[1:],
                                          latitude[1:])[0]
    return np.asarray(turned) % 360.0


def _spaced(reference: str) -> str:
    """Separate grid zone, square, easting and northing."""
    return f'{reference[:-12]} {reference[-12:-10]} {reference[-10:-5]} {reference[-5:]}'
