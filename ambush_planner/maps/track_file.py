# SPDX-License-Identifier: Apache-2.0
"""Tracks of vehicles from GPX, CSV and vector files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..errors import shown
from .coordinates import Coordinates
from .vector_file import InvalidFeatures, from_system, read_features


@dataclass(frozen=True, eq=False)
class Track:
    """Positions (L, 2) [m] in the order of driving, and their times (L,) [s] if all are known."""

    name: str
    xy: FloatArray
    times: FloatArray | None = None


def read_tracks(source: str, crs: str | None) -> list[Track]:
    """Read the tracks of a file as world positions of a map with the coordinate system ``crs``.

    * ``.gpx``: its tracks, with all segments of each, or its routes if there are no tracks.
    * ``.csv``: a row for each position, with the columns x and y [m], or lat and lon [degrees];
      optional are ``track``, which names the row's track, and ``time`` (ISO 8601, or seconds).
    * Other files: each line of a vector file, as ``read_features`` takes it.

    Raises InvalidFeatures if the file is unreadable, has no track, or has unusable coordinates.
    """
    path = Path(source.partition('|')[0])
    read = _of_rows if path.suffix.lower() in ('.gpx', '.csv') else _of_lines
    try:
        xy, names, times = read(source, crs)
    except InvalidFeatures:
        raise
    except (RuntimeError, ValueError) as error:  # of pyogrio, pandas, Coordinates
        raise InvalidFeatures(f'{path}: {error}') from error
    if not len(xy) or not np.isfinite(xy).all():
        what = 'a position is no number' if len(xy) else 'there is no track in it'
        raise InvalidFeatures(f'{path}: {what}')
    tracks = []
    for name in dict.fromkeys(names.tolist()):
        own = names == name
        timed = times is not None and np.isfinite(times[own]).all()
        tracks.append(Track(shown(f'track {name} of {path.name}'), xy[own],
                            times[own] if timed else None))
    return tracks


def _of_rows(source: str, crs: str | None) -> tuple[FloatArray, Any, Any]:
    """Positions (L, 2) [m], names of their tracks (L,), times (L,) [s] or None."""
    import pandas
    import pyogrio

    if source.lower().endswith('.csv'):
        rows = pandas.read_csv(source, skipinitialspace=True)
    else:
        rows, kind = pyogrio.read_dataframe(source, layer='track_points'), 'track'
        if rows.empty:
            rows, kind = pyogrio.read_dataframe(source, layer='route_points'), 'route'
        rows = rows.assign(lat=rows.geometry.y, lon=rows.geometry.x, track=rows[f'{kind}_fid'] + 1)
    in_degrees, times = {'lat', 'lon'} <= set(rows), rows.get('time')
    if not in_degrees and not {'x', 'y'} <= set(rows):
        raise ValueError('the columns x and y [m], or lat and lon [degrees], are needed; there are '
                         + ', '.join(map(str, rows)))
    xy = rows[['lat', 'lon'] if in_degrees else ['x', 'y']].to_numpy(np.float64)
    xy = Coordinates(crs or '').from_lat_lon(xy) if in_degrees else xy
    if times is not None and not pandas.api.types.is_numeric_dtype(times):
        times = pandas.to_datetime(times, utc=True, format='ISO8601')
        times = (times - pandas.Timestamp(0, tz='UTC')).dt.total_seconds()
    names = rows.get('track', pandas.Series(1, rows.index)).to_numpy()
    return xy, names, None if times is None else times.to_numpy(np.float64)


def _of_lines(source: str, crs: str | None) -> tuple[FloatArray, Any, Any]:
    import shapely

    lines = read_features(source, 'LineString')
    xy, line = shapely.get_coordinates(lines.geometry, return_index=True)
    # Parts of one feature have its index in common.
    return from_system(xy, lines.crs, crs) if lines.crs else xy, lines.index[line] + 1, None
