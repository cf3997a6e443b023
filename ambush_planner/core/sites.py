"""Ambush sites with a reach: which edges enter which disc."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from .network import IndexArray, Network
from .risk_map import FloatArray


def entering_edges(network: Network, sites: IndexArray, radius: float) -> csr_matrix:
    """(S, M) 0/1: edges whose segment meets the closed disc and whose tail lies outside of it."""
    centres = network.points[sites]
    edge, site = _close_pairs(network, centres, radius)
    tail = network.points[network.tails[edge]] - centres[site]
    head = network.points[network.heads[edge]] - centres[site]
    enters = (np.hypot(*tail.T) > radius) & (_distance_to_segment(tail, head) <= radius)
    shape = (len(sites), len(network.edges))
    return csr_matrix((np.ones(int(enters.sum())), (site[enters], edge[enters])), shape=shape)


def _close_pairs(
    network: Network, centres: FloatArray, radius: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(edge, site) pairs near enough that the segment may meet the disc."""
    middle = (network.points[network.tails] + network.points[network.heads]) / 2
    near = cKDTree(centres).query_ball_point(middle, radius + network.lengths / 2 + 1e-9 * radius)
    counts = np.array([len(found) for found in near], dtype=np.int64)
    edge = np.repeat(np.arange(len(counts)), counts)
    site = np.array([k for found in near for k in found], dtype=np.int64)
    return edge, site


def _distance_to_segment(tail: FloatArray, head: FloatArray) -> FloatArray:
    """Distance of the origin to segments tail -> head, both (K, 2)."""
    along = head - tail
    squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    t = np.clip(-(tail * along).sum(axis=1) / squared, 0.0, 1.0)
    distance: FloatArray = np.hypot(*(tail + t[:, None] * along).T)
    return distance
