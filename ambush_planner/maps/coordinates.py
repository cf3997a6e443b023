# SPDX-License-Identifier: Apache-2.0
"""Coordinate systems: world positions of a map to latitude and longitude or MGRS, and back.

A map file names its system as text: either anything that pyproj reads (``EPSG:32616``, WKT) with
metres as its unit, or ``datum LAT LON YAW``, the local frame of a robot whose navsat_transform
(package robot_localization) has that ``datum`` and no ``use_local_cartesian``. Its origin is LAT
LON; its x axis points YAW [rad] counterclockwise from true east (add its ``yaw_offset`` and
``magnetic_declination_radians``). Lengths at the origin are those of the UTM zone: within 3 km, the
frame is navsat_transform's to 10 cm.
"""

from __future__ import annotations

import math
import warnings
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..errors import InvalidCoordinates, import_extra

# Maximum relative stretch of lengths; projections with more, such as Web Mercator, are not used.
MAX_STRETCH = 0.01
WGS84 = 'EPSG:4326'


class Coordinates:
    """The coordinate system of a map's world positions (x, y) [m].

    ``crs`` is its ``pyproj.CRS``.

    Raises InvalidCoordinates if the text is no coordinate system in metres, or pyproj is missing.
    """

    def __init__(self, text: str) -> None:
        if not text:
            raise InvalidCoordinates('the coordinate system of the map is unknown; name it (--crs '
                                     "EPSG:32616), or the robot's frame (--crs 'datum LAT LON "
                                     "YAW')")
        self.crs = horizontal(text)
        self._to_degrees = converter(self.crs, horizontal(WGS84))
        if not (self.crs.is_projected and is_metric(self.crs)):
            raise InvalidCoordinates(f'{self.crs.to_string()}: the unit of a map must be the '
                                     'metre; reproject the map, for example to its UTM zone')

    def to_lat_lon(self, xy: npt.ArrayLike) -> FloatArray:
        """Convert world positions (..., 2) to WGS 84 latitude and longitude (..., 2) [degrees]."""
        longitude, latitude = self._to_degrees.transform(*np.moveaxis(np.asarray(xy), -1, 0))
        return np.stack((latitude, longitude), axis=-1)

    def from_lat_lon(self, lat_lon: npt.ArrayLike) -> FloatArray:
        """Convert WGS 84 latitude and longitude (..., 2) [degrees] to world positions [m].

        Raises InvalidCoordinates if a position is not on the Earth, or not in the system's area.
        """
        latitude, longitude = np.moveaxis(np.asarray(lat_lon, dtype=np.float64), -1, 0)
        xy = np.stack(self._to_degrees.transform(longitude, latitude, direction='INVERSE'), axis=-1)
        for bad, problem in (
            (~((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0)),
             'latitude must be in -90..90 and longitude in -180..180'),
            (~np.isfinite(xy).all(axis=-1), f'too far from the area of {self.crs.to_string()}'),
        ):
            if bad.any():
                first = np.stack((latitude, longitude), axis=-1)[bad][0].tolist()
                raise InvalidCoordinates(f'{first}: {problem} ({bad.sum()} such positions)')
        return xy


def utm_zone(latitude: float, longitude: float) -> Any:
    """Return the ``pyproj.CRS`` of the UTM zone (WGS 84) of a place.

    Raises InvalidCoordinates if there is none: beyond 84 degrees north or 80 degrees south.
    """
    if not -80.0 <= latitude <= 84.0:
        raise InvalidCoordinates(f'no UTM zone contains latitude {latitude:g}, longitude '
                                 f'{longitude:g}; reproject the map by hand')
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    if 56.0 <= latitude < 64.0 and 3.0 <= longitude < 12.0:
        zone = 32  # is widened for the Norwegian coast
    elif latitude >= 72.0 and 0.0 <= longitude < 42.0:
        zone = 31 + 2 * int((longitude + 3.0) // 12.0)  # those of Svalbard
    return horizontal(f'EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}')


def metric_system(crs: Any, x: float, y: float) -> Any:
    """Return a ``pyproj.CRS`` for lengths around (x, y), a place in the system ``crs``.

    It is the system itself if its metres are metres on the ground, else the UTM zone.
    """
    longitude, latitude = converter(crs, horizontal(WGS84)).transform(x, y)
    if crs.is_projected and is_metric(crs):
        factors = _pyproj().Proj(crs).get_factors(longitude, latitude)
        scales = factors.meridional_scale, factors.parallel_scale
        if max(abs(scale - 1.0) for scale in scales) <= MAX_STRETCH:
            return crs
    return utm_zone(latitude, longitude)


def is_robot_frame(text: object) -> bool:
    """Return whether a text names the frame of a robot, as ``datum LAT LON YAW``."""
    return str(text).split()[:1] == ['datum']


def _robot_frame(text: str) -> str:
    """The frame of a robot for PROJ: an oblique Mercator projection, which can be turned."""
    try:
        latitude, longitude, yaw = map(float, text.split()[1:])
        if not math.isfinite(latitude + longitude + yaw):
            raise ValueError
    except ValueError:
        raise InvalidCoordinates(
            f'a datum is "datum LAT LON YAW" [degrees, degrees, rad], got {text!r}') from None
    zone = utm_zone(latitude, longitude)
    scale = _pyproj().Proj(zone).get_factors(longitude, latitude).meridional_scale
    return (f'+proj=omerc +lat_0={latitude!r} +lonc={longitude!r} +alpha=45 '
            f'+gamma={45.0 + math.degrees(yaw)!r} +k={scale!r} +datum=WGS84 +units=m')


@lru_cache(16)
def horizontal(text: Any) -> Any:
    """Return the ``pyproj.CRS`` of a text without its heights; raises InvalidCoordinates."""
    pyproj = _pyproj()
    text = _robot_frame(text) if is_robot_frame(text) else text
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # +init=epsg:32616 is an old way to say it
            crs = pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError as error:
        raise InvalidCoordinates(f'not a coordinate system: {text!r} ({error})') from error
    return crs.sub_crs_list[0] if crs.is_compound else crs


def resolve_system(own: Any, given: Any = None) -> Any:
    """Return the horizontal ``pyproj.CRS`` of a file that names ``own``; None if it is unknown.

    ``given`` names it if the file does not: if ``own`` is missing, undefined or a local system.
    Raises InvalidCoordinates if that has another unit than ``given`` or the metre, or if ``own``
    has no datum.
    """
    own, given = (horizontal(each) if each else None for each in (own, given))
    if own is None or own.name.lower().startswith('undefined'):
        return given
    if own.is_engineering:
        unit, metres = own.axis_info[0].unit_name, own.axis_info[0].unit_conversion_factor
        if metres != (given.axis_info[0].unit_conversion_factor if given else 1.0):
            raise InvalidCoordinates(f'its local coordinate system, {own.name!r}, is in the unit '
                                     f'{unit}; convert it to metres, or name a system in that '
                                     'unit with --crs')
        return given
    converter(own, horizontal(WGS84))  # else its datum is unknown
    return own


def agree(one: str, other: str) -> bool:
    """Return whether two texts name the same coordinate system, whatever they say of heights."""
    if one == other:
        return True
    first, second = horizontal(one), horizontal(other)
    return bool(first.equals(second, ignore_axis_order=True)
                or first.to_epsg() is not None and first.to_epsg() == second.to_epsg())


@lru_cache(16)
def converter(source: Any, target: Any) -> Any:
    """Return the ``pyproj.Transformer`` between two systems, of which x is the first axis.

    Raises InvalidCoordinates if the datum of one is unknown. Only on ellipsoids like that of WGS 84
    do all datums agree within a few metres.
    """
    pyproj = _pyproj()
    old = [each for each in (source, target) if each.ellipsoid is None
           or abs(each.ellipsoid.semi_major_metre - 6378137.0) > 0.5
           or abs(each.ellipsoid.inverse_flattening - 298.257) > 0.01]
    try:
        return pyproj.Transformer.from_crs(source, target, always_xy=True, allow_ballpark=not old)
    except pyproj.exceptions.ProjError as error:
        crs = (old or [source])[0]
        what = f'ellipsoid {crs.ellipsoid.name}' if crs.ellipsoid else 'it is a local system'
        raise InvalidCoordinates(
            f'the datum of the coordinate system {crs.name!r} is unknown ({what}), so that its '
            'places can be 100 m and more off on the ground; give the file a system with a datum, '
            'with gdal_edit.py -a_srs or Assign Projection in QGIS') from error


def _pyproj() -> Any:
    return import_extra('pyproj', 'coordinate systems', 'gis', InvalidCoordinates)


def is_metric(crs: Any) -> bool:
    """Return whether the axes of a coordinate system (pyproj) are in metres."""
    return all(axis.unit_conversion_factor == 1.0 for axis in crs.axis_info[:2])


def from_system(points: FloatArray, crs: str, map_crs: str | None) -> FloatArray:
    """Convert positions (K, 2) in the coordinate system ``crs`` to world positions of a map [m].

    If the map's system is unknown, positions in metres are assumed to be in the map's. Those too
    far from the area of its system are NaN. Raises InvalidCoordinates if they are in another unit.
    """
    own = horizontal(crs)
    if not map_crs:
        if not is_metric(own):
            raise InvalidCoordinates(f'the positions are not in metres ({own.name}), and the '
                                     'coordinate system of the map is unknown; name it with crs '
                                     '(map.crs)')
        return points
    system = Coordinates(map_crs)
    xy = np.stack(converter(own, system.crs).transform(*points.T), axis=-1)
    return np.where(np.isfinite(xy), xy, np.nan)


def longest_edge(crs: Any) -> float:
    """Longest straight edge in a system that is converted by its ends only, in the system's unit.

    0.01 degrees or 1 km: an edge that is straight in one system is none in another.
    """
    system = horizontal(crs)
    return 0.01 if system.is_geographic else 1000.0 / system.axis_info[0].unit_conversion_factor


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
