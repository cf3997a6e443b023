"""The faces of a planar two-way network, and which of them the rim of each site's reach touches.

Edges that join the same two nodes are one link, with a face on either side. A curve through faces
that separates the source from the target crosses every route an odd number of times. So counting
its crossings of one reference route decides whether a closed curve through faces separates them (J.
H. Reif, Minimum s-t cut of a planar undirected network, SIAM Journal on Computing 12, 1983).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from ..arrays import BoolArray, IndexArray
from .game import Game
from .route_sampler import shortest_route


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces 0..count-1 of a network of K links.

    Attributes
    ----------
    link : (M,)
        The link of each edge; -1 where it is not playable.
    left, right : (K,)
        Faces on either side of each link, seen from its lower node.
    crossed : (K,)
        1 or -1 where the reference route drives the link from or to its lower node, else 0.
    outer : int
        The face around the network.
    """

    game: Game
    count: int
    link: IndexArray
    left: IndexArray
    right: IndexArray
    crossed: IndexArray
    outer: int

    @cached_property
    def rims(self) -> csr_matrix:
        """(S, K) bool: the links that enter each site's reach."""
        edge = np.flatnonzero(self.link >= 0)
        places = np.arange(len(edge)), self.link[edge]
        links = csr_matrix((np.ones(len(edge), bool), places), (len(edge), len(self.left)))
        return csr_matrix(self.game.hits[:, edge].astype(bool) @ links)

    @cached_property
    def touched(self) -> csr_matrix:
        """(S, F) bool: the faces on the rim of each site's reach."""
        links = len(self.left)
        places = np.tile(np.arange(links), 2), np.concatenate((self.left, self.right))
        sides = csr_matrix((np.ones(2 * links, bool), places), (links, self.count))
        touched = csr_matrix(self.rims @ sides)
        touched.sort_indices()
        return touched

    @cached_property
    def site(self) -> IndexArray:
        """The site's row of each entry of ``touched``."""
        return np.repeat(np.arange(self.touched.shape[0]), np.diff(self.touched.indptr))

    @cached_property
    def lifts(self) -> tuple[IndexArray, BoolArray]:
        """For each entry of ``touched``, how often the way there along the rim crosses the route.

        And the sites (S,) whose rims separate the ends: every route meets these.
        """
        size = self.touched.nnz
        reached = np.flatnonzero((self.rims @ np.abs(self.crossed)) > 0)
        rims = self.rims[reached].tocoo()
        first = reached[rims.row] * self.count
        key = self.site * self.count + self.touched.indices
        left = np.searchsorted(key, first + self.left[rims.col])
        right = np.searchsorted(key, first + self.right[rims.col])
        tail, head = np.concatenate((left, right)), np.concatenate((right, left))
        gain = np.concatenate((-self.crossed[rims.col], self.crossed[rims.col]))
        joined = csr_matrix((np.ones(len(tail)), (tail, head)), (size, size))
        _, part = connected_components(joined, directed=False)
        roots = np.unique(part, return_index=True)[1]
        _, tree, _ = dijkstra(joined, indices=roots, min_only=True, return_predecessors=True,
                              unweighted=True)
        here = np.flatnonzero(tree >= 0)
        before = np.where(tree >= 0, tree, np.arange(size))
        step, which = np.unique(tail * size + head, return_index=True)
        lift = np.zeros(size, dtype=np.int64)
        lift[here] = gain[which[np.searchsorted(step, before[here] * size + here)]]
        while lift[before].any():  # each round doubles the part of the way that is added up
            lift, before = lift + lift[before], before[before]
        around = np.zeros(self.touched.shape[0], dtype=bool)
        around[self.site[tail[lift[head] != lift[tail] + gain]]] = True
        return lift, around


def make_faces(game: Game) -> Faces | None:
    """The faces of the playable network; None if links cross."""
    network, n = game.network, game.node_count
    playable = np.flatnonzero(game.playable)
    ends = np.sort(network.edges[playable], axis=1)
    key, link = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    low, high = np.divmod(key, n)
    count = len(key)
    # Half-edges: links from their lower nodes, then the same from their higher ones.
    tail, head = np.concatenate((low, high)), np.concatenate((high, low))
    twin = np.roll(np.arange(2 * count), count)
    x, y = network.points.T
    order = np.lexsort((np.arctan2(y[head] - y[tail], x[head] - x[tail]), tail))
    place = np.argsort(order)
    first = np.searchsorted(tail[order], np.arange(n + 1))
    # A face lies to the left: at the head, turn to the next half-edge clockwise from the twin.
    turn = place[twin] - 1
    turn = np.where(turn < first[head], first[head + 1] - 1, turn)
    following = csr_matrix((np.ones(2 * count), order[turn], np.arange(2 * count + 1)))
    faces, face = connected_components(following, directed=False)
    nodes = len(np.unique(tail))
    if nodes - count + faces != 2:  # Euler's formula, the network is connected
        return None
    area = np.bincount(face, weights=x[tail] * y[head] - x[head] * y[tail])
    route = shortest_route(network, playable)
    driven = np.searchsorted(key, np.minimum(route[:-1], route[1:]) * n
                             + np.maximum(route[:-1], route[1:]))
    crossed = np.zeros(count, dtype=np.int64)
    crossed[driven] = np.where(route[:-1] < route[1:], 1, -1)
    of_edge = np.full(len(network.edges), -1)
    of_edge[playable] = link.ravel()
    return Faces(game, faces, of_edge, face[:count], face[count:], crossed, int(area.argmin()))
