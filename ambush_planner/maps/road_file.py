# SPDX-License-Identifier: Apache-2.0
"""Roads from vector files and from the graphs of nav2_route."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption
from .vector_file import InvalidFeatures, read_features

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Decimals to which vertices are rounded, about 1 mm each; equal vertices are one place.
DIGITS_METRES, DIGITS_DEGREES = 3, 8
# Maximum number of connected parts with colours of their own in pictures.
MAX_NAMED = 9
# Values of ``oneway`` in OpenStreetMap, osmnx and Geofabrik's extracts (F, T, B).
ONE_WAY = {'yes': 1, 'true': 1, '1': 1, 'f': 1, '-1': -1, 'reverse': -1, 't': -1,
           'no': 0, 'false': 0, '0': 0, 'b': 0, 'none': 0, 'nan': 0, '': 0}


@dataclass(frozen=True, eq=False)
class RoadGraph:
    """Roads as straight pieces between places.

    Parameters
    ----------
    points : (P, 2) float
        Junctions, bends and ends of the roads, in the units of ``crs``.
    pairs : (U, 2) int
        The two places of each piece, the lower index first.
    speeds : (U, 2) float
        Driving speed from the first place to the second, and back; 0: not allowed.
    timed : bool
        Whether speeds are [m/s]; otherwise they are only 0 and 1.
    crs : str
        Coordinate system; '': that of the map.
    """

    points: FloatArray
    pairs: IndexArray
    speeds: FloatArray
    timed: bool = False
    crs: str = ''

    def __post_init__(self) -> None:
        for name, dtype in (('points', float), ('pairs', np.int64), ('speeds', float)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), dtype))

    def __repr__(self) -> str:
        return f'RoadGraph({len(self.pairs)} pieces)'


def read_roads(source: str | Path) -> RoadGraph:
    """Read the lines of a vector file (``read_features``), or a graph of nav2_route (GeoJSON).

    Lines meet where they share a vertex, so a bridge does not meet the road below. Attributes, as
    in OpenStreetMap and osmnx: ``oneway`` (yes, no, -1: against the line) and ``speed_kph``. Those
    of a graph of nav2_route: points with ``id``; lines with ``startid``, ``endid`` and, in their
    ``metadata``, ``abs_speed_limit`` [m/s], each in one direction and in the map's own metres.

    Raises InvalidOption if the file cannot be read, or an attribute is missing or malformed.
    """
    if not str(source):
        raise InvalidOption('graph must name a file with roads if method is graph')
    path = Path(str(source).partition('|layername=')[0]).expanduser()
    try:
        changed = path.stat()
        return _read(str(source), path, (changed.st_mtime_ns, changed.st_size))
    except (OSError, InvalidFeatures) as error:
        raise InvalidOption(f'graph: {error}') from error


@lru_cache(4)
def _read(source: str, path: Path, version: tuple[int, int]) -> RoadGraph:
    """Read the file again only if it has changed."""
    if path.suffix.lower() in ('.json', '.geojson'):
        try:
            features = json.loads(path.read_bytes())['features']
            if any('startid' in (each.get('properties') or {}) for each in features):
                return _nav2_graph(features)
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise InvalidFeatures(
                f'{path}: not a graph or FeatureCollection in GeoJSON: {error!r}') from error
    return roads_from_lines(str(path), read_features(source, 'LineString'))


def _nav2_graph(features: list[dict[str, Any]]) -> RoadGraph:
    places: dict[Any, int] = {}
    points: list[list[float]] = []
    for each in features:
        if each['geometry']['type'] == 'Point':
            places[each['properties']['id']] = len(points)
            points.append(each['geometry']['coordinates'][:2])
    tails, heads, speeds = [], [], []
    for each in features:
        properties, shape = each['properties'], each['geometry']
        if 'startid' not in properties:
            continue
        ends = []
        for name in ('startid', 'endid'):
            if properties[name] not in places:
                raise InvalidFeatures(f'edge {properties.get("id")}: no point has the id '
                                      f'{properties[name]} of its {name}')
            ends.append(places[properties[name]])
        lines = shape['coordinates']
        lines = lines if shape['type'] == 'MultiLineString' else [lines]
        bends = [place[:2] for line in lines for place in line][1:-1]
        chain = [ends[0], *range(len(points), len(points) + len(bends)), ends[1]]
        points += bends
        limit = (properties.get('metadata') or {}).get('abs_speed_limit')
        tails += chain[:-1]
        heads += chain[1:]
        speeds += [np.nan if limit is None else float(limit)] * (len(chain) - 1)
    forward = _speeds(np.array(speeds), 'abs_speed_limit')
    way = np.ones(len(tails), dtype=np.int64)
    return _graph(np.array(points, dtype=float), np.array([tails, heads]).T, way, forward, '')


def roads_from_lines(path: str, lines: GeoDataFrame) -> RoadGraph:
    """Join lines where they share a vertex; ``path`` is named in errors."""
    import shapely

    crs = lines.crs
    if 'oneway' not in lines and 'other_tags' in lines:  # GDAL's reader of OpenStreetMap files
        tags = lines['other_tags'].astype(str)
        lines = lines.assign(oneway=tags.str.extract('"oneway"=>"([^"]*)"', expand=False))
    coordinates, line = shapely.get_coordinates(lines.geometry, return_index=True)
    digits = DIGITS_DEGREES if crs is not None and crs.is_geographic else DIGITS_METRES
    _, first, place = np.unique(coordinates.round(digits), axis=0, return_index=True,
                                return_inverse=True)
    place = place.ravel()
    inner = line[1:] == line[:-1]
    segments = np.stack((place[:-1][inner], place[1:][inner]), axis=1)
    way = np.array([_direction(path, value) for value in lines['oneway']]
                   if 'oneway' in lines else np.zeros(len(lines)), dtype=np.int64)
    given = np.full(len(lines), np.nan)
    if 'speed_kph' in lines:
        try:
            given = lines['speed_kph'].to_numpy(dtype=float, na_value=np.nan) / 3.6
        except (TypeError, ValueError) as error:
            raise InvalidFeatures(f'{path}: speed_kph must be numbers: {error}') from error
    speed = _speeds(given, f'{path}: speed_kph')
    of = line[1:][inner]
    return _graph(coordinates[first], segments, way[of], None if speed is None else speed[of],
                  crs.to_wkt() if crs is not None else '')


def connected_parts(lines: GeoDataFrame) -> GeoDataFrame:
    """The pieces of lines, and the length of the connected ``part`` that each belongs to."""
    import geopandas
    import shapely

    roads = roads_from_lines('', lines[['geometry']])
    joined = coo_matrix((np.ones(len(roads.pairs)), tuple(roads.pairs.T)), [len(roads.points)] * 2)
    part = connected_components(joined, directed=False)[1][roads.pairs[:, 0]]
    pieces = shapely.linestrings(roads.points[roads.pairs])
    km = np.bincount(part, shapely.length(pieces)) / 1000.0
    least = np.sort(km)[-MAX_NAMED:][0]
    names = [f'{each:.4g} km' if each >= least else 'shorter' for each in km]
    return geopandas.GeoDataFrame({'part': [names[k] for k in part]}, geometry=pieces)


def _direction(path: str, value: object) -> int:
    text = str(value).strip().lower().removesuffix('.0')
    if text not in ONE_WAY:
        raise InvalidFeatures(f'{path}: oneway must be yes, no or -1, got {value!r}')
    return ONE_WAY[text]


def _speeds(values: FloatArray, name: str) -> FloatArray | None:
    """The speeds of all lines; None if none has one."""
    missing = ~np.isfinite(values)
    if missing.all():
        return None
    bad = missing | ~(values > 0.0)
    if bad.any():
        raise InvalidFeatures(f'{name}: {int(bad.sum())} of {len(bad)} lines have no speed above '
                              '0; give all lines one, or none')
    return values


def _graph(points: FloatArray, segments: IndexArray, way: IndexArray,
           speed: npt.NDArray[np.float64] | None, crs: str) -> RoadGraph:
    """Merge equal segments (S, 2), two-way if ``way`` (S,) is 0; the higher speed counts."""
    if not np.isfinite(points).all():
        raise InvalidFeatures('coordinates must be finite')
    own = np.ones(len(segments)) if speed is None else speed
    real = segments[:, 0] != segments[:, 1]
    turned = segments[:, 0] > segments[:, 1]
    there = np.where(way >= 0, own, 0.0)
    back = np.where(way <= 0, own, 0.0)
    there, back = np.where(turned, back, there)[real], np.where(turned, there, back)[real]
    pairs, which = np.unique(np.sort(segments[real], axis=1), axis=0, return_inverse=True)
    speeds = np.zeros((len(pairs), 2))
    np.maximum.at(speeds[:, 0], which.ravel(), there)
    np.maximum.at(speeds[:, 1], which.ravel(), back)
    if not len(pairs):
        raise InvalidFeatures('no road has a length')
    return RoadGraph(points, pairs, speeds, speed is not None, crs)
