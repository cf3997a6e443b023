# SPDX-License-Identifier: Apache-2.0
"""Points, lines and polygons from GeoPackage, GeoJSON and other vector files, and from CSV.

Features that cannot be used are counted in a warning, or refused where each of them matters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError, InvalidCoordinates, import_extra, warn
from ..option_checks import check_at_least
from .coordinates import WGS84, Coordinates, in_metres
from .risk_map import RiskMap, to_map_axes

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# GDAL's drivers of vector files.
_DRIVERS = ('ESRI Shapefile', 'DXF', 'FlatGeobuf', 'GML', 'GPKG', 'GPX', 'GeoJSON', 'GeoJSONSeq',
            'KML', 'LIBKML', 'MapInfo File', 'OSM', 'OpenFileGDB', 'SQLite', 'TopoJSON')
# Layers of OSM and GPX files that are meant if none is named.
_USUAL = ('lines', 'points', 'multipolygons', 'waypoints', 'tracks')
# Columns of positions: degrees north and east, or metres.
_COLUMNS = (('lat', 'lon'), ('latitude', 'longitude'), ('lat', 'lng'), ('y', 'x'),
            ('northing', 'easting'))


class InvalidFeatures(AmbushPlannerError, ValueError):
    """A vector file is unreadable, or lacks features or attributes."""


def read_features(source: str, *kinds: str, refused: str = '') -> GeoDataFrame:
    """Read the features of ``kinds``, of 'Point', 'LineString' and 'Polygon', as single parts.

    ``source`` is a file, or ``FILE|layername=NAME`` as in QGIS; without a name, the layer is the
    one that has such features. A ``.csv`` file has points, in the columns lat and lon [degrees] or
    x and y [m]. Features of other kinds and without a geometry are left out; parts of one feature
    have its index.

    Warns of unread features; ``refused`` says why that is an error instead. Raises InvalidFeatures
    if there are none, or if several layers have some.
    """
    path, layer = file_and_layer(source)
    if not path.exists():
        raise InvalidFeatures(f'{path}: no such file')
    import_extra('geopandas', f'{path}: vector files', 'gis', InvalidFeatures)
    frame = read_positions(path) if path.suffix.lower() == '.csv' else _read(path, layer, kinds)
    return single_parts(str(path), frame, kinds, refused)


def file_and_layer(source: str) -> tuple[Path, str]:
    """The two parts of ``FILE|layername=NAME``; without a name it is ''."""
    name, _, layer = source.partition('|layername=')
    return Path(name).expanduser(), layer


def single_parts(path: str, frame: GeoDataFrame, kinds: Sequence[str],
                 refused: str = '') -> GeoDataFrame:
    """The single parts of some kinds in a table, as ``read_features`` returns them."""
    empty = frame.geometry.isna() | frame.geometry.is_empty
    parts = frame[~empty].explode()
    fits = parts.geom_type.isin(kinds)
    kept, others = parts[fits], parts[~fits]
    found = Counter(others[~others.index.duplicated()].geom_type)
    if empty.any():
        found['without a geometry'] = int(empty.sum())
    what = ', '.join(f'{count} {kind}' for kind, count in found.items())
    if kept.empty:
        raise InvalidFeatures(f'{path}: no {" or ".join(kinds)} in it{", but " * bool(what)}{what}')
    if found:
        text = f'{path}: {sum(found.values())} of {len(frame)} features are left out: {what}'
        if refused:
            raise InvalidFeatures(f'{text}; {refused}')
        warn(text)
    return kept


def _read(path: Path, layer: str, kinds: Sequence[str]) -> GeoDataFrame:
    """Read the layer that is named, or the one that can have features of the kinds."""
    import pyogrio

    try:
        if (driver := pyogrio.read_info(path)['driver']) not in _DRIVERS:
            raise ValueError(f'but of the kind {driver}')
        layers = [layer] if layer else [
            each for each, geometry in pyogrio.list_layers(path) if geometry and (
                geometry in ('Unknown', 'GeometryCollection') or any(
                    kind in geometry for kind in kinds))]
        if len(layers) > 1 and driver in ('OSM', 'GPX'):
            layers = [each for each in layers if each in _USUAL][:1]
        if len(layers) > 1:
            raise InvalidFeatures(f'{path}: which layer? Write {path.name}|layername=NAME, with '
                                  f'NAME one of {", ".join(layers)}')
        return pyogrio.read_dataframe(path, layer=layers[0] if layers else None)
    except InvalidFeatures:
        raise
    except (RuntimeError, ValueError) as error:  # pyogrio's are RuntimeErrors
        reason = str(error).split('; ')[0].removesuffix('.')
        raise InvalidFeatures(f'{path}: not a vector file that can be read ({reason}); it may be '
                              'damaged, or end early') from error


def read_positions(path: Path) -> GeoDataFrame:
    """Read a CSV file with a position in each row; raises InvalidFeatures.

    Its columns are lat and lon [degrees, WGS 84] or x and y [m], in any case. A position that is no
    number, or in degrees (0, 0) or not on the Earth, has no geometry.
    """
    import pandas

    try:
        rows = pandas.read_csv(path, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:  # of pandas
        raise InvalidFeatures(f'{path}: {" ".join(str(error).split())}') from error
    rows.columns = [str(name).strip().lower() for name in rows.columns]
    for north, east in _COLUMNS:
        if {north, east} <= set(rows):
            columns = (pandas.to_numeric(rows[name], errors='coerce') for name in (east, north))
            return with_positions(rows, np.stack([*columns], axis=1), in_degrees=north[0] == 'l')
    raise InvalidFeatures(f'{path}: the columns x and y [m], or lat and lon [degrees], are needed; '
                          f'there are {", ".join(rows)}')


def with_positions(rows: Any, xy: FloatArray, in_degrees: bool) -> GeoDataFrame:
    """A table with positions (L, 2) as points; those without a fix are missing."""
    import geopandas

    fixed = np.asarray(np.isfinite(xy).all(axis=1))
    if in_degrees:
        fixed &= (np.abs(xy) <= (360.0, 90.0)).all(axis=1) & (np.abs(xy) > 1e-6).any(axis=1)
    points = geopandas.GeoSeries.from_xy(*np.nan_to_num(xy).T, index=rows.index,
                                         crs=WGS84 if in_degrees else None)
    return geopandas.GeoDataFrame(rows, geometry=points.where(fixed))


def from_system(points: FloatArray, crs: str, map_crs: str | None) -> FloatArray:
    """Convert positions (K, 2) in the coordinate system ``crs`` to world positions of a map [m].

    If the map's system is unknown, positions in metres are assumed to be in the map's. Raises
    InvalidCoordinates if they are in another unit.
    """
    from pyproj import CRS, Transformer

    own = CRS.from_user_input(crs)
    if not map_crs:
        if not in_metres(own):
            raise InvalidCoordinates(f'the positions are not in metres ({own.name}), and the '
                                     'coordinate system of the map is unknown; name it with crs '
                                     '(map.crs)')
        return points
    system = Coordinates(map_crs)
    to_map = Transformer.from_crs(own, system.crs, always_xy=True)
    return to_map_axes(system.origin, np.stack(to_map.transform(*points.T), axis=-1))


def features_on(risk_map: RiskMap, source: str, *kinds: str, crs: str | None = None,
                refused: str = '') -> GeoDataFrame:
    """Read features (``read_features``) in the coordinates of a map.

    Those without a coordinate system have ``crs``. Raises InvalidFeatures if none is on the map, or
    only one of the systems is known.
    """
    import shapely

    features = read_features(source, *kinds, refused=refused)
    own = features.crs if features.crs is not None else crs
    if risk_map.crs and not own:
        raise InvalidFeatures(f'{source}: its coordinate system is unknown, that of the map is '
                              f'{risk_map.crs}; name it in the file, or with crs for all files')
    if own and own != risk_map.crs:
        try:
            features = features.set_geometry(shapely.transform(
                features.geometry, lambda xy: from_system(xy, own, risk_map.crs)), crs=None)
        except InvalidCoordinates as error:
            raise InvalidFeatures(f'{source}: {error}') from error
    low, high = risk_map.bounds
    if not features.intersects(shapely.box(*low, *high)).any():
        raise InvalidFeatures(f'{source}: nothing in it lies on the map, which reaches from '
                              f'({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f})')
    return features


def attribute_values(features: GeoDataFrame, key: str, value: Any) -> FloatArray:
    """A number >= 0 for each feature: the same for all, or the attribute named by a text."""
    from pandas import to_numeric

    if not isinstance(value, str):
        value = float(value) if isinstance(value, bool) else value
        check_at_least(key, value, 0.0)
        return np.full(len(features), float(value))
    words = attribute(features, key, value).astype(str).str.lower()
    words = words.replace({'true': '1', 'yes': '1', 'false': '0', 'no': '0'})
    numbers = np.asarray(to_numeric(words, errors='coerce'), dtype=np.float64)
    if bad := int((~(numbers >= 0.0)).sum()):
        raise InvalidFeatures(f'{key}: attribute {value!r} of {bad} of {len(features)} features is '
                              'no number of at least 0')
    return numbers


def attribute(features: GeoDataFrame, key: str, name: str) -> Any:
    """The column of an attribute, in any case; raises InvalidFeatures if there is none."""
    names = {str(each).lower(): each for each in features.columns if each != 'geometry'}
    if name not in features.columns and name.lower() not in names:
        others = ', '.join(map(str, names.values()))
        raise InvalidFeatures(f'{key}: no attribute {name!r}; there is {others or "none"}')
    return features[name if name in features.columns else names[name.lower()]]
