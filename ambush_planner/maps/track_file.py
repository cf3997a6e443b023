# SPDX-License-Identifier: Apache-2.0
"""Tracks of vehicles from GPX, CSV and vector files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..errors import shown, warn
from .coordinates import from_system
from .file_kinds import refuse_other_kinds
from .risk_map import RiskMap
from .tables import (
    InvalidFeatures,
    find_column,
    plain,
    prefixed_errors,
    read_dates,
    read_positions,
    with_positions,
)
from .vector_file import file_and_layer, placement_hint, read_features

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Dates before are those of a receiver or a program that does not know the time: 1990 [s].
FIRST_DATE = 631152000.0
# Days at which clocks of receivers begin, too: 1999-08-22 and 2000-01-01 [days].
_FIRST_DAYS = (10825, 10957)
# Columns of a table: plain names of those that tell tracks apart, and names of those with times.
_TRACK_COLUMN = re.compile('(track|trip|vehicle|device|unit|tracker|asset|truck|car)'
                    '(id|fid|name|no|nr|num|number)?|imei|callsign')
_TIMES = ('time', 'timestamp', 'datetime', 'fix_time', 'gps_time', 'device_time', 'time_utc')
_ISO_TIME = re.compile(r'\d{4}-\d\d-\d\d[T ]\d\d:\d\d')
# Positions of a track in a column that tells tracks apart, at least, and the share of the way that
# is left if it does.
_FEW, _LEFT = 3, 0.5


@dataclass(frozen=True, eq=False)
class Track:
    """Positions (L, 2) [m] in the order of driving, and their times (L,) [s] if all are known."""

    name: str
    xy: FloatArray
    times: FloatArray | None = None


def read_tracks(source: str, risk_map: RiskMap) -> list[Track]:
    """Read the tracks of a file as world positions of a map.

    * ``.gpx``: its tracks, with all segments of each, or its routes if there are no tracks.
    * ``.csv``: a row for each position (``read_positions``); optional are columns that tell tracks
      apart (``track``, ``vehicle``, ``device_id``, ``imei``, ``trip``, ...) and ``time``.
    * Other files: each line of a vector file, as ``read_features`` takes it.

    Times are ISO 8601. Positions without a fix are left out, and times that say nothing (missing,
    all equal, or from before 1990) are ignored; warnings say so. Raises InvalidFeatures if the file
    is unreadable, has no track, or has columns or coordinates that are not known for certain;
    OSError.
    """
    path, _ = file_and_layer(source)
    read = _of_rows if path.suffix.lower() in ('.gpx', '.csv') else _of_lines
    with prefixed_errors(path):
        points, crs, names, times = read(source)
        if hint := placement_hint(points, crs, risk_map):
            raise InvalidFeatures(f'nothing in it lies on the map: {hint}')
        xy = points if crs is None else from_system(points, crs, risk_map.crs)
    tracks, ignored = [], 0
    for name in dict.fromkeys(names.tolist()):
        own, when = names == name, None
        if times is not None and np.isfinite(times[own]).all() and np.ptp(times[own]) > 0.0 and (
                times[own].min() >= FIRST_DATE and times[own].min() // 86400.0 not in _FIRST_DAYS):
            when = times[own]
        ignored += times is not None and when is None
        tracks.append(Track(shown(f'track {name} of {path.name}'), xy[own], when))
    if ignored:
        warn(f'{path}: the times of {ignored} of {len(tracks)} tracks are ignored: they are '
             'missing, all equal, or from before 1990')
    return tracks


def _of_rows(source: str) -> tuple[FloatArray, Any, Any, Any]:
    """Positions (L, 2) and their system, names of their tracks (L,), times (L,) [s] or None."""
    import pandas
    import shapely

    path = Path(source)
    refuse_other_kinds(path, InvalidFeatures)
    rows = _gpx(path) if path.suffix.lower() == '.gpx' else read_positions(path)
    fixed = rows[rows.geometry.notna()].reset_index(drop=True)
    if count := len(rows) - len(fixed):
        warn(f'{path}: {count} of {len(rows)} positions have no fix and are left out')
    if fixed.empty:
        raise InvalidFeatures('there is no track in it')
    labels = [name for name in rows if _TRACK_COLUMN.fullmatch(plain(name))]
    time = find_column(rows, *_TIMES)
    if used := [repr(name) for name in (*labels, time) if name and name not in ('track', 'time')]:
        warn(f'{path}: tracks and times are those of {", ".join(used)}')
    if unnamed := int(fixed[labels].eq('').all(axis=1).sum()) if labels else 0:
        raise InvalidFeatures(f'{unnamed} of {len(fixed)} positions have no {labels[0]!r}: name '
                              'their track, or remove them')
    xy = shapely.get_coordinates(fixed.geometry)
    names = (fixed[labels].astype(str).agg(' '.join, axis=1) if labels
             else pandas.Series('1', fixed.index))
    _refuse_unknown(fixed.drop(columns=[*labels, *[time] * bool(time), 'geometry']), xy,
                    bool(labels), bool(time))
    seconds = None if time is None else (
        read_dates(fixed[time], time) - pandas.Timestamp(0, tz='UTC')).dt.total_seconds().to_numpy()
    return xy, fixed.crs, names.to_numpy(), seconds


def _refuse_unknown(others: Any, xy: FloatArray, labels: bool, timed: bool) -> None:
    """Raise InvalidFeatures if other columns tell tracks apart, or have their times."""
    from pandas import factorize

    def way(order: Any) -> FloatArray:
        return np.asarray(np.hypot(*np.diff(xy[order], axis=0).T))

    for name in others:
        given = others[name].astype(str)[others[name] != '']
        if not timed and len(given) and given.map(_ISO_TIME.match).notna().all():
            raise InvalidFeatures(f'times may be in {name!r}; name it time, or remove it')
        code, kinds = factorize(others[name])
        if labels or len(kinds) * _FEW > len(code) or (np.diff(code) >= 0).all():
            continue
        order = np.argsort(code, kind='stable')
        if way(order)[np.diff(code[order]) == 0].sum() < _LEFT * way(slice(None)).sum():
            raise InvalidFeatures(f'{name!r} seems to tell {len(kinds)} tracks apart; name it '
                                  'track, or remove it')


def _gpx(path: Path) -> GeoDataFrame:
    """The positions of the tracks of a GPX file, or of its routes."""
    from pandas import DataFrame, to_numeric

    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InvalidFeatures(f'damaged, or ends early, at line {error.position[0]}; save what is '
                              f'whole with gpsbabel -i gpx -f {path.name} -o gpx -F '
                              f'{path.stem}_whole.gpx') from error
    tracks = root.findall('{*}trk') or root.findall('{*}rte')
    rows = DataFrame([(point.get('lat'), point.get('lon'), point.findtext('{*}time'), number)
                      for number, track in enumerate(tracks, start=1) for point in track.iter()
                      if point.tag.endswith('pt')], columns=['lat', 'lon', 'time', 'track'])
    rows = rows if rows['time'].notna().any() else rows.drop(columns='time')
    degrees = [to_numeric(rows[name], errors='coerce') for name in ('lon', 'lat')]
    return with_positions(rows.drop(columns=['lat', 'lon']), np.stack(degrees, axis=1),
                          in_degrees=True)


def _of_lines(source: str) -> tuple[FloatArray, Any, Any, Any]:
    import shapely

    lines = read_features(source, 'LineString')
    xy, line = shapely.get_coordinates(lines.geometry, return_index=True)
    # Parts of one feature have its index in common.
    return xy, lines.crs, lines.index[line] + 1, None
