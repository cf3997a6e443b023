# SPDX-License-Identifier: Apache-2.0
"""Way points of a path: the places that its driver must not miss.

Off roads they are the path's main corners. On roads they are the junctions at which the route turns
or another road forks off; a roundabout counts as one junction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..maps.obstacles import nearest_on_segments
from ..maps.road_file import RoadGraph
from ..maps.road_tags import ROUNDABOUT
from ..network.road_network import ON_ROAD
from .legs import corners_of_legs, distances_along

# Maximum number of way points on roads, to fit one page, unless more of them are turns.
MAX_ROWS = 36
# Distance of start and goal from a road, and of junctions from them, that is not mentioned [m].
NEAR = 5.0
# Distance over which the direction of a road is measured at a junction [m].
BASE = 25.0
# Turning angles [degrees] from which a way bears to a side, turns, turns sharply, and turns back;
# and angle up to which another road makes a fork of a way straight on.
BEAR, TURN, SHARP, BACK, FORK = 30.0, 55.0, 125.0, 165.0, 45.0
_COMPASS = ('north', 'north-east', 'east', 'south-east', 'south', 'south-west', 'west',
            'north-west')
_ORDINALS = {1: '1st', 2: '2nd', 3: '3rd'}
STRAIGHT = 'straight on'


@dataclass(frozen=True, eq=False)
class WayPoint:
    """A place (2,) [m] on a path, with its ``distance`` along the path [m].

    Start, stops and goal have a ``name``. On roads, ``action`` is the instruction, ``road`` the
    name of the road that follows, and ``passed`` the number of junctions before the next way point.
    """

    xy: FloatArray
    distance: float
    name: str = ''
    action: str = ''
    road: str = ''
    passed: int = 0

    @property
    def text(self) -> str:
        """The instruction, such as ``left: B 55``."""
        then = f', then pass {self.passed}' if self.passed else ''
        return ': '.join(filter(None, (self.action, self.road))) + then

    @property
    def label(self) -> str:
        """Name and instruction."""
        return ', '.join(filter(None, (self.name, self.text)))


def way_points(path: FloatArray, names: Sequence[str], stops: FloatArray,
               line: FloatArray | None = None, roads: RoadGraph | None = None) -> list[WayPoint]:
    """Return the way points of a path (L, 2) via stops (S, 2).

    ``names`` are those of start, stops and goal. On ``roads``, ``line`` (K, 2) are the nodes of the
    route that the path follows.
    """
    if line is None or roads is None:
        corners = corners_of_legs(path, stops)
        found = [WayPoint(path[k], travelled) for k, travelled in
                 zip(corners, distances_along(path)[corners].tolist(), strict=True)]
    else:
        found = _drop_followed(_junctions(line, stops, roads, float(distances_along(path)[-1])))
    places = np.array([each.xy for each in found])
    first = 0
    for name, xy in zip(names[1:-1], stops, strict=True):
        first += int(np.hypot(*(places[first:] - xy).T).argmin())
        found[first] = replace(found[first], name=name)
    found[0], found[-1] = (replace(found[k], name=names[k]) for k in (0, -1))
    return found


@dataclass(frozen=True, eq=False)
class _Roads:
    """Roads as a graph of places, for queries at junctions."""

    graph: RoadGraph

    @cached_property
    def _arms(self) -> tuple[IndexArray, IndexArray, IndexArray, FloatArray]:
        """Place, other place, name and speed of each piece in both directions, by place."""
        pairs = self.graph.pairs
        ends = np.concatenate((pairs, pairs[:, ::-1]))
        order = np.argsort(ends[:, 0], kind='stable')
        return (*ends[order].T, np.tile(self.graph.name, 2)[order],
                np.concatenate(self.graph.speeds.T)[order])

    def arms(self, place: int) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Other places of the pieces at a place, their names, and the speeds towards them."""
        tails, heads, name, speed = self._arms
        leaving = slice(*np.searchsorted(tails, (place, place + 1)))
        return heads[leaving], name[leaving], speed[leaving]

    def degrees(self, places: IndexArray) -> IndexArray:
        """Number of pieces at each of the places."""
        return np.bincount(self._arms[0], minlength=len(self.graph.points))[places]

    def direction(self, place: int, head: int) -> FloatArray:
        """Direction (2,) of the road that leaves a place towards another one."""
        begin, previous = self.graph.points[place], place
        while np.hypot(*(self.graph.points[head] - begin)) < BASE:
            heads = self.arms(head)[0]
            if len(heads) != 2 or head == place:
                break
            previous, head = head, int(heads[heads != previous][0])
        return self.graph.points[head] - begin

    def nearest(self, xy: FloatArray) -> tuple[float, str]:
        """Distance to the nearest road [m], and its name."""
        a, b = self.graph.points[self.graph.pairs.T]
        distance = np.hypot(*(nearest_on_segments(xy, a, b) - xy).T)
        return float(distance.min()), self.name(int(self.graph.name[distance.argmin()]))

    def name(self, index: int) -> str:
        return self.graph.names[index] if index >= 0 else ''


def _junctions(line: FloatArray, stops: FloatArray, graph: RoadGraph,
               length: float) -> list[tuple[WayPoint, bool]]:
    """Find all way points of a route (K, 2) on roads, whose path has a ``length`` [m].

    Each comes with whether the route merely follows its road there.
    """
    roads = _Roads(graph)
    line = line[np.r_[True, np.diff(line, axis=0).any(axis=1)]]
    travelled = distances_along(line)
    offset, place = cKDTree(graph.points).query(line)
    crossing = (offset <= ON_ROAD) & (roads.degrees(place) > 2)
    ends = [0, *(int(np.hypot(*(line - stop).T).argmin()) for stop in stops), len(line) - 1]
    # Edges between the ends and the roads, and the nodes at which these meet.
    loose = [k for k in ends if roads.nearest(line[k])[0] > NEAR]
    links = {min(k, k + step) for k in loose for step in (-1, 0)} & set(range(len(line) - 1))
    joints = {k + step for k in loose for step in (-1, 1)}
    inner = (travelled > NEAR) & (travelled < travelled[-1] - NEAR)
    events = sorted({*ends, *(joints & set(range(len(line)))),
                     *np.flatnonzero(crossing & inner).tolist()})

    def name(edge: int) -> str:
        """Name of the road along an edge of the route."""
        if edge in links:
            return ''
        if offset[edge] <= ON_ROAD:
            return roads.name(_arm_towards(roads, place[edge], line[edge + 1] - line[edge])[1])
        return roads.nearest((line[edge] + line[edge + 1]) / 2.0)[1]

    found: list[tuple[WayPoint, bool]] = []
    exits = 0  # number of exits passed on a roundabout, whose way point is its entry; 0: on none
    for k, before, after in zip(events, [0, *events], [*events[1:], len(line) - 1], strict=False):
        point = WayPoint(line[k], float(travelled[k] * length / travelled[-1]))
        if k == len(line) - 1:
            found.append((point, False))
            break
        departure = _point_at(line, travelled, min(travelled[k] + BASE, travelled[after])) - line[k]
        point = replace(point, road=name(k))
        if k == 0:
            towards = _COMPASS[round(np.degrees(np.arctan2(*departure)) / 45.0) % 8]
            found.append((replace(point, action=towards), False))
            continue
        arrival = line[k] - _point_at(line, travelled, max(travelled[k] - BASE, travelled[before]))
        others = [] if not crossing[k] else _other_arms(roads, place[k], line[k - 1:k + 2])
        if exits:
            number = _ORDINALS.get(exits, f'{exits}th')
            entry = replace(found[-1][0], action=f'roundabout, {number} exit', road=point.road)
            found[-1] = entry, False
            exits = exits + bool(others) if point.road == ROUNDABOUT else 0
            continue
        exits = int(point.road == ROUNDABOUT)
        follows = name(k - 1) == point.road and k not in ends
        if others or not follows or k in joints:
            turns = [_angle(arrival, each) for each in others]
            action = _action(_angle(arrival, departure), turns)
            found.append((replace(point, action=action), follows and action == STRAIGHT))
    return found


def _drop_followed(found: list[tuple[WayPoint, bool]]) -> list[WayPoint]:
    """Drop junctions at which the route follows its road, if there are too many way points."""
    shown: list[WayPoint] = []
    for point, follows in found:
        if follows and len(found) > MAX_ROWS:
            shown[-1] = replace(shown[-1], passed=shown[-1].passed + 1)
        else:
            shown.append(point)
    return shown


def _other_arms(roads: _Roads, place: int, route: FloatArray) -> list[FloatArray]:
    """Directions of the drivable roads at a junction, except the route's own.

    ``route`` (3, 2) are the nodes before, at and after it.
    """
    heads, _, speed = roads.arms(place)
    used = {_arm_towards(roads, place, each - route[1])[0] for each in route[[0, 2]]}
    return [roads.direction(place, head) for head in heads[speed > 0.0].tolist()
            if head not in used]


def _arm_towards(roads: _Roads, place: int, direction: FloatArray) -> tuple[int, int]:
    """Other place, and name, of the piece at a place that leads in a direction."""
    heads, name, _ = roads.arms(place)
    directions = roads.graph.points[heads] - roads.graph.points[place]
    k = int((directions @ direction / np.hypot(*directions.T)).argmax())
    return int(heads[k]), int(name[k])


def _point_at(line: FloatArray, travelled: FloatArray, distance: float) -> FloatArray:
    """Point (2,) at a distance along a line."""
    return np.array([np.interp(distance, travelled, axis) for axis in line.T])


def _angle(one: FloatArray, other: FloatArray) -> float:
    """Angle from one direction to another, positive to the left [degrees]."""
    return float(np.degrees(np.arctan2(one[0] * other[1] - one[1] * other[0], one @ other)))


def _action(turn: float, others: Sequence[float]) -> str:
    """Name a turn [degrees] at a junction, given the turns to the ``others``."""
    side, size = 'left' if turn > 0.0 else 'right', abs(turn)
    if size > BACK:
        return 'turn round'
    rivals = [each for each in others if abs(each) < FORK]
    if size < BEAR and rivals and (size > BEAR / 2.0 or min(map(abs, rivals)) < BEAR):
        return ('keep left' if turn > max(rivals) else 'keep right' if turn < min(rivals)
                else 'keep to the middle')
    if size < BEAR:
        return STRAIGHT
    return f'bear {side}' if size < TURN else side if size < SHARP else f'sharp {side}'
