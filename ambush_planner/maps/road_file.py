# SPDX-License-Identifier: Apache-2.0
"""Roads from vector files and tables of lines, and from graphs of nav2_route."""

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

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption, warn
from .road_joints import cut_at_meetings, segments_of
from .road_tags import select_roads
from .tables import InvalidFeatures, prefixed_errors
from .vector_file import file_and_layer, read_features, single_parts

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Options of ``read_roads``.
ROAD_OPTIONS = ('node_crossings', 'road_column', 'all_lines_are_roads', 'two_way')


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


def read_roads(source: Any, node_crossings: bool = False, **declared: Any) -> RoadGraph:
    """Read the roads of a file, or of a table of lines (GeoDataFrame).

    Lines meet where they share a vertex, so a bridge does not meet the road below. With
    ``node_crossings`` they also meet where they cross or touch, ends to 5 cm, unless one is on a
    bridge or in a tunnel; else a warning counts these places. ``select_roads`` says which lines are
    roads, and in which direction; ``declared`` are its options.

    A file is a vector file (``read_features``) or a graph of nav2_route (GeoJSON): points with
    ``id``; lines with ``startid``, ``endid`` and, in their ``metadata``, ``abs_speed_limit`` [m/s],
    each in one direction and in the map's own metres.

    Raises InvalidOption if the roads cannot be read, or an attribute is missing or malformed.
    """
    try:
        if not isinstance(source, str | Path):
            if not hasattr(source, 'geometry'):
                raise InvalidFeatures(
                    f'a {type(source).__name__} is neither a file nor a GeoDataFrame; of a graph '
                    'of networkx, give the edges: osmnx.graph_to_gdfs(graph, nodes=False)')
            lines = single_parts('roads', source, ['LineString'])
            return roads_from_lines('roads', lines, node_crossings, **declared)
        if not str(source):
            raise InvalidFeatures('must name a file with roads if method is graph')
        path, _ = file_and_layer(str(source))
        changed = path.stat()
        return _read(str(source), path, (changed.st_mtime_ns, changed.st_size), node_crossings,
                     **declared)
    except (OSError, InvalidFeatures) as error:
        raise InvalidOption(f'graph: {error}') from error


@lru_cache(4)
def _read(source: str, path: Path, version: tuple[int, int], node_crossings: bool,
          **declared: Any) -> RoadGraph:
    """Read the file again only if it has changed."""
    with prefixed_errors(path):
        if path.suffix.lower() in ('.json', '.geojson') and b'"startid"' in path.read_bytes():
            if node_crossings or any(declared.values()):
                raise InvalidFeatures('a route graph says itself where it leads; leave out '
                                      f'{", ".join(ROAD_OPTIONS)}')
            try:
                return _nav2_graph(json.loads(path.read_bytes())['features'])
            except (ValueError, KeyError, TypeError, IndexError) as error:
                if isinstance(error, InvalidFeatures):
                    raise
                raise InvalidFeatures(f'not a route graph: {error!r}') from error
        if path.suffix.lower() == '.graphml':
            raise InvalidFeatures('convert GraphML with osmnx.save_graph_geopackage('
                                  'osmnx.load_graphml(FILE), directed=True)')
        roads = roads_from_lines(str(path), read_features(source, 'LineString'), node_crossings,
                                 **declared)
        if (found := places_in(path)) is None:
            return roads
        index = len(roads.names) + np.arange(len(found))
        return replace(roads, names=(*roads.names, *found['name']),
                       places=np.column_stack((found.geometry.x, found.geometry.y, index)))


def places_in(path: Path) -> GeoDataFrame | None:
    """Return the villages and other places with a ``name``; None if not of OpenStreetMap."""
    if path.suffix.lower() not in ('.osm', '.pbf'):
        return None
    import pyogrio

    return pyogrio.read_dataframe(path, layer='points', columns=['name'],
                                  where='place IS NOT NULL AND name IS NOT NULL')


def _nav2_graph(features: list[dict[str, Any]]) -> RoadGraph:
    nodes = [each for each in features if each['geometry']['type'] == 'Point']
    for each in nodes:
        if (frame := each['properties'].get('frame') or 'map') != 'map':
            raise InvalidFeatures(f'node {each["properties"].get("id")} is in the frame {frame!r}; '
                                  "give its position in the map's frame, and name that map")
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


def roads_from_lines(path: str, lines: GeoDataFrame, node_crossings: bool,
                     **declared: Any) -> RoadGraph:
    """Join lines that are roads where they share a vertex, as ``read_roads`` says.

    ``path`` is named in errors and warnings; ``declared`` are options of ``select_roads``.
    """
    apart = 'lines that share a vertex at different heights or levels do not meet, at {} places'
    try:
        lines, tags, named = select_roads(path, lines, **declared)
    except InvalidFeatures as error:
        split = segments_of(lines).split
        also = f'; also, {apart.format(split)}' if split else ''
        raise InvalidFeatures(f'{error}{also}') from error
    if lines.crs is None:
        warn(f'{path}: its coordinate system is unknown; its coordinates are taken as those of the '
             'map')
    level = np.array([road.level for road in tags])
    segments = segments_of(lines, level)
    if segments.split:
        warn(f'{path}: {apart.format(segments.split)}')
    joined, count = cut_at_meetings(segments, level)
    if node_crossings:
        segments = joined
    elif count:
        warn(f'{path}: roads cross or touch at {count} places without a shared vertex, bridges and '
             'tunnels apart; these are no junctions unless --node-crossings (node_crossings) joins '
             'them')
    way, line = np.array([road.way for road in tags]), segments.line
    speed = _speeds(np.array([road.speed for road in tags]), f'{path}: speed_kph')
    names, name = np.unique(named, return_inverse=True)
    return _graph(segments.points / segments.scale, segments.pairs, way[line],
                  None if speed is None else speed[line],
                  lines.crs.to_wkt() if lines.crs is not None else '', names.tolist(), name[line])


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
