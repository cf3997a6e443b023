# SPDX-License-Identifier: Apache-2.0
"""The drivable places of a trip, and the network of its legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray, IndexArray, found_in
from ..errors import (
    AmbushPlannerError,
    GoalBlocked,
    GoalOutsideMap,
    StartBlocked,
    StartOutsideMap,
    StopBlocked,
    StopOutsideMap,
)
from .network import Network
from .shortest_way import GroundLengths

Position = tuple[float, float]


@dataclass(frozen=True, eq=False)
class TripGraph:
    """Directed graph of the drivable places of a trip.

    Parameters
    ----------
    points : (N, 2), alpha : (N,)
        The nodes [m] and their losses; 0 at start, stops and goal.
    edges : (E, 2)
        (tail, head) of each directed edge.
    visits : tuple of int
        The nodes of start, stops and goal in the given order; equal positions share a node.
    seconds : (E,), optional
        Driving time of each edge [s].
    refined : (K, 3)
        As in ``Network``.
    ground : optional
        Lengths over the ground between nodes, of which length budgets are multiples.
    """

    points: FloatArray
    alpha: FloatArray
    edges: IndexArray
    visits: tuple[int, ...]
    seconds: FloatArray | None = None
    refined: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    ground: GroundLengths | None = None

    def network(self, visits: Sequence[int]) -> Network:
        """The network for driving from each of these nodes to the next: all places for each leg."""
        count, number, layers, used = len(self.points), len(visits) - 1, [], []
        for leg, (begin, end) in enumerate(pairwise(visits)):
            used.append(np.flatnonzero((self.edges[:, 0] != end) & (self.edges[:, 1] != begin)))
            edges = self.edges[used[-1]]
            layers.append(edges + leg * count)
            if leg + 1 < number:
                layers[-1][edges[:, 1] == end, 1] += count
        edges = np.concatenate(layers)
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        seconds = None if self.seconds is None else self.seconds[np.concatenate(used)[order]]
        shortest = None
        if self.ground is not None:
            shortest = sum(self.ground.between(*pair) for pair in pairwise(visits))
        return Network(np.tile(self.points, (number, 1)), np.tile(self.alpha, number), edges[order],
                       visits[0], visits[-1] + (number - 1) * count,
                       np.tile(np.arange(count), number), np.repeat(np.arange(number), count),
                       seconds, self.refined, shortest)


def named(name: str, position: Position) -> str:
    """A start, stop or goal in messages."""
    return f'{name} ({position[0]:.3f}, {position[1]:.3f})'


def position_errors(name: str) -> tuple[type[AmbushPlannerError], type[AmbushPlannerError]]:
    """The errors for a start, stop or goal off the map, and for a blocked one."""
    return {'start': (StartOutsideMap, StartBlocked), 'goal': (GoalOutsideMap, GoalBlocked)}.get(
        name, (StopOutsideMap, StopBlocked))


def with_layers(network: Network, node: IndexArray, edges: IndexArray) -> Network:
    """A network as a layered graph: ``node`` (K,) once more, edges (L, 2) between these.

    The layers come after the network's own nodes and edges; the edges have the new numbers.
    """
    of = np.append(np.arange(len(network.points)), node)
    every, seconds = np.concatenate((network.edges, edges)), network.seconds
    if seconds is not None:
        seconds = np.append(seconds, seconds[original_edges(network, of, edges)])
    return Network(network.points[of], network.alpha[of], every, network.source, network.target,
                   network.places[of], network.leg[of], seconds, network.refined,
                   network.ground_length)


def original_edges(network: Network, of: IndexArray, edges: IndexArray) -> IndexArray:
    """The network's edges that those of layers (L, 2) stand for, from each one's node (N',).

    -1 for an edge that stands for none.
    """
    return network.edges_between(*of[edges].T)


def original_nodes(network: Network, places: IndexArray, leg: IndexArray) -> IndexArray:
    """The network's nodes that stand for the same places (K,) on the same legs (K,); -1: none."""
    return found_in(network.places * network.legs + network.leg, places * network.legs + leg)
