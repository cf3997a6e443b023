# SPDX-License-Identifier: Apache-2.0
"""The faces of a planar two-way network, and the faces on the rim of each site's disc.

Edges that join the same two nodes form one link, with a face on either side. A closed curve through
faces separates the source from the target exactly if its signed crossings of one reference route do
not sum to 0; then it crosses every route (J. H. Reif, Minimum s-t cut of a planar undirected
network, SIAM Journal on Computing 12, 1983). The terms are those of docs/theory.md, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from ..arrays import ROUNDING, BoolArray, FloatArray, IndexArray
from .game import Game
from .route_sampler import shortest_route


class Discs(NamedTuple):
    """Pairs (T,) of a disc and a face on its rim, ordered by disc.

    The rim of a disc falls into parts that the links entering it connect: usually one, several if
    the secured area cuts the disc. ``part`` numbers them from 0, disc by disc. ``offset`` is the
    winding offset: the signed crossings of the reference route on the way along the part.
    ``unavoidable`` (K,) marks discs around an end, which hit every route.
    """

    face: IndexArray
    disc: IndexArray
    offset: IndexArray
    part: IndexArray
    unavoidable: BoolArray


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces 0..count-1 of a leg's playable network with K links.

    Attributes
    ----------
    link : (M,)
        The link of each edge; -1 if it is not playable.
    left, right : (K,)
        Faces on either side of each link, seen from its lower node.
    crossed : (K,)
        1 or -1 if the reference route drives the link from or to its lower node, else 0.
    """

    game: Game
    count: int
    link: IndexArray
    left: IndexArray
    right: IndexArray
    crossed: IndexArray

    def discs(self, entering: csr_matrix) -> Discs:
        """Find the faces on the rims of discs, given the edges that enter each as rows (K, M)."""
        links, edge = len(self.left), np.flatnonzero(self.link >= 0)
        places = edge, self.link[edge]
        of_edges = csr_matrix((np.ones(len(edge), bool), places), (len(self.link), links))
        rims = csr_matrix(entering.astype(bool) @ of_edges)  # the links that enter each disc
        places = np.tile(np.arange(links), 2), np.concatenate((self.left, self.right))
        sides = csr_matrix((np.ones(2 * links, bool), places), (links, self.count))
        touched = csr_matrix(rims @ sides)
        touched.sort_indices()
        disc = np.repeat(np.arange(touched.shape[0]), np.diff(touched.indptr))
        face, size = touched.indices.astype(np.int64), len(disc)
        met = rims.tocoo()
        key, first, link = disc * self.count + face, met.row * self.count, met.col
        left = np.searchsorted(key, first + self.left[link])
        right = np.searchsorted(key, first + self.right[link])
        joined = csr_matrix((np.ones(len(left)), (left, right)), (size, size))
        part = connected_components(joined, directed=False)[1].astype(np.int64)
        offset, enclosing = self._winding_offsets(link, left, right, part)
        return Discs(face, disc, offset, part, np.isin(np.arange(rims.shape[0]), disc[enclosing]))

    def same_both_ways(self, cost: FloatArray) -> bool:
        """Return whether each link costs the same both ways, from the costs (M,) of edges."""
        edge = np.flatnonzero(self.link >= 0)
        of_link = np.zeros(len(self.left))
        of_link[self.link[edge]] = cost[edge]
        return bool(np.allclose(of_link[self.link[edge]], cost[edge], rtol=ROUNDING, atol=0.0))

    def flow(self, potential: FloatArray) -> FloatArray:
        """Return the flow (M,) of size 1 with a given potential (count,) of the faces."""
        flow = self.crossed + potential[self.left] - potential[self.right]
        network = self.game.network
        forward = np.where(network.tails < network.heads, 1.0, -1.0)
        return np.where(self.game.playable, np.maximum(forward * flow[self.link], 0.0), 0.0)

    def _winding_offsets(self, link: IndexArray, left: IndexArray, right: IndexArray,
                         part: IndexArray) -> tuple[IndexArray, IndexArray]:
        """Winding offset (T,) of each pair, and pairs on rims for which it is not defined.

        Offsets count from the first pair of each ``part`` (T,), along a tree of links (K,) between
        the pairs ``left`` and ``right``. On a rim around an end they depend on the way taken: they
        disagree across some link.
        """
        size = len(part)
        crossing = np.bincount(part[left], self.crossed[link] != 0)[part[left]] > 0.0
        link, left, right = link[crossing], left[crossing], right[crossing]
        tail, head = np.concatenate((left, right)), np.concatenate((right, left))
        gain = np.concatenate((-self.crossed[link], self.crossed[link]))
        joined = csr_matrix((np.ones(len(tail)), (tail, head)), (size, size))
        roots = np.unique(part, return_index=True)[1]
        _, tree, _ = dijkstra(joined, indices=roots, min_only=True, return_predecessors=True,
                              unweighted=True)
        reached = np.flatnonzero(tree >= 0)
        predecessor = np.where(tree >= 0, tree, np.arange(size))
        step, index = np.unique(tail * size + head, return_index=True)
        offset = np.zeros(size, dtype=np.int64)
        offset[reached] = gain[index[np.searchsorted(step,
                                                     predecessor[reached] * size + reached)]]
        while offset[predecessor].any():  # each round doubles the length of way that is summed
            offset, predecessor = offset + offset[predecessor], predecessor[predecessor]
        return offset, tail[offset[head] != offset[tail] + gain]


@dataclass(frozen=True, eq=False)
class Circulation:
    """Flow between the faces of a leg that balances at every face and every part of a rim.

    Attributes
    ----------
    through : (links,)
        Flow through each link, from its left to its right face [loss].
    site, face, flow : (T,)
        Flow from a face into the disc of a site, a node; < 0: out of it [loss].
    """

    through: FloatArray
    site: IndexArray
    face: IndexArray
    flow: FloatArray


def make_faces(game: Game) -> Faces | None:
    """Find the faces of the playable network; None if links cross or are one-way."""
    network, n, edges = game.network, game.node_count, np.flatnonzero(game.playable)
    route = shortest_route(network, edges)
    ends = np.sort(network.edges[edges], axis=1)
    key, link = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    low, high = np.divmod(key, n)
    count, link = len(key), link.ravel()
    terminals = route[0], route[-1]  # their links are one-way: no edge enters the source
    at_end = np.isin(low, terminals) | np.isin(high, terminals)
    if not (at_end | (np.bincount(link) == 2)).all():
        return None
    # Half-edges: each link from its lower node, then each from its higher node.
    tail, head = np.concatenate((low, high)), np.concatenate((high, low))
    twin = np.roll(np.arange(2 * count), count)
    x, y = network.points.T
    order = np.lexsort((np.arctan2(y[head] - y[tail], x[head] - x[tail]), tail))
    place = np.argsort(order)
    first = np.searchsorted(tail[order], np.arange(n + 1))
    # A half-edge's face lies to its left: it goes on with the next half-edge clockwise of its twin.
    turn = place[twin] - 1
    turn = np.where(turn < first[head], first[head + 1] - 1, turn)
    following = csr_matrix((np.ones(2 * count), order[turn], np.arange(2 * count + 1)))
    faces, face = connected_components(following, directed=False)
    if len(np.unique(tail)) - count + faces != 2:  # Euler's formula for connected planar graphs
        return None
    driven = np.searchsorted(key, np.minimum(route[:-1], route[1:]) * n
                             + np.maximum(route[:-1], route[1:]))
    crossed = np.zeros(count, dtype=np.int64)
    crossed[driven] = np.where(route[:-1] < route[1:], 1, -1)
    of_edge = np.full(len(network.edges), -1)
    of_edge[edges] = link
    return Faces(game, faces, of_edge, face[:count], face[count:], crossed)
