"""The least value with a reach and without a binding budget: the cheapest chain of discs.

On a planar two-way network a chain of discs, each with a face in common with the next, separates
the source from the target if it closes around one of them, perhaps through the outer face. Every
route meets it. With q in proportion to 1 / alpha on it, each route loses at least 1 / K, where K is
the sum of 1 / alpha over the chain, and the cheapest chain usually gives the value (docs/theory.md,
Proposition 8.10). It is a shortest path from a disc to its own second copy. The certificate judges
q, so the bound does not depend on any of this.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ..arrays import FloatArray, IndexArray
from .budget import ROUNDING
from .faces import Faces
from .several_sites import SharedSites, share_sites

# Distances that are held at once: bounds the memory of searches that run together.
_DISTANCES = 2**22
# How far they go, as a share of the cheapest chain: a chain has a middle within this of its first
# disc on both ways, as faces and discs on it are at most half of its cost apart.
_MIDDLE = 0.75


def chain_ambusher(legs: Sequence[Faces]) -> SharedSites | None:
    """q on the cheapest chain of discs of any leg, or on several chains; None if there is none."""
    game = legs[0].game

    def cheapest(cost: FloatArray) -> IndexArray | None:
        chains = [c for c in (cheapest_chain(faces, cost) for faces in legs) if c is not None]
        return min(chains, key=lambda chain: float(cost[chain].sum()), default=None)

    return share_sites(game.loss[game.sites], game.ambushers, cheapest)


def cheapest_chain(faces: Faces, cost: FloatArray) -> IndexArray | None:
    """The sites' rows of the chain of discs of least cost (S,) that separates the ends, if any."""
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
