# SPDX-License-Identifier: Apache-2.0
"""The drivable places of a trip, and the network for any order of its stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from itertools import pairwise, permutations

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
    """Directed graph of the drivable places of a trip, for any order of its stops.

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
        last = len(visits) - 2
        return self._layered([visits], visits[0], visits[-1], [
            ({source}, {target: min(leg + 1, last)})
            for leg, (source, target) in enumerate(pairwise(visits))])

    def network_in_any_order(self) -> Network:
        """The network for any order of the stops: all places for each set of stops visited."""
        source, *stops, target = self.visits
        bits = {stop: 1 << k for k, stop in enumerate(stops)}
        sets = sorted(range(1 << len(stops)), key=lambda visited: (visited.bit_count(), visited))
        leg = {visited: k for k, visited in enumerate(sets)}
        orders = [(source, *order, target) for order in permutations(stops)]
        return self._layered(orders, source, target, [
            ({stop for stop in stops if visited & bits[stop]} or {source},
             {stop: leg[visited | bits[stop]] for stop in stops if not visited & bits[stop]}
             or {target: leg[visited]}) for visited in sets])

    def _layered(self, orders: Sequence[Sequence[int]], source: int, target: int,
                 legs: Sequence[tuple[AbstractSet[int], Mapping[int, int]]]) -> Network:
        """The network with all places for each leg, from where it begins to where others do.

        ``orders`` are the sequences of start, stops and goal that its routes can follow.
        """
        count, layers, used = len(self.points), [], []
        for leg, (begins, ends) in enumerate(legs):
            inside = ~np.isin(self.edges[:, 0], list(ends))
            if len(begins) == 1:  # a leg that begins elsewhere may pass the others
                inside &= self.edges[:, 1] != min(begins)
            used.append(np.flatnonzero(inside))
            edges = self.edges[used[-1]]
            layers.append(edges + leg * count)
            for end, later in ends.items():
                layers[-1][edges[:, 1] == end, 1] += (later - leg) * count
        edges, number = np.concatenate(layers), len(legs)
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        seconds = None if self.seconds is None else self.seconds[np.concatenate(used)[order]]
        shortest = None
        if self.ground is not None:
            between = self.ground.between
            shortest = min(sum(between(*pair) for pair in pairwise(visits)) for visits in orders)
        return Network(np.tile(self.points, (number, 1)), np.tile(self.alpha, number), edges[order],
                       source, target + (number - 1) * count, np.tile(np.arange(count), number),
                       np.repeat(np.arange(number), count), seconds, self.refined, shortest)


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
