# SPDX-License-Identifier: Apache-2.0
"""Tracks of vehicles from GPX, CSV and vector files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..errors import shown, warn
from .coordinates import Coordinates, from_system
from .vector_file import (
    InvalidFeatures,
    file_and_layer,
    read_features,
    read_positions,
    with_positions,
)

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Dates before are those of a receiver or a program that does not know the time: 1990 [s].
FIRST_DATE = 631152000.0
# Days at which clocks of receivers begin, too: 1999-08-22 and 2000-01-01 [days].
_FIRST_DAYS = (10825, 10957)


@dataclass(frozen=True, eq=False)
class Track:
    """Positions (L, 2) [m] in the order of driving, and their times (L,) [s] if all are known."""

    name: str
    xy: FloatArray
    times: FloatArray | None = None


def read_tracks(source: str, crs: str | None) -> list[Track]:
    """Read the tracks of a file as world positions of a map with the coordinate system ``crs``.

    * ``.gpx``: its tracks, with all segments of each, or its routes if there are no tracks.
    * ``.csv``: a row for each position (``read_positions``); optional are ``track``, which names
      the row's track, and ``time`` (ISO 8601, or seconds since 1970).
    * Other files: each line of a vector file, as ``read_features`` takes it.

    Positions without a fix are left out, times that say nothing (missing, all equal, or from before
    1990) are ignored, and a GPX file that ends early is read up to there; warnings say so. Raises
    InvalidFeatures if the file is unreadable, has no track, or has unusable coordinates.
    """
    path, _ = file_and_layer(source)
    read = _of_rows if path.suffix.lower() in ('.gpx', '.csv') else _of_lines
    try:
        xy, names, times = read(source, crs)
    except InvalidFeatures:
        raise
    except (RuntimeError, ValueError) as error:  # of pandas, Coordinates
        raise InvalidFeatures(f'{path}: {error}') from error
    if not len(xy):
        raise InvalidFeatures(f'{path}: there is no track in it')
    tracks, ignored = [], 0
    for name in dict.fromkeys(names.tolist()):
        own = names == name
        when = None if times is None or not _tells(times[own]) else times[own]
        ignored += times is not None and when is None
        tracks.append(Track(shown(f'track {name} of {path.name}'), xy[own], when))
    if ignored:
        warn(f'{path}: the times of {ignored} of {len(tracks)} tracks are ignored: they are '
             'missing, all equal, or from before 1990')
    return tracks


def _tells(times: FloatArray) -> bool:
    """Whether times say when a track was driven."""
    return bool(np.isfinite(times).all() and np.ptp(times) > 0.0 and times.min() >= FIRST_DATE
                and times.min() // 86400.0 not in _FIRST_DAYS)


def _of_rows(source: str, crs: str | None) -> tuple[FloatArray, Any, Any]:
    """Positions (L, 2) [m], names of their tracks (L,), times (L,) [s] or None."""
    import pandas
    import shapely

    path = Path(source)
    rows = _gpx(path) if path.suffix.lower() == '.gpx' else read_positions(path)
    fixed = rows[rows.geometry.notna()]
    if count := len(rows) - len(fixed):
        warn(f'{path}: {count} of {len(rows)} positions have no fix and are left out')
    xy, times = shapely.get_coordinates(fixed.geometry), fixed.get('time')
    if rows.crs is not None and len(xy):
        xy = Coordinates(crs or '').from_lat_lon(xy[:, ::-1])
    if times is not None and not pandas.api.types.is_numeric_dtype(times):
        times = pandas.to_datetime(times, utc=True, format='ISO8601', errors='coerce')
        times = (times - pandas.Timestamp(0, tz='UTC')).dt.total_seconds()
    names = fixed.get('track', pandas.Series(1, fixed.index)).to_numpy()
    return xy, names, None if times is None else times.to_numpy(np.float64)


def _gpx(path: Path) -> GeoDataFrame:
    """The positions of the tracks of a GPX file, or of its routes, up to where it ends."""
    from pandas import DataFrame, to_numeric

    parser: Any = ElementTree.XMLPullParser(('start', 'end'))
    found: dict[str, list[Any]] = {'trk': [], 'rte': []}
    number, damage = 0, ''
    parser.feed(path.read_bytes())
    try:
        for event, element in parser.read_events():
            kind = element.tag.rpartition('}')[2]
            number += event == 'start' and kind in found
            if event == 'end' and kind in ('trkpt', 'rtept'):
                found[kind[:3]].append((element.get('lat'), element.get('lon'),
                                        element.findtext('{*}time'), number))
        parser.close()
    except ElementTree.ParseError as error:
        damage = f'{path}: damaged, or ends early, at line {error.position[0]}'
    rows = DataFrame(found['trk'] or found['rte'], columns=['lat', 'lon', 'time', 'track'])
    if damage and rows.empty:
        raise InvalidFeatures(damage)
    if damage:
        warn(f'{damage}; it is read up to there, {len(rows)} positions')
    rows = rows if rows['time'].notna().any() else rows.drop(columns='time')
    degrees = [to_numeric(rows[name], errors='coerce') for name in ('lon', 'lat')]
    return with_positions(rows, np.stack(degrees, axis=1), in_degrees=True)


def _of_lines(source: str, crs: str | None) -> tuple[FloatArray, Any, Any]:
    import shapely

    lines = read_features(source, 'LineString')
    xy, line = shapely.get_coordinates(lines.geometry, return_index=True)
    # Parts of one feature have its index in common.
    return from_system(xy, lines.crs, crs) if lines.crs else xy, lines.index[line] + 1, None
