"""Ground that departures of different strategies have in common: edges and squares by place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..network.network import Network
from .audit_draws import ManyRoutes

# Nodes of two networks that are this near to each other are the same place [m].
SAME_PLACE = 1e-3
# Edge of the squares in which ground is shared, as a part of the expected length: fine enough to
# tell corridors apart, coarse enough that neighbouring lines count as the same corridor.
SQUARE = 0.1
# So many squares in each direction at most.
_MOST_ACROSS = 24
# Edges by place are counted one by one up to this number, else by squares.
_MOST_EDGES = 100_000


@dataclass(frozen=True, eq=False)
class Ground:
    """Where the edges of several networks lie.

    Attributes
    ----------
    square : float
        Edge of the squares [m].
    squares : int
        How many there are.
    of_node : list of (N,) int
        A strategy a list entry: the square of each node.
    of_edge : list of (M,) int
        The place of each edge: the same number where both ends lie at the same places; -1 for
        edges that are never driven.
    segments : (C, 2, 2) float
        From where to where each of these leads [m].
    inner : list of (M,) bool
        Edges that touch neither source nor target, nor a stop.
    """

    square: float
    squares: int
    of_node: list[IndexArray]
    of_edge: list[IndexArray]
    segments: FloatArray
    inner: list[np.ndarray]


def ground_of(strategies: Sequence[ManyRoutes], length: float) -> Ground:
    """Number the places of strategies whose routes have this mean length [m]."""
    networks = [each.network for each in strategies]
    points = np.concatenate([network.points for network in networks])
    low, high = points.min(axis=0), points.max(axis=0)
    square = max(SQUARE * length, float((high - low).max()) / _MOST_ACROSS, np.finfo(float).tiny)
    cell = np.floor((points - low) / square).astype(np.int64)
    of_node, node = numbered(cell), numbered(np.rint(points / SAME_PLACE))
    first = np.cumsum([0, *(len(network.points) for network in networks)])
    ends = np.concatenate([
        each.network.edges[each.used] + first[k] for k, each in enumerate(strategies)
    ])
    keys, index, of_edge = np.unique(
        node[ends[:, 0]] * (node.max() + 1) + node[ends[:, 1]], return_index=True,
        return_inverse=True,
    )
    if len(keys) > _MOST_EDGES:
        count = int(of_node.max()) + 1
        _, index, of_edge = np.unique(
            of_node[ends[:, 0]] * count + of_node[ends[:, 1]], return_index=True,
            return_inverse=True,
        )
    cuts = np.cumsum([len(each.used) for each in strategies])[:-1]
    return Ground(
        square=square,
        squares=int(of_node.max()) + 1,
        of_node=np.split(of_node, first[1:-1]),
        of_edge=[
            _spread(each, place) for each, place in
            zip(strategies, np.split(of_edge.reshape(-1), cuts), strict=True)
        ],
        segments=points[ends[index]],
        inner=[_inner(network) for network in networks],
    )


def numbered(rows: np.ndarray) -> IndexArray:
    """Number rows (K, 2) in their order: (K,), the same where they are equal."""
    # Much faster than np.unique(rows, axis=0), which compares them byte by byte.
    x, y = (np.unique(column, return_inverse=True)[1] for column in rows.T)
    number: IndexArray = np.unique(x * (y.max(initial=0) + 1) + y, return_inverse=True)[1]
    return number


def _spread(many: ManyRoutes, place: IndexArray) -> IndexArray:
    """Places of used edges as an array of all edges."""
    spread = np.full(len(many.p), -1)
    spread[many.used] = place
    return spread


def _inner(network: Network) -> np.ndarray:
    return ~(np.isin(network.tails, network.ends) | np.isin(network.heads, network.ends))
