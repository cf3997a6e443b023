# SPDX-License-Identifier: Apache-2.0
"""A layered graph: a label is drawn at the start, and each has a chain on its own layer.

One Markov chain draws the legs of a trip, or the ways before and after a pass, independently of
each other, which can cost more than the slack. A label remembers what they have to agree on: the
chain runs on layers, each a copy of a part of the network, one around all routes of a mixture, and
one within a few edges of each of its best routes. The layers are joined at the source and the
target, so together they are one acyclic network, with one route distribution of greatest entropy
(``distribution.route_distribution``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..network.trip_graph import with_layers
from .distribution.acyclic import order_potential, topological_order
from .distribution.chain import MarkovChain
from .distribution.gibbs import AcyclicNetwork
from .game import Game


class LayeredGraph:
    """Layers around some routes of a game, as one acyclic network.

    Attributes
    ----------
    network : AcyclicNetwork
        The layers' edges; ``network.edge`` are the game's edges that they stand for.
    node : (n,)
        The game's node that each layer's node stands for, without source and target.
    copies : (m,)
        Which of these edges the unrolled game adds: all but that from the source to the target.
    p : (m,)
        The mixture of the routes, each on its own layer.
    """

    def __init__(self, game: Game, flow: FloatArray, routes: Sequence[IndexArray],
                 shares: FloatArray, width: int) -> None:
        """One layer around the strategy ``flow`` (M,), and one within ``width`` of each route.

        Routes are given by their edges, ``shares`` (C,) are their probabilities, and the width is
        in edges.
        """
        self._game = game
        network, potential, count = game.network, order_potential(game), 1
        parts, mixture = [], []
        nodes: list[IndexArray] = []
        for used, share in zip((np.flatnonzero(flow), *routes), (0.0, *shares), strict=True):
            edge, position = _part(game, used, potential, width if nodes else None)
            ends = network.edges[edge]
            own = np.unique(ends)
            own = own[np.argsort(position[own])][1:-1]  # all but source and target
            place = np.full(game.node_count, -1)
            place[own], place[network.source] = count + np.arange(len(own)), 0
            count += len(own)
            nodes.append(own)
            parts.append(np.column_stack((place[ends], edge)))
            mixture.append(share * np.isin(edge, used))
        tail, head, edge = np.concatenate(parts).T
        head = np.where(head < 0, count, head)
        order, p = np.lexsort((head, tail)), np.concatenate(mixture)
        direct = order[(tail[order] == 0) & (head[order] == count)]
        p[direct[:1]] = p[direct].sum()  # layers share the edge from the source to the target
        order = order[~np.isin(order, direct[1:])]
        self.network = AcyclicNetwork(tail[order], head[order], edge[order])
        self.node, self.p = np.concatenate(nodes), p[order]
        self.copies = (self.network.tail > 0) | (self.network.head < count)

    @property
    def edge(self) -> IndexArray:
        """The game's edges (M',) that those of the unrolled game stand for."""
        own = np.arange(len(self._game.playable))
        return np.append(own, self.network.edge[self.copies])

    def unrolled(self, chain: MarkovChain) -> tuple[Game, FloatArray]:
        """The game with the layers' nodes and edges after its own, and a chain's p (M',)."""
        own = sums(self.network.edge[~self.copies], chain.p[~self.copies],
                   len(self._game.playable))
        p = frozen_array(np.append(own, chain.p[self.copies]), np.float64)
        return self._on_layers(), p

    def _on_layers(self) -> Game:
        """The game with the layers' nodes and edges after its own."""
        game, layers, copies = self._game, self.network, self.copies
        network, count = game.network, game.node_count
        of = np.append(np.arange(count), self.node)
        at = np.concatenate(([network.source], count + np.arange(len(self.node)),
                             [network.target]))
        edges = np.column_stack((at[layers.tail[copies]], at[layers.head[copies]]))
        playable = np.append(game.playable, np.ones(len(edges), dtype=bool))
        return replace(game, network=with_layers(network, self.node, edges),
                       playable=frozen_array(playable, np.bool_),
                       loss=frozen_array(game.loss[of], np.float64),
                       known_rows=game.entering[:, self.edge])


def _part(game: Game, used: IndexArray, potential: FloatArray,
          width: int | None) -> tuple[IndexArray, IndexArray]:
    """The edges that go forward at most ``width`` edges from those used, and the order of nodes.

    ``width`` None: anywhere.
    """
    tails, heads = game.network.edges.T
    flow, inside = np.zeros(len(tails)), np.full(game.node_count, width is None)
    flow[used], inside[game.network.edges[used]] = 1.0, True
    position = topological_order(game, flow, potential)
    for _ in range(width or 0):
        grown = inside.copy()
        grown[heads[game.playable & inside[tails]]] = True
        grown[tails[game.playable & inside[heads]]] = True
        inside = grown
    part = game.restricted_to(inside[tails] & inside[heads] & (position[tails] < position[heads]))
    assert part is not None  # it contains the flow
    return np.flatnonzero(part.playable), position
