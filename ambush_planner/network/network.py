# SPDX-License-Identifier: Apache-2.0
"""The network that the game is played on: nodes, directed edges, source, target and losses."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray, IndexArray, found_in, frozen_array
from ..errors import InvalidNetwork
from ..notebook import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Network(Shown):
    """A directed network with a loss at each node, validated.

    Edges into the source or out of the target are dropped with a warning: they would allow flow
    circulations that never connect the two, and the value would come out too low.

    Nodes stand for places, each node for one; several can stand for the same place. On a trip with
    stops, the convoy may come back to a place on another leg: each leg has nodes of its own, and
    the edges that end a leg lead to the first node of the next.

    Parameters
    ----------
    points : (N, 2) float
        World positions [m].
    alpha : (N,) float, >= 0
        Loss for being ambushed at each node; 0 at the source and the target.
    edges : (M, 2) int
        (tail, head) of each directed edge; no self-loops, no duplicates.
    source, target : int
        First and last node of every route.
    places : (N,) int
        The place that each node stands for, numbered from 0; each its own by default. Nodes of one
        place have the same point and the same loss: they are on several legs, or on layers.
    leg : (N,) int
        The leg of the trip on which each node lies; 0 by default. Edges lead on within a leg, or to
        a later one.
    seconds : (M,) float, >= 0, optional
        Driving time of each edge [s]. Budgets are then of time instead of length.
    refined : (K, 3) float
        Places (x, y) around which the network is finer, and the spacing of nodes there [m].
    ground_length : float, optional
        Length of the shortest way over the ground [m], of which length budgets are multiples.
        None: that of the network's shortest route.

    Raises
    ------
    InvalidNetwork
        An input is invalid; the message names the field, the index and the value.
    """

    points: FloatArray
    alpha: FloatArray
    edges: IndexArray
    source: int
    target: int
    places: IndexArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    leg: IndexArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    seconds: FloatArray | None = None
    refined: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    ground_length: float | None = None

    def __post_init__(self) -> None:
        points, alpha = _floats('points', self.points), _floats('alpha', self.alpha)
        _check_nodes(points, alpha)
        source = _node('source', self.source, len(points))
        target = _node('target', self.target, len(points))
        _check_ends(alpha, source, target)
        edges = _edge_array(self.edges, len(points))
        places = _numbers('places', self.places, np.arange(len(points)))
        leg = _numbers('leg', self.leg, np.zeros(len(points)))
        _check_places(places, points, alpha)
        _refuse_edges(edges, leg[edges[:, 1]] < leg[edges[:, 0]], 'back to an earlier leg')
        outside = (edges[:, 1] == source) | (edges[:, 0] == target)
        if outside.any():
            warnings.warn(
                f'{int(outside.sum())} edges into the source {source} or out of the target '
                f'{target} were dropped: no route uses them',
                stacklevel=3,
            )
        checked = {
            'points': points, 'alpha': alpha, 'edges': frozen_array(edges[~outside], np.int64),
            'source': source, 'target': target, 'places': places, 'leg': leg,
            'refined': frozen_array(self.refined, np.float64)}
        if self.seconds is not None:
            seconds = _seconds(self.seconds, len(edges))
            checked['seconds'] = frozen_array(seconds[~outside], np.float64)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def _summary(self) -> dict[str, str]:
        stops = {'stops': str(len(self.stops))} if self.legs > 1 else {}
        return {'nodes': str(len(self.points)), 'edges': str(len(self.edges)),
                'source': str(self.source), 'target': str(self.target), **stops}

    @cached_property
    def lengths(self) -> FloatArray:
        """Length of each edge (M,) [m]."""
        tail, head = self.edges.T
        return frozen_array(np.hypot(*(self.points[head] - self.points[tail]).T), np.float64)

    def edges_between(self, tails: IndexArray, heads: IndexArray) -> IndexArray:
        """The edges from tails (K,) to heads (K,), by their indices; -1: there is none."""
        count = len(self.points)
        return found_in(self.edges @ (count, 1), tails * count + heads)

    @property
    def travel_costs(self) -> FloatArray:
        """What each edge (M,) adds to the length budget: time [s] if known, else length [m]."""
        return self.lengths if self.seconds is None else self.seconds

    @property
    def travel_unit(self) -> str:
        """Unit of ``travel_costs``, 's' or 'm'."""
        return 'm' if self.seconds is None else 's'

    @cached_property
    def edge_exposure(self) -> FloatArray:
        """Integral of alpha along each edge (M,) [loss x m]: its length times the mean of its ends.

        Source, stops and target have no loss of their own; the edge's other end replaces theirs.
        """
        is_end = np.zeros(len(self.points), dtype=bool)
        is_end[self.ends] = True
        tail, head = self.alpha[self.tails], self.alpha[self.heads]
        tail = np.where(is_end[self.tails], head, tail)
        head = np.where(is_end[self.heads], tail, head)
        return frozen_array(self.lengths * (tail + head) / 2.0, np.float64)

    @property
    def place_count(self) -> int:
        """Number of places, P."""
        return len(self.representatives)

    @cached_property
    def representatives(self) -> IndexArray:
        """The first node (P,) of each place."""
        return frozen_array(np.unique(self.places, return_index=True)[1], np.int64)

    @cached_property
    def first_edge(self) -> IndexArray:
        """The first edge (M,) between the same places on the same legs; other layers follow."""
        node = self.places * self.legs + self.leg
        ends = node[self.tails] * (node.max() + 1) + node[self.heads]
        _, first, which = np.unique(ends, return_index=True, return_inverse=True)
        return frozen_array(first[which], np.int64)

    @cached_property
    def stretches(self) -> int:
        """Number of edges, those of all layers between the same places counted once."""
        return len(np.unique(self.first_edge))

    @property
    def legs(self) -> int:
        """Number of legs; of those, a route in any order drives one more than there are stops."""
        return int(self.leg.max()) + 1

    @cached_property
    def stops(self) -> IndexArray:
        """For each stop, a node where a leg begins.

        They are those of one route: through the legs of lowest numbers, from the target back.
        """
        tail, head = self.edges[self.leg[self.heads] > self.leg[self.tails]].T
        found, leg = [], self.legs - 1
        while (into := np.flatnonzero(self.leg[head] == leg)).size:
            last = into[np.lexsort((head[into], self.leg[tail[into]]))[0]]
            found.append(head[last])
            leg = int(self.leg[tail[last]])
        return frozen_array(found[::-1], np.int64)

    @cached_property
    def stops_before(self) -> IndexArray:
        """How many stops have been visited before each leg (legs,)."""
        tail, head = self.leg[self.edges].T
        before = np.zeros(self.legs, dtype=np.int64)
        for leg in np.unique(head[head > tail]).tolist():
            before[leg] = before[tail[(head == leg) & (tail < leg)][0]] + 1
        return frozen_array(before, np.int64)

    def visited(self, route: IndexArray) -> tuple[IndexArray, IndexArray]:
        """Where in a route (K,) its stops are, and which of ``stops`` they are.

        The route may begin after some of them.
        """
        begins = self.heads[self.leg[self.heads] > self.leg[self.tails]]
        at = np.flatnonzero(np.isin(route[1:], begins) & (np.diff(self.leg[route]) > 0)) + 1
        ahead, which = self.places[self.stops].tolist(), []
        for place in self.places[route[at[::-1]]].tolist():
            which.append(len(ahead) - 1 - ahead[::-1].index(place))
            ahead[which[-1]] = -1
        return at, np.array(which[::-1], dtype=np.int64)

    @cached_property
    def ends(self) -> IndexArray:
        """All nodes at the places of the source, the stops and the target."""
        at = self.places[[self.source, *self.stops, self.target]]
        return frozen_array(np.flatnonzero(np.isin(self.places, at)), np.int64)

    @property
    def tails(self) -> IndexArray:
        """Tail of each edge (M,)."""
        return self.edges[:, 0]

    @property
    def heads(self) -> IndexArray:
        """Head of each edge (M,)."""
        return self.edges[:, 1]


def _numbers(name: str, values: IndexArray, default: npt.ArrayLike) -> IndexArray:
    numbers = np.asarray(values)
    if not numbers.size:
        return frozen_array(default, np.int64)
    if numbers.shape != np.shape(default) or numbers.dtype.kind not in 'iu':
        raise InvalidNetwork(f'{name} must be integers, one for each of the {np.size(default)} '
                             f'nodes, got shape {numbers.shape} and dtype {numbers.dtype}')
    used = np.unique(numbers)
    if not np.array_equal(used, np.arange(len(used))):
        raise InvalidNetwork(f'{name} must be numbered from 0 without a break, got {len(used)} '
                             f'numbers in {used[0]}..{used[-1]}')
    return frozen_array(numbers, np.int64)


def _check_places(places: IndexArray, points: FloatArray, alpha: FloatArray) -> None:
    _, first = np.unique(places, return_index=True)
    same = first[places]
    bad = (points[same] != points).any(axis=1) | (alpha[same] != alpha)
    if bad.any():
        node = int(np.argmax(bad))
        raise InvalidNetwork(f'places: nodes {same[node]} and {node} stand for place '
                             f'{places[node]}, but their points or losses differ')


def _floats(name: str, values: npt.ArrayLike) -> FloatArray:
    try:
        return frozen_array(values, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidNetwork(f'{name} must be an array of numbers: {error}') from error


def _check_nodes(points: FloatArray, alpha: FloatArray) -> None:
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise InvalidNetwork(f'points must have shape (N >= 2, 2), got {points.shape}')
    if alpha.shape != (len(points),):
        raise InvalidNetwork(f'alpha must have shape ({len(points)},), got {alpha.shape}')
    for name, values, good, rule in (
        ('points', points, np.isfinite(points).all(axis=1), 'finite'),
        ('alpha', alpha, np.isfinite(alpha) & (alpha >= 0.0), 'finite and >= 0'),
    ):
        if not good.all():
            node = int(np.argmin(good))
            raise InvalidNetwork(f'{name} must be {rule}, got {values[node].tolist()} '
                                 f'at node {node}')


def _seconds(values: npt.ArrayLike, count: int) -> FloatArray:
    seconds = _floats('seconds', values)
    if seconds.shape != (count,) or not (np.isfinite(seconds) & (seconds >= 0.0)).all():
        raise InvalidNetwork(f'seconds must be finite and >= 0, one for each of the {count} edges')
    return seconds


def _node(name: str, value: object, count: int) -> int:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise InvalidNetwork(f'{name} must be a node index (int), got {value!r}')
    if not 0 <= value < count:
        raise InvalidNetwork(f'{name} must be in 0..{count - 1}, got {value}')
    return int(value)


def _check_ends(alpha: FloatArray, source: int, target: int) -> None:
    if source == target:
        raise InvalidNetwork(f'source and target are the same node, {source}')
    for name, node in (('source', source), ('target', target)):
        if alpha[node] != 0.0:
            raise InvalidNetwork(
                f'alpha[{name}] must be 0 (no ambush at the ends), got {alpha[node]} at node {node}'
            )


def _edge_array(values: npt.ArrayLike, count: int) -> IndexArray:
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InvalidNetwork(f'edges must be an array of integers: {error}') from error
    if array.size == 0:
        return np.empty((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InvalidNetwork(f'edges must have shape (M, 2), got {array.shape}')
    if array.dtype.kind not in 'iu':
        raise InvalidNetwork(f'edges must be integers (tail, head), got dtype {array.dtype}')
    edges = array.astype(np.int64)
    outside = np.asarray(((edges < 0) | (edges >= count)).any(axis=1))
    _refuse_edges(edges, outside, f'outside 0..{count - 1}')
    _refuse_edges(edges, edges[:, 0] == edges[:, 1], 'a self-loop')
    _, first = np.unique(edges[:, 0] * count + edges[:, 1], return_index=True)
    repeated = ~np.isin(np.arange(len(edges)), first)
    _refuse_edges(edges, repeated, 'a duplicate')
    return edges


def _refuse_edges(edges: IndexArray, bad: BoolArray, what: str) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        raise InvalidNetwork(f'edges: edge {k} {tuple(int(n) for n in edges[k])} is {what} '
                             f'({int(bad.sum())} such edges)')
