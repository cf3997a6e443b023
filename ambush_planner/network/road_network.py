# SPDX-License-Identifier: Apache-2.0
"""The network of a trip on roads: nodes at all junctions and bends, and at least every spacing.

Edges lie on the roads' own lines. Start, stops and goal that do not lie on a road are joined to the
nearest place on one by a straight edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, members
from ..errors import InvalidCoordinates, InvalidOption, NoRoute
from ..maps.coordinates import agree, from_system, longest_edge
from ..maps.obstacles import ObstacleField, nearest_on_segments
from ..maps.risk_map import RiskMap
from ..maps.road_file import RoadGraph
from ..maps.vector_file import placement_hint
from .shortest_paths import edge_matrix, reachable_from
from .trip_graph import Position, TripGraph, position_errors, position_text

# Distance at which a position is on a road, or at one of its nodes [m].
ON_ROAD = 1e-3


def roads_on_map(roads: RoadGraph, risk_map: RiskMap) -> RoadGraph:
    """Return the roads in the map's coordinates, without pieces beyond its bounds.

    Raises InvalidOption if none is left for a known reason.
    """
    given, roads = roads, in_map_frame(roads, risk_map.crs)
    uv = risk_map.to_map_axes(roads.points)[roads.pairs]
    inside = ((uv.max(axis=1) >= 0.0) & (uv.min(axis=1) <= risk_map.size)).all(axis=1)
    if not inside.any() and (hint := placement_hint(given.points, given.crs, risk_map)):
        raise InvalidOption(f'graph: none of its roads lies on the map: {hint}')
    return replace(roads, pairs=roads.pairs[inside], speeds=roads.speeds[inside],
                   name=roads.name[inside])


@lru_cache(4)
def in_map_frame(roads: RoadGraph, crs: str | None) -> RoadGraph:
    """Return the roads in the coordinates of a map with the coordinate system ``crs`` [m].

    Roads in metres without a coordinate system are taken to be in the map's. Raises InvalidOption
    if they are in another unit.
    """
    if not roads.crs:
        return roads
    try:
        spacing = longest_edge(roads.crs) if crs and not agree(roads.crs, crs) else np.inf
        pieces = _cut(roads, spacing)
        places = np.column_stack((from_system(roads.places[:, :2], roads.crs, crs),
                                  roads.places[:, 2]))
        return replace(pieces, points=from_system(pieces.points, roads.crs, crs), crs='',
                       places=places)
    except InvalidCoordinates as error:
        raise InvalidOption(f'graph: {error}') from error


def road_length(roads: RoadGraph) -> float:
    """Return the length of all roads [m], each in one direction."""
    return float(np.hypot(*(roads.points[roads.pairs[:, 1]] - roads.points[roads.pairs[:, 0]]).T)
                 .sum())


@dataclass(eq=False)
class _Pieces:
    """Roads as pieces between nodes, as in ``RoadGraph``, to which ends are being joined."""

    points: FloatArray
    pairs: IndexArray
    speeds: FloatArray

    def add_node(self, place: FloatArray) -> int:
        self.points = np.vstack((self.points, place))
        return len(self.points) - 1

    def nearest(self, place: FloatArray) -> tuple[float, int, FloatArray]:
        """Find the nearest piece to a place: distance, number, and its nearest point."""
        a, b = self.points[self.pairs[:, 0]], self.points[self.pairs[:, 1]]
        feet = nearest_on_segments(place, a, b)
        distance = np.hypot(*(feet - place).T)
        piece = int(np.argmin(distance))
        return float(distance[piece]), piece, feet[piece]

    def node_at(self, piece: int, foot: FloatArray) -> int:
        """Return the node at a point of a piece; cut the piece there unless it ends there."""
        a, b = self.pairs[piece].tolist()
        for node in (a, b):
            if np.hypot(*(self.points[node] - foot)) <= ON_ROAD:
                return int(node)
        node, speeds = self.add_node(foot), self.speeds[piece]
        self.pairs = np.vstack((np.delete(self.pairs, piece, axis=0), [(a, node), (node, b)]))
        self.speeds = np.vstack((np.delete(self.speeds, piece, axis=0), speeds, speeds))
        return node


def road_trip_graph(risk_map: RiskMap, field: ObstacleField, roads: RoadGraph,
                    ends: dict[str, Position], spacing: float, clearance: float,
                    join_distance: float) -> TripGraph:
    """Cut the roads at least every ``spacing`` [m], and join the ends, given by name, to them.

    Raises StartBlocked, StopBlocked or GoalBlocked if no road is within ``join_distance`` [m], or
    an obstacle lies in between; NoRoute if the roads do not connect the ends.
    """
    whole = _cut(roads_on_map(roads, risk_map), spacing)
    uv = risk_map.to_map_axes(whole.points)
    tails, heads = uv[whole.pairs.T]
    clear = field.clear_segments(tails, heads, clearance)
    pieces = _Pieces(whole.points.copy(), whole.pairs[clear], whole.speeds[clear])
    visits: dict[Position, int] = {}
    links, link_speeds = [], []
    for name, position in ends.items():
        if position in visits:
            continue
        node, place = _join(pieces, name, position, join_distance), np.array(position)
        if np.hypot(*(pieces.points[node] - place)) <= ON_ROAD:
            pieces.points[node] = place
            visits[position] = node
            continue
        tail, head = risk_map.to_map_axes(np.stack((place, pieces.points[node])))
        if not field.clear_segments(tail[None], head[None], clearance)[0]:
            raise position_errors(name)[1](
                f'{position_text(name, position)}: an obstacle lies between it and the nearest '
                'road; move it')
        links.append((node, pieces.add_node(place)))
        link_speeds.append(pieces.speeds[(pieces.pairs == node).any(axis=1)].max())
        visits[position] = links[-1][1]
    if links:
        pieces.pairs = np.vstack((pieces.pairs, links))
        pieces.speeds = np.vstack((pieces.speeds, np.tile(link_speeds, (2, 1)).T))
    graph = _graph(risk_map, pieces, tuple(visits[each] for each in ends.values()), roads.timed)
    _check_connected(graph, ends, int((~clear).sum()))
    return graph


def _cut(roads: RoadGraph, spacing: float) -> RoadGraph:
    """Cut each piece of road into equal parts of at most ``spacing`` [m]."""
    a, b = roads.points[roads.pairs[:, 0]], roads.points[roads.pairs[:, 1]]
    count = np.maximum(np.ceil(np.hypot(*(b - a).T) / spacing - 1e-9), 1.0).astype(np.int64)
    road, k = members(count)
    inner = k > 0
    share = (k / count[road])[inner, None]
    added = a[road[inner]] * (1.0 - share) + b[road[inner]] * share
    number = len(roads.points) + np.cumsum(inner) - 1
    tails = np.where(inner, number, roads.pairs[road, 0])
    last = k == count[road] - 1
    heads = np.where(last, roads.pairs[road, 1], number + 1)
    return replace(roads, points=np.concatenate((roads.points, added)),
                   pairs=np.stack((tails, heads), axis=1), speeds=roads.speeds[road],
                   name=roads.name[road])


def _join(pieces: _Pieces, name: str, position: Position, join_distance: float) -> int:
    """Return the node at the place on a road that is nearest to a position."""
    distance, piece, foot = np.inf, 0, np.zeros(2)
    if len(pieces.pairs):
        distance, piece, foot = pieces.nearest(np.array(position))
    if distance > join_distance:
        nearest = (f'{distance:.1f} m from the nearest road, at ({foot[0]:.1f}, {foot[1]:.1f})'
                   if distance < np.inf else 'on a map without roads')
        raise position_errors(name)[1](
            f'{position_text(name, position)} is {nearest}; move it, or raise join_distance '
            f'({join_distance:g} m)')
    return pieces.node_at(piece, foot)


def _graph(risk_map: RiskMap, pieces: _Pieces, visits: tuple[int, ...], timed: bool) -> TripGraph:
    """Make the graph of the pieces, without nodes that no piece leads to."""
    used, pairs = np.unique(pieces.pairs, return_inverse=True)
    pairs = pairs.reshape(-1, 2)
    points = pieces.points[used]
    ends = np.searchsorted(used, visits)
    alpha = risk_map.alpha[risk_map.cells(risk_map.to_map_axes(points))]
    alpha[ends] = 0.0
    speeds = np.concatenate(pieces.speeds.T)
    edges = np.concatenate((pairs, pairs[:, ::-1]))[speeds > 0.0]
    lengths = np.hypot(*(points[edges[:, 1]] - points[edges[:, 0]]).T)
    seconds = lengths / speeds[speeds > 0.0] if timed else None
    return TripGraph(points, alpha, edges, tuple(ends.tolist()), seconds)


def _check_connected(graph: TripGraph, ends: dict[str, Position], blocked: int) -> None:
    count, (start, *_, goal) = len(graph.points), graph.visits
    from_start = reachable_from(graph.edges, count, start)
    from_goal = reachable_from(graph.edges[:, ::-1], count, goal)
    nodes = dict(zip(ends, graph.visits, strict=True))
    for name, node in nodes.items():
        for reached, one, other in ((from_start, 'start', name), (from_goal, name, 'goal')):
            if not reached[node]:
                raise NoRoute(f'no road leads from {position_text(one, ends[one])} to '
                              f'{position_text(other, ends[other])}: '
                              f'{_obstruction(graph, nodes[one], nodes[other], blocked)}')


def _obstruction(graph: TripGraph, one: int, other: int, blocked: int) -> str:
    """Say why no road leads from one node to another: one-way roads, or separate parts."""
    count = len(graph.points)
    matrix = edge_matrix(graph.edges, np.ones(len(graph.edges)), count)
    parts, part = connected_components(matrix, directed=False)
    if part[one] == part[other]:
        return 'the roads between them are one-way in the other direction'
    pairs = np.unique(np.sort(graph.edges, axis=1), axis=0)
    length = np.hypot(*(graph.points[pairs[:, 1]] - graph.points[pairs[:, 0]]).T)
    km = np.bincount(part[pairs[:, 0]], length, parts) / 1000.0
    own, others = (graph.points[part == part[node]] for node in (one, other))
    distance, nearest = cKDTree(others).query(own)
    k = int(np.argmin(distance))
    (x, y), (u, v) = own[k], others[nearest[k]]
    cut = f'; obstacles of the map block {blocked} pieces of road' if blocked else ''
    return (f'they are on two of {parts} separate parts, of {km[part[one]]:.3g} and '
            f'{km[part[other]]:.3g} km, {distance[k]:.3g} m apart at ({x:.1f}, {y:.1f}) and '
            f'({u:.1f}, {v:.1f}){cut}; '
            'lines meet only where they share a vertex (ambush risk draws the parts)')
