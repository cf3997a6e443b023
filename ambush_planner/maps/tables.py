# SPDX-License-Identifier: Apache-2.0
"""Tables: the reader of CSV files, and how columns, numbers and dates are read from any table."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError, InvalidCoordinates
from .coordinates import WGS84

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from pandas import DataFrame, Series

# Other characters between fields, and their names.
_SEPARATORS = {';': '";"', '\t': 'tabs', '|': '"|"'}
_DECIMAL_COMMA = re.compile(r'\s*[-+]?\d+,\d+\s*')
# Dates and times of ISO 8601, with a day; a blank may stand for the T.
_ZONE = r'\s?(Z|[+-]\d\d(:?\d\d)?)?'
_ISO_8601 = re.compile(
    rf'\d{{4}}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?{_ZONE})?|'
    rf'\d{{8}}(T\d{{4}}(\d\d([.,]\d+)?)?{_ZONE})?', re.IGNORECASE)
# Columns of positions, north and east: in degrees, or in metres.
_DEGREES = ('lat', 'latitude'), ('lon', 'lng', 'long', 'longitude')
_METRES = ('y', 'northing'), ('x', 'easting')
# Columns that name the coordinate system of positions in metres, and their values.
_SYSTEM = re.compile('(utm)?zone|epsg(code)?|srid|crs')
_SYSTEM_NUMBER = re.compile(r'(?i)(epsg:)?\d+ ?\w?')
# First year of a date, and the days that it may lie ahead.
_FIRST_YEAR, _AHEAD = 1900, 366


class InvalidFeatures(AmbushPlannerError, ValueError):
    """A file of features or positions is unreadable, or lacks features or attributes."""


@contextmanager
def prefixed_errors(path: Path | str) -> Iterator[None]:
    """Name a file in the errors about what is in it."""
    try:
        yield
    except (InvalidFeatures, InvalidCoordinates) as error:
        known = str(error).startswith(f'{path}: ')
        raise InvalidFeatures(str(error) if known else f'{path}: {error}') from error


def read_table(path: Path) -> DataFrame:
    """Read the rows of a CSV file, all as texts; the first row has the names of the columns.

    Blank fields after the last column count for nothing. Raises InvalidFeatures if the rows do not
    agree with the header, or are not separated by commas; OSError.
    """
    from pandas import DataFrame

    try:
        text = path.read_bytes().decode('utf-8-sig')
        names = text.partition('\n')[0]
        for separator, name in _SEPARATORS.items():
            if separator in names and ',' not in names:
                raise InvalidFeatures(f'its fields are separated by {name}; save it with commas '
                                      'between fields and points in decimal numbers')
        reader = csv.reader(io.StringIO(text, newline=''), skipinitialspace=True, strict=True)
        rows = [(reader.line_num, [each.strip() for each in row]) for row in reader]
    except UnicodeDecodeError as error:
        raise InvalidFeatures('it is not in UTF-8; save it as CSV in UTF-8') from error
    except csv.Error as error:
        raise InvalidFeatures(f'not a CSV file: {error}') from error
    (_, header), *rows = [each for each in rows if each[1] not in ([], [''])] or [(0, [])]
    while header and not header[-1]:
        header.pop()
    for line, row in rows:
        while len(row) > len(header) and not row[-1]:
            row.pop()
        if len(row) != len(header):
            raise InvalidFeatures(f'line {line} has {len(row)} fields, but the header has '
                                  f'{len(header)} columns: {", ".join(header)}')
    return DataFrame([row for _, row in rows], columns=header, dtype=str)


def plain(name: object) -> str:
    """A name in small letters, without blanks and punctuation."""
    return re.sub(r'[\W_]', '', str(name)).lower()


def find_column(names: Iterable[object], *wanted: str) -> Any:
    """The first wanted name among those of columns: exactly, or else as ``plain``; None if absent.

    Raises InvalidFeatures if several columns have it.
    """
    given = list(names)
    for want in wanted:
        found = [each for each in given if str(each) == want] or [
            each for each in given if plain(each) == plain(want)]
        if len(found) > 1:
            raise InvalidFeatures(f'which column is {want!r}? There are '
                                  f'{", ".join(map(repr, found))}; rename the others')
        if found:
            return found[0]
    return None


def read_numbers(values: Series, name: str) -> FloatArray:
    """The numbers (L,) of a column, NaN for others; raises InvalidFeatures for decimal commas."""
    from pandas import to_numeric

    for text in filter(_DECIMAL_COMMA.fullmatch, values.astype(str)):
        raise InvalidFeatures(f'{name} has {text!r}: write decimal points instead of commas')
    return np.asarray(to_numeric(values, errors='coerce'), dtype=np.float64)


def read_dates(values: Series, name: str) -> Series:
    """Dates and times (L,) of a column in ISO 8601, by default in UTC; NaT if missing.

    Raises InvalidFeatures for anything else, also for dates before 1900 and years ahead.
    """
    from pandas import Timestamp, to_datetime

    texts = values.astype(str).str.strip().str.removesuffix('.0').where(values.notna(), '')
    given = texts != ''
    known = texts.where(texts.map(_ISO_8601.fullmatch).notna())
    dates = to_datetime(known.str.replace(',', '.'), utc=True, format='ISO8601', errors='coerce')
    if (bad := given & dates.isna()).any():
        raise InvalidFeatures(f'{name} has {texts[bad].iloc[0]!r}: dates must be ISO 8601, such as '
                              '2025-03-31 or 2025-03-31T08:15:00Z')
    ahead = (dates - Timestamp.now('UTC')).dt.days
    if (bad := (dates.dt.year < _FIRST_YEAR) | (ahead > _AHEAD)).any():
        raise InvalidFeatures(f'{name} has {texts[bad].iloc[0]!r}, which is before {_FIRST_YEAR} '
                              'or over a year ahead')
    return dates


def read_positions(path: Path) -> GeoDataFrame:
    """Read a CSV file with a position in each row (``read_table``); raises InvalidFeatures.

    Its columns are lat and lon [degrees, WGS 84] or x and y [m], in any case. A position that is no
    number, or in degrees (0, 0) or not on the Earth, has no geometry.
    """
    rows = read_table(path)
    for north, east in (_DEGREES, _METRES):
        columns = [find_column(rows, *names) for names in (east, north)]
        if None not in columns:
            xy = np.stack([read_numbers(rows[name], name) for name in columns], axis=1)
            if len(xy) and not np.isfinite(xy).all(axis=1).any():
                raise InvalidFeatures('no row has numbers of a position, such as 48.84; '
                                      f'{columns[1]} has {rows[columns[1]].iloc[0]!r}')
            systems = [name for name in rows if _SYSTEM.fullmatch(plain(name))
                       and rows[name].map(_SYSTEM_NUMBER.fullmatch).notna().all()]
            if systems and north is _METRES[0]:
                raise InvalidFeatures(f'its column {systems[0]!r} may name another coordinate '
                                      "system than the map's; convert its positions to lat and "
                                      'lon, or remove it')
            return with_positions(rows.drop(columns=columns), xy, in_degrees=north is _DEGREES[0])
    raise InvalidFeatures('the columns x and y [m], or lat and lon [degrees], are needed; there '
                          f'are {", ".join(rows) or "none"}')


def with_positions(rows: Any, xy: FloatArray, in_degrees: bool) -> GeoDataFrame:
    """A table with positions (L, 2) as points; those without a fix are missing.

    Raises InvalidFeatures if latitude and longitude are swapped for certain.
    """
    import geopandas

    fixed = np.asarray(np.isfinite(xy).all(axis=1))
    if in_degrees:
        on_earth, turned = ((np.abs(each) <= (360.0, 90.0)).all(axis=1)
                            for each in (xy, xy[:, ::-1]))
        if (fixed & turned).any() and not (fixed & on_earth).any():
            raise InvalidFeatures('latitudes are beyond 90 degrees: lat and lon are swapped')
        fixed &= on_earth & (np.abs(xy) > 1e-6).any(axis=1)
    points = geopandas.GeoSeries.from_xy(*np.nan_to_num(xy).T, index=rows.index,
                                         crs=WGS84 if in_degrees else None)
    return geopandas.GeoDataFrame(rows, geometry=points.where(fixed))
