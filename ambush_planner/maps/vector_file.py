# SPDX-License-Identifier: Apache-2.0
"""Points, lines and polygons from GeoPackage, GeoJSON and other vector files, and from CSV.

Features that cannot be used are counted in a warning, or refused where each of them matters.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from ..arrays import FloatArray
from ..errors import InvalidCoordinates, import_extra, warn
from ..option_checks import check_at_least
from .coordinates import (
    WGS84,
    Coordinates,
    converter,
    from_system,
    horizontal,
    longest_edge,
    resolve_system,
)
from .file_kinds import refuse_other_kinds
from .risk_map import RiskMap
from .tables import InvalidFeatures, find_column, prefixed_errors, read_numbers, read_positions

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# GDAL's drivers of vector files.
_DRIVERS = ('ESRI Shapefile', 'FlatGeobuf', 'GML', 'GPKG', 'GPX', 'GeoJSON', 'GeoJSONSeq',
            'KML', 'LIBKML', 'MapInfo File', 'OSM', 'OpenFileGDB', 'SQLite', 'TopoJSON')
_CONVERT = 'convert it to GeoPackage or GeoJSON'
# Layers of OSM and GPX files that are meant if none is named.
_USUAL = ('lines', 'points', 'multipolygons', 'waypoints', 'tracks')
# A remark of Overpass on what it left out.
_REMARK = re.compile(rb'<remark>\s*(runtime error.*?)\s*</remark>', re.DOTALL)
# Objects that an editor of OpenStreetMap has deleted, but not yet uploaded.
_DELETED = re.compile(rb"""\s(action\s*=\s*['"]delete|visible\s*=\s*['"]false)['"]""")


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
    with prefixed_errors(path):
        if not path.exists():
            raise InvalidFeatures('no such file')
        refuse_other_kinds(path, InvalidFeatures)
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
    import shapely

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
    bad = kept[(kept.geom_type == 'Polygon') & ~kept.geometry.is_valid].geometry
    if len(bad):
        raise InvalidFeatures(
            f'{path}: {len(bad)} of {len(kept)} polygons cross themselves, so that their area is '
            f'not known: {shapely.is_valid_reason(bad.iloc[0])}; mend them with Fix geometries in '
            'QGIS, or make_valid of geopandas')
    return _with_system(path, kept)


def _with_system(path: str, features: GeoDataFrame) -> GeoDataFrame:
    """Drop a system that says nothing; raises InvalidFeatures if it cannot be applied."""
    with prefixed_errors(path):
        features = features.set_crs(resolve_system(features.crs), allow_override=True)
        most = np.abs(features.total_bounds)
        if features.crs is not None and features.crs.is_geographic and not (
                most <= (360.0, 90.0, 360.0, 90.0)).all():
            x, y = features.total_bounds[:2]
            raise InvalidFeatures(f'coordinates such as ({x:.10g}, {y:.10g}) are no degrees of '
                                  'longitude and latitude, although its coordinate system is '
                                  f'{features.crs.name}; export it with the system that it is in')
        return features


def _read(path: Path, layer: str, kinds: Sequence[str]) -> GeoDataFrame:
    """Read the layer that is named, or the one that can have features of the kinds."""
    import pyogrio

    if path.suffix.lower() == '.shp':
        _check_parts(path)
    with _gdal(path):
        layers = dict(pyogrio.list_layers(path).tolist())
        if layer not in ('', *layers):
            raise InvalidFeatures(f'no layer {layer!r}; there is {", ".join(layers)}')
        driver = pyogrio.read_info(path, layer=next(iter(layers), None))['driver']
        if driver not in _DRIVERS:
            raise InvalidFeatures(f'files of the kind {driver} are not read; {_CONVERT}')
        fit = [layer] if layer else [each for each, geometry in layers.items() if geometry and (
            geometry in ('Unknown', 'GeometryCollection') or any(
                kind in geometry for kind in kinds))]
        if not fit or not layers[fit[0]]:
            has = ', '.join(f'{each} ({layers[each] or "a table"})' for each in fit or layers)
            raise InvalidFeatures(f'no layer with {" or ".join(kinds)} in it, but {has}')
        if len(fit) > 1 and driver in ('OSM', 'GPX'):
            fit = [each for each in fit if each in _USUAL][:1]
        if len(fit) > 1:
            raise InvalidFeatures(f'which layer? Write {path.name}|layername=NAME, with NAME one '
                                  f'of {", ".join(fit)}')
        frame = pyogrio.read_dataframe(path, layer=fit[0])
    return _without_deleted(path, fit[0], frame) if driver == 'OSM' else frame


@contextmanager
def _gdal(path: Path) -> Iterator[None]:
    """Read with GDAL: its errors and warnings in sentences, without names of its options."""
    import pyogrio

    # Otherwise GDAL refuses OpenStreetMap files with negative, large or unsorted numbers.
    indexing = 'NO' if path.suffix.lower() == '.osm' else None
    pyogrio.set_gdal_config_options({'OSM_USE_CUSTOM_INDEXING': indexing})
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter('always')
            yield
    except InvalidFeatures:
        raise
    except UnicodeDecodeError as error:
        raise InvalidFeatures('its texts are not in the encoding that its .cpg file names, or '
                              'UTF-8; correct that file') from error
    except (RuntimeError, ValueError) as error:  # pyogrio's are RuntimeErrors
        reason = str(error).split('; ')[0].removesuffix('.')
        raise InvalidFeatures(
            f'not a vector file of a kind that is read; {_CONVERT}' if 'not recognized' in reason
            else f'not a vector file that can be read ({reason}); it may be damaged, or end early'
        ) from error
    finally:
        pyogrio.set_gdal_config_options({'OSM_USE_CUSTOM_INDEXING': None})
    for text in dict.fromkeys(str(each.message) for each in said):
        warn(f'{path}: {text.split(". ")[0]}')


def _check_parts(path: Path) -> None:
    """Raise InvalidFeatures if parts of a shapefile are missing or disagree."""
    parts = {each.suffix.lower(): each for each in path.parent.iterdir() if each.stem == path.stem}
    if missing := {'.dbf', '.shx'}.difference(parts):
        raise InvalidFeatures(f'{", ".join(sorted(missing))} is missing; copy all files of the '
                              f'shapefile: {path.stem}.shp, .shx, .dbf and .prj')
    rows = int.from_bytes(parts['.dbf'].read_bytes()[4:8], 'little')
    shapes = (parts['.shx'].stat().st_size - 100) // 8
    if rows != shapes:
        raise InvalidFeatures(f'it has {shapes} shapes, but {parts[".dbf"].name} has {rows} rows; '
                              'copy all files of the shapefile together')


def _without_deleted(path: Path, layer: str, frame: GeoDataFrame) -> GeoDataFrame:
    """Leave out what an OpenStreetMap file marks as deleted."""
    text = path.read_bytes() if path.suffix.lower() == '.osm' else b''
    if remark := _REMARK.search(text):
        raise InvalidFeatures(f'Overpass did not finish it: {remark[1].decode(errors="replace")}; '
                              'ask again, for a smaller area')
    if not _DELETED.search(text):
        return frame
    gone = {(each.tag, each.get('id')) for _, each in ElementTree.iterparse(path)
            if each.get('action') == 'delete' or each.get('visible') == 'false'}
    kind = {'lines': 'way', 'points': 'node'}.get(layer, 'relation')
    deleted = np.zeros(len(frame), dtype=bool)
    for name, of in (('osm_id', kind), ('osm_way_id', 'way')):
        if name in frame:
            deleted |= frame[name].isin([number for tag, number in gone if tag == of])
    if deleted.any():
        warn(f'{path}: {deleted.sum()} of {len(frame)} features are deleted in the file, and are '
             'left out')
    return frame[~deleted]


def placement_hint(points: FloatArray, crs: Any, risk_map: RiskMap) -> str:
    """Say how positions (K, 2) in a system (none: unknown) are meant if none lies on the map."""
    swapped = points[:, ::-1]
    order = 'latitude and longitude' if crs and horizontal(crs).is_geographic else 'x and y'
    meant: list[tuple[FloatArray, Any, str]] = [(points, crs, ''),
                                                (swapped, crs, f'{order} are swapped')]
    if not (crs and horizontal(crs).is_geographic):
        meant += [(each, WGS84, 'they are degrees; name their coordinate system, or in a table '
                   'the columns lat and lon') for each in (points, swapped)]
    for each, system, text in meant:
        try:
            xy = from_system(each, system, risk_map.crs) if system else each
        except InvalidCoordinates:
            continue
        if risk_map.contains(risk_map.to_map_axes(xy)).any():
            return text
    return ''


def read_features_on(risk_map: RiskMap, source: str, *kinds: str, crs: str | None = None,
                refused: str = '') -> GeoDataFrame:
    """Read features (``read_features``) in the coordinates of a map.

    Those without a coordinate system have ``crs``. Raises InvalidFeatures if none is on the map, or
    only one of the systems is known.
    """
    import shapely

    features = given = read_features(source, *kinds, refused=refused)
    own = features.crs if features.crs is not None else crs
    with prefixed_errors(source):
        if risk_map.crs and not own:
            raise InvalidFeatures('its coordinate system is unknown, that of the map is '
                                  f'{risk_map.crs}; name it in the file, or with crs for all files')
        if own and own != risk_map.crs:
            features = _in_frame_of(risk_map, features, own)
        features = features.set_crs(None, allow_override=True)
        if not features.intersects(shapely.box(*np.ravel(risk_map.bounds))).any():
            (left, bottom), (right, top) = np.asarray(risk_map.bounds).tolist()
            hint = placement_hint(shapely.get_coordinates(given.geometry), given.crs, risk_map)
            raise InvalidFeatures(
                f'nothing in it lies on the map, which reaches from ({left:.0f}, {bottom:.0f}) to '
                f'({right:.0f}, {top:.0f}){": " * bool(hint)}{hint}')
    return features


def _in_frame_of(risk_map: RiskMap, features: GeoDataFrame, own: Any) -> GeoDataFrame:
    """Features of the system ``own`` in the frame of a map, without what is far from the map.

    Country-sized shapes can reach beyond the area of the map's system. Straight edges stay so.
    """
    import shapely

    if risk_map.crs:
        step, system = longest_edge(own), Coordinates(risk_map.crs)
        edge = shapely.get_coordinates(shapely.segmentize(
            shapely.box(*np.ravel(risk_map.bounds)), min(risk_map.size)))
        around = np.transpose(converter(system.crs, horizontal(own)).transform(
            *edge.T))
        near = *(around.min(axis=0) - 100.0 * step), *(around.max(axis=0) + 100.0 * step)
        shapes = features.geometry.where(features.geom_type == 'Point',
                                         features.clip_by_rect(*near))
        features = features.set_geometry(shapely.segmentize(shapes.to_numpy(), step)).explode()
    features = features.set_geometry(shapely.transform(
        features.geometry, lambda xy: from_system(xy, own, risk_map.crs)))
    return features[np.isfinite(features.bounds).all(axis=1)]


def attribute_values(features: GeoDataFrame, key: str, value: Any) -> FloatArray:
    """A number >= 0 for each feature: the same for all, or the attribute named by a text."""
    if not isinstance(value, str):
        value = float(value) if isinstance(value, bool) else value
        check_at_least(key, value, 0.0)
        return np.full(len(features), float(value))
    words = attribute(features, key, value).astype(str).str.lower()
    numbers = read_numbers(words.replace({'true': '1', 'yes': '1', 'false': '0', 'no': '0'}), value)
    if bad := int((~(numbers >= 0.0)).sum()):
        raise InvalidFeatures(f'{key}: attribute {value!r} of {bad} of {len(features)} features is '
                              'no number of at least 0')
    return numbers


def attribute(features: GeoDataFrame, key: str, name: str) -> Any:
    """The column of an attribute, in any case; raises InvalidFeatures if there is none."""
    names = features.columns.drop(features.geometry.name)
    if (found := find_column(names, name)) is None:
        raise InvalidFeatures(f'{key}: no attribute {name!r}; there is '
                              f'{", ".join(map(str, names)) or "none"}')
    return features[found]
