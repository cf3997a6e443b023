"""The least value with a reach and without a binding budget: the cheapest chain of discs.

On a planar two-way network a chain of discs, each with a face in common with the next, separates
the source from the target if it closes around one of them, perhaps through the outer face. Every
route meets it. With q in proportion to 1 / alpha on it, each route loses at least 1 / K, where K is
the sum of 1 / alpha over the chain, and the cheapest chain usually gives the value (docs/theory.md,
Proposition 8.10). It is a shortest path from a disc to its own second copy. The certificate judges
q, so the bound does not depend on any of this.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ..arrays import FloatArray, IndexArray
from .budget import ROUNDING
from .faces import Faces

# Distances that are held at once: bounds the memory of searches that run together.
_DISTANCES = 2**22
# How far they go, as a share of the cheapest chain: a chain has a middle within this of its first
# disc on both ways, as faces and discs on it are at most half of its cost apart.
_MIDDLE = 0.75


def chain_ambusher(faces: Faces) -> FloatArray | None:
    """q (N,) on the cheapest chain of discs; None if no chain separates the ends."""
    game, chain = faces.game, cheapest_chain(faces)
    if chain is None:
        return None
    q = np.zeros(game.node_count)
    q[game.sites[chain]] = 1.0 / game.loss[game.sites[chain]]
    q *= game.ambushers / q.sum()
    return q if q.max() <= 1.0 else None


def cheapest_chain(faces: Faces) -> IndexArray | None:
    """The sites' rows of the cheapest chain of discs that separates the ends, if there is one."""
    cost = 1.0 / faces.game.loss[faces.game.sites]
    cover, around = _double_cover(faces, cost), np.flatnonzero(faces.lifts[1])
    least, chain = _chain_through(cover, faces.outer, faces.count)
    if len(around) and cost[around].min() < least:
        least, chain = float(cost[around].min()), around[[cost[around].argmin()]]
    # Every chain has a disc that meets the reference route.
    starts = faces.count + np.flatnonzero((faces.rims @ np.abs(faces.crossed)) > 0)
    half, best = cover.shape[0] // 2, None
    at_once = max(_DISTANCES // (2 * half), 1)
    for k in range(0, len(starts), at_once):
        part = starts[k : k + at_once]
        away = dijkstra(cover, indices=part, limit=_MIDDLE * least)
        closed = (away[:, :half] + away[:, half:]).min(axis=1)
        if closed.min() < least * (1.0 - ROUNDING):
            least, best = float(closed.min()), int(part[closed.argmin()])
    return chain if best is None else _chain_through(cover, best, faces.count)[1]


def _double_cover(faces: Faces, cost: FloatArray) -> csr_matrix:
    """Two copies of all faces, then discs; half of a disc's cost to enter and to leave it."""
    half, face, disc = faces.count + len(cost), faces.touched.indices, faces.count + faces.site
    other = disc + faces.lifts[0] % 2 * half
    tail = np.concatenate((face, face + half))
    head = np.concatenate((other, (other + half) % (2 * half)))
    ends = np.concatenate((tail, head)), np.concatenate((head, tail))
    return csr_matrix((np.tile(cost[faces.site] / 2.0, 4), ends), (2 * half, 2 * half))


def _chain_through(cover: csr_matrix, node: int, faces: int) -> tuple[float, IndexArray | None]:
    """Cost of the cheapest chain through a face or disc, and its sites' rows."""
    half, walk = cover.shape[0] // 2, []
    cost, before = dijkstra(cover, indices=node, return_predecessors=True)
    if not np.isfinite(cost[node + half]):
        return np.inf, None
    at = node + half
    while at != node:
        walk.append(at % half)
        at = before[at]
    discs = np.unique(walk)
    return float(cost[node + half]), discs[discs >= faces] - faces
