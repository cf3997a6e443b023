"""Ambushes with a reach: the edges that enter the disc around each site."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray
from ..network.network import Network


def inside(offset: FloatArray, radius: float) -> BoolArray:
    """Whether points, given by their offsets (K, 2) from a centre, lie in the closed disc.

    All code decides this here, so that consecutive edges agree about their common node.
    """
    return np.asarray(np.hypot(offset[:, 0], offset[:, 1]) <= radius)


def near_ends(network: Network, radius: float) -> BoolArray:
    """Nodes (N,) within ``radius`` [m] of the source, a stop or the target."""
    ends = (network.source, *network.stops, network.target)
    near = [inside(network.points - network.points[end], radius) for end in ends]
    return np.asarray(np.any(near, axis=0))


def entering_edges(network: Network, sites: IndexArray, radius: float) -> csr_matrix:
    """(S, M) 0/1: edges whose tail lies outside a site's disc and whose segment meets it.

    The sum of a row along any route that starts outside is the number of times that the route
    enters the disc.
    """
    centres = network.points[sites]
    edge, site = _close_pairs(network, centres, radius)
    tail = network.points[network.tails[edge]] - centres[site]
    head = network.points[network.heads[edge]] - centres[site]
    enters = ~inside(tail, radius) & (inside(head, radius) | _crosses(tail, head, radius))
    shape = (len(sites), len(network.edges))
    return csr_matrix((np.ones(int(enters.sum())), (site[enters], edge[enters])), shape=shape)


def _close_pairs(network: Network, centres: FloatArray,
                 radius: float) -> tuple[IndexArray, IndexArray]:
    """(edge, site) pairs whose segment may meet the disc."""
    middle = (network.points[network.tails] + network.points[network.heads]) / 2
    reach = (radius + network.lengths / 2) * (1.0 + 1e-9)
    near = cKDTree(centres).query_ball_point(middle, reach) if len(centres) else []
    counts = np.array([len(found) for found in near], dtype=np.int64)
    site = np.fromiter((k for found in near for k in found), np.int64, int(counts.sum()))
    return np.repeat(np.arange(len(counts)), counts), site


def _crosses(tail: FloatArray, head: FloatArray, radius: float) -> BoolArray:
    """Whether segments (K,) come into the disc between their ends."""
    along = head - tail
    squared = (along**2).sum(axis=1)
    projection = -(tail * along).sum(axis=1)
    between = (projection > 0.0) & (projection < squared)
    t = np.where(between, projection / np.where(between, squared, 1.0), 0.0)
    return np.asarray(between & inside(tail + t[:, None] * along, radius))
