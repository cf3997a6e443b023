# SPDX-License-Identifier: Apache-2.0
"""The network that the game is played on: nodes, directed edges, source, target and losses."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray, IndexArray, found_in, frozen_array
from ..errors import InvalidNetwork
from ..notebook import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Network(Shown):
    """Validated directed network with a loss at each node.

    Edges into the source or out of the target are dropped with a warning: they would allow
    circulations that do not connect the two, and a value that is too low.

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
    seconds : (M,) float, >= 0, optional
        Driving time of each edge [s]. Budgets are then of time instead of length.
    refined : (K, 3) float, optional
        Places (x, y) around which a graded network is finer, and the spacing of nodes there [m].
        None: there are none, as on a trip's first network.
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
    seconds: FloatArray | None = None
    refined: FloatArray | None = None
    ground_length: float | None = None

    def __post_init__(self) -> None:
        points, alpha = _floats('points', self.points), _floats('alpha', self.alpha)
        _check_nodes(points, alpha)
        source = _node('source', self.source, len(points))
        target = _node('target', self.target, len(points))
        _check_ends(alpha, source, target)
        edges = _edge_array(self.edges, len(points))
        outside = (edges[:, 1] == source) | (edges[:, 0] == target)
        if outside.any():
            warnings.warn(
                f'{int(outside.sum())} edges into the source {source} or out of the target '
                f'{target} were dropped: no route uses them',
                stacklevel=3,
            )
        checked = {
            'points': points, 'alpha': alpha, 'edges': frozen_array(edges[~outside], np.int64),
            'source': source, 'target': target}
        if self.refined is not None:
            checked['refined'] = frozen_array(self.refined, np.float64)
        if self.seconds is not None:
            seconds = _floats('seconds', self.seconds)
            good = np.isfinite(seconds) & (seconds >= 0.0)
            if seconds.shape != (len(edges),) or not good.all():
                raise InvalidNetwork('seconds must be finite and >= 0, one for each of the '
                                     f'{len(edges)} edges')
            checked['seconds'] = frozen_array(seconds[~outside], np.float64)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def _summary(self) -> dict[str, str]:
        return {'nodes': str(len(self.points)), 'edges': str(len(self.edges)),
                'source': str(self.source), 'target': str(self.target)}

    @cached_property
    def lengths(self) -> FloatArray:
        """Length of each edge (M,) [m]."""
        tail, head = self.edges.T
        return frozen_array(np.hypot(*(self.points[head] - self.points[tail]).T), np.float64)

    def edges_between(self, tails: IndexArray, heads: IndexArray) -> IndexArray:
        """Return the indices (K,) of the edges from ``tails`` (K,) to ``heads`` (K,); -1: none."""
        count = len(self.points)
        return found_in(self.edges @ (count, 1), tails * count + heads)

    @property
    def travel_costs(self) -> FloatArray:
        """Cost (M,) of each edge in the length budget: time [s] if known, else length [m]."""
        return self.lengths if self.seconds is None else self.seconds

    @property
    def travel_unit(self) -> str:
        """Unit of ``travel_costs``, 's' or 'm'."""
        return 'm' if self.seconds is None else 's'

    @cached_property
    def edge_exposure(self) -> FloatArray:
        """Integral of alpha along each edge (M,) [loss x m]: length times mean alpha of its ends.

        Source and target have no loss of their own: alpha at the edge's other end replaces it.
        """
        tail, head = self.alpha[self.tails], self.alpha[self.heads]
        tail = np.where(self.tails == self.source, head, tail)
        head = np.where(self.heads == self.target, tail, head)
        return frozen_array(self.lengths * (tail + head) / 2.0, np.float64)

    @property
    def tails(self) -> IndexArray:
        """Tail of each edge (M,)."""
        return self.edges[:, 0]

    @property
    def heads(self) -> IndexArray:
        """Head of each edge (M,)."""
        return self.edges[:, 1]


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
