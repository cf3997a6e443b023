# SPDX-License-Identifier: Apache-2.0
"""Roads from vector files and tables of lines, and from graphs of nav2_route, networkx, osmnx."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption, warn
from .road_tags import road_names, roads_among
from .vector_file import InvalidFeatures, file_and_layer, read_features, single_parts

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Decimals to which vertices are rounded, about 1 mm each; equal vertices are one place.
DIGITS_METRES, DIGITS_DEGREES = 3, 8
# Maximum number of connected parts with colours of their own in pictures.
MAX_NAMED = 9


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
    names : tuple of str
        Names of roads, and of villages and other places.
    name : (U,) int
        The name of each piece, by its index in ``names``; -1: none, which is the default.
    places : (K, 3) float
        Villages and other places: position, and index of the name.
    """

    points: FloatArray
    pairs: IndexArray
    speeds: FloatArray
    timed: bool = False
    crs: str = ''
    names: tuple[str, ...] = ()
    name: IndexArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    places: FloatArray = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        if not len(self.name):
            object.__setattr__(self, 'name', np.full(len(self.pairs), -1))
        for name, dtype in (('points', float), ('pairs', np.int64), ('speeds', float),
                            ('name', np.int64), ('places', float)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), dtype))

    def __repr__(self) -> str:
        return f'RoadGraph({len(self.pairs)} pieces)'


def read_roads(source: Any, node_crossings: bool = False) -> RoadGraph:
    """Read the roads of a file, a table of lines (GeoDataFrame), or a graph of networkx or osmnx.

    Lines meet where they share a vertex, so a bridge does not meet the road below. With
    ``node_crossings`` they also meet where they cross or touch, unless one is on a bridge or in a
    tunnel; else a warning counts these places. ``roads_among`` says which lines are roads, and in
    which direction.

    A file is a vector file (``read_features``) or a graph of nav2_route (GeoJSON): points with
    ``id``; lines with ``startid``, ``endid`` and, in their ``metadata``, ``abs_speed_limit`` [m/s],
    each in one direction and in the map's own metres.

    Raises InvalidOption if the roads cannot be read, or an attribute is missing or malformed.
    """
    try:
        if not isinstance(source, str | Path):
            if hasattr(source, 'adj'):
                source = lines_of_graph(source)
            if not hasattr(source, 'geometry'):
                raise InvalidFeatures(f'a {type(source).__name__} is neither a file, a '
                                      'GeoDataFrame nor a graph of networkx')
            lines = single_parts('roads', source, ['LineString'])
            return roads_from_lines('roads', lines, node_crossings)
        if not str(source):
            raise InvalidFeatures('must name a file with roads if method is graph')
        path, _ = file_and_layer(str(source))
        changed = path.stat()
        return _read(str(source), path, node_crossings, (changed.st_mtime_ns, changed.st_size))
    except (OSError, InvalidFeatures) as error:
        raise InvalidOption(f'graph: {error}') from error


@lru_cache(4)
def _read(source: str, path: Path, node_crossings: bool, version: tuple[int, int]) -> RoadGraph:
    """Read the file again only if it has changed."""
    if path.suffix.lower() in ('.json', '.geojson'):
        try:
            features = json.loads(path.read_bytes())['features']
            if any('startid' in (each.get('properties') or {}) for each in features):
                return _nav2_graph(features)
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise InvalidFeatures(
                f'{path}: not a graph or FeatureCollection in GeoJSON: {error!r}') from error
    if path.suffix.lower() == '.graphml':
        raise InvalidFeatures(f'{path}: convert GraphML with osmnx.save_graph_geopackage('
                              'osmnx.load_graphml(FILE), directed=True)')
    roads = roads_from_lines(str(path), read_features(source, 'LineString'), node_crossings)
    return _with_places(roads, path) if path.suffix.lower() in ('.osm', '.pbf') else roads


def _with_places(roads: RoadGraph, path: Path) -> RoadGraph:
    """Add the villages and other places of a file of OpenStreetMap."""
    import pyogrio

    found = pyogrio.read_dataframe(path, layer='points', columns=['name'],
                                   where='place IS NOT NULL AND name IS NOT NULL')
    index = len(roads.names) + np.arange(len(found))
    return replace(roads, names=(*roads.names, *found['name']),
                   places=np.column_stack((found.geometry.x, found.geometry.y, index)))


def lines_of_graph(graph: Any) -> GeoDataFrame:
    """The edges of a graph of networkx whose nodes have x and y (or ``pos``), as osmnx makes it.

    Edges of a directed graph are in one direction. Raises InvalidFeatures if a node has no place.
    """
    import geopandas
    import shapely

    places = {}
    for node, tags in graph.nodes(data=True):
        try:
            places[node] = [float(each) for each in tags.get('pos') or (tags['x'], tags['y'])]
        except (KeyError, TypeError, ValueError):
            raise InvalidFeatures(f'node {node} has no numbers x and y') from None
    rows = []
    for tail, head, tags in graph.edges(data=True):
        if not graph.is_directed() and str(tags.get('oneway', 'no')).lower() not in ('no', 'false'):
            raise InvalidFeatures('an undirected graph with one-way edges; give the directed one')
        shape = tags.get('geometry') or shapely.LineString((places[tail], places[head]))
        shape = shapely.from_wkt(shape) if isinstance(shape, str) else shape
        ends = [shapely.distance(shapely.Point(shape.coords[0]), shapely.Point(places[node]))
                for node in (tail, head)]
        rows.append({**tags, 'oneway': graph.is_directed(),
                     'geometry': shape.reverse() if ends[1] < ends[0] else shape})
    return geopandas.GeoDataFrame(rows, geometry='geometry', crs=graph.graph.get('crs'))


def _nav2_graph(features: list[dict[str, Any]]) -> RoadGraph:
    nodes = [each for each in features if each['geometry']['type'] == 'Point']
    places = {each['properties']['id']: k for k, each in enumerate(nodes)}
    points = [each['geometry']['coordinates'][:2] for each in nodes]
    segments: list[tuple[int, int]] = []
    speeds: list[float] = []
    for each in features:
        properties, shape = each['properties'], each['geometry']
        if 'startid' not in properties:
            continue
        for name in ('startid', 'endid'):
            if properties[name] not in places:
                raise InvalidFeatures(f'edge {properties.get("id")}: no point has the id '
                                      f'{properties[name]} of its {name}')
        lines = shape['coordinates']
        lines = lines if shape['type'] == 'MultiLineString' else [lines]
        bends = [place[:2] for line in lines for place in line][1:-1]
        segments += pairwise((places[properties['startid']],
                              *range(len(points), len(points) + len(bends)),
                              places[properties['endid']]))
        points += bends
        limit = (properties.get('metadata') or {}).get('abs_speed_limit')
        speeds += [np.nan if limit is None else float(limit)] * (len(bends) + 1)
    return _graph(np.array(points, dtype=float), np.array(segments),
                  np.ones(len(segments), dtype=np.int64),
                  _speeds(np.array(speeds), 'abs_speed_limit'), '')


def roads_from_lines(path: str, lines: GeoDataFrame, node_crossings: bool = False) -> RoadGraph:
    """Join lines that are roads where they share a vertex, as ``read_roads`` says.

    ``path`` is named in errors and warnings.
    """
    lines, tags = roads_among(path, lines)
    points, segments, line, digits = _segments(lines)
    crossings = _crossings(points, segments, np.array([road.level for road in tags])[line])
    if node_crossings:
        points, segments, line = _noded(points, segments, line, *crossings, digits)
    elif count := len(np.unique(crossings[2].round(digits), axis=0)):
        warn(f'{path}: roads cross or touch at {count} places without a shared vertex, bridges and '
             'tunnels apart; these are no junctions unless --node-crossings (node_crossings) joins '
             'them')
    way = np.array([road.way for road in tags])
    speed = _speeds(np.array([road.speed for road in tags]), f'{path}: speed_kph')
    names, name = np.unique(road_names(lines), return_inverse=True)
    return _graph(points, segments, way[line], None if speed is None else speed[line],
                  lines.crs.to_wkt() if lines.crs is not None else '', names.tolist(), name[line])


def connected_parts(lines: GeoDataFrame) -> GeoDataFrame:
    """The pieces of lines, and the length of the connected ``part`` that each belongs to."""
    import geopandas
    import shapely

    points, segments, *_ = _segments(lines)
    joined = coo_matrix((np.ones(len(segments)), tuple(segments.T)), [len(points)] * 2)
    part = connected_components(joined, directed=False)[1][segments[:, 0]]
    pieces = shapely.linestrings(points[segments])
    km = np.bincount(part, shapely.length(pieces)) / 1000.0
    least = np.sort(km)[-MAX_NAMED:][0]
    names = [f'{each:.4g} km' if each >= least else 'shorter' for each in km]
    return geopandas.GeoDataFrame({'part': [names[k] for k in part]}, geometry=pieces)


def _segments(lines: GeoDataFrame) -> tuple[FloatArray, IndexArray, IndexArray, int]:
    """Places (P, 2), segments between them (S, 2), the line of each (S,), decimals of places."""
    import shapely

    coordinates, line = shapely.get_coordinates(lines.geometry, return_index=True)
    in_degrees = lines.crs is not None and lines.crs.is_geographic
    if in_degrees:  # continuous across the antimeridian
        first = coordinates[0, 0]
        coordinates[:, 0] = (coordinates[:, 0] - first + 180.0) % 360.0 + first - 180.0
    digits = DIGITS_DEGREES if in_degrees else DIGITS_METRES
    points, place = _places(coordinates, digits)
    inner = line[1:] == line[:-1]
    return points, np.stack((place[:-1], place[1:]), axis=1)[inner], line[1:][inner], digits


def _places(points: FloatArray, digits: int) -> tuple[FloatArray, IndexArray]:
    """Places that are equal to the given decimals once, and the place of each."""
    _, first, place = np.unique(points.round(digits), axis=0, return_index=True,
                                return_inverse=True)
    return points[first], place.ravel()


def _crossings(points: FloatArray, segments: IndexArray,
               level: IndexArray) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Segments that meet others of their level without a shared place: two (C,), where (C, 2)."""
    import shapely

    shapes = shapely.linestrings(points[segments])
    one, other = shapely.STRtree(shapes).query(shapes, predicate='intersects')
    apart = (segments[one][:, :, None] != segments[other][:, None, :]).all(axis=(1, 2))
    new = (one < other) & apart & (level[one] == level[other])
    at = shapely.intersection(shapes[one[new]], shapes[other[new]])
    single = shapely.get_type_id(at) == shapely.GeometryType.POINT
    return one[new][single], other[new][single], shapely.get_coordinates(at[single])


def _noded(points: FloatArray, segments: IndexArray, line: IndexArray, one: IndexArray,
           other: IndexArray, at: FloatArray,
           digits: int) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Cut segments where they meet (``_crossings``)."""
    every, place = _places(np.concatenate((points, at)), digits)
    ends, met, number = place[segments], place[len(points):], np.arange(len(segments))
    segment = np.concatenate((number, one, other, number))
    node = np.concatenate((ends[:, 0], met, met, ends[:, 1]))
    along = np.hypot(*(every[node] - every[ends[segment, 0]]).T)
    order = np.lexsort((along, segment))
    segment, node = segment[order], node[order]
    inner = segment[1:] == segment[:-1]
    return every, np.stack((node[:-1], node[1:]), axis=1)[inner], line[segment[1:][inner]]


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
           speed: npt.NDArray[np.float64] | None, crs: str, names: Sequence[str] = (),
           name: IndexArray | None = None) -> RoadGraph:
    """Merge equal segments (S, 2), two-way if ``way`` (S,) is 0; the higher speed counts.

    ``name`` (S,) has their indices in ``names``; the first one counts.
    """
    if not np.isfinite(points).all():
        raise InvalidFeatures('coordinates must be finite')
    own = np.ones(len(segments)) if speed is None else speed
    real = segments[:, 0] != segments[:, 1]
    turned = segments[:, 0] > segments[:, 1]
    there = np.where(way >= 0, own, 0.0)
    back = np.where(way <= 0, own, 0.0)
    there, back = np.where(turned, back, there)[real], np.where(turned, there, back)[real]
    pairs, first, which = np.unique(np.sort(segments[real], axis=1), axis=0, return_index=True,
                                    return_inverse=True)
    speeds = np.zeros((len(pairs), 2))
    np.maximum.at(speeds[:, 0], which.ravel(), there)
    np.maximum.at(speeds[:, 1], which.ravel(), back)
    if not len(pairs):
        raise InvalidFeatures('no road has a length')
    return RoadGraph(points, pairs, speeds, speed is not None, crs, tuple(names),
                     np.full(len(pairs), -1) if name is None else name[real][first])
