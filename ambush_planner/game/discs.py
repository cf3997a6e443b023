# SPDX-License-Identifier: Apache-2.0
"""Ambushes with a reach: the secured area, and the edges by which a route enters a site's disc.

The secured area protects convoys inside it: only the exposed part of an edge, outside that area,
can be hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.spatial import cKDTree

from ..arrays import ROUNDING, BoolArray, FloatArray, IndexArray

# Discs that are handled together; it limits the memory for pairs of a disc and an edge nearby.
_BATCH = 500


def in_disc(position: FloatArray, radius: float) -> BoolArray:
    """Return whether points (K, 2), relative to the centre, lie in the closed disc.

    Every test of a point goes through this function, so that consecutive edges agree about their
    common node despite rounding.
    """
    return np.asarray(np.einsum('ij,ij->i', position, position) <= radius * radius)


class SecuredArea(NamedTuple):
    """The union of discs with ``centres`` (E, 2) and ``radii`` (E,) [m] that the convoy secures."""

    centres: FloatArray
    radii: FloatArray

    def shrink(self, margin: float) -> SecuredArea:
        """Reduce the radii by ``margin`` [m]; discs that vanish are dropped."""
        left = self.radii > margin
        return SecuredArea(self.centres[left], self.radii[left] - margin)

    def covers(self, points: FloatArray) -> BoolArray:
        """Return whether points (K, 2) are in the secured area."""
        covered = np.zeros(len(points), dtype=bool)
        for centre, radius in zip(*self, strict=True):
            covered |= in_disc(points - centre, radius)
        return covered


def secured_area(ends: FloatArray, radius: float,
                 places: Sequence[tuple[float, float, float]] = ()) -> SecuredArea:
    """Make discs of ``radius`` [m] around ``ends`` (E, 2) of legs, and of ``places`` (x, y, r)."""
    others = np.array(places, dtype=np.float64).reshape(-1, 3)
    return SecuredArea(np.concatenate((ends, others[:, :2])),
                       np.append(np.full(len(ends), radius), others[:, 2]))


class ExposedEdges:
    """The parts of edges outside the secured area, indexed for queries of the discs they enter."""

    def __init__(self, points: FloatArray, edges: IndexArray, secured: SecuredArea,
                 sources: IndexArray, used: IndexArray | None = None) -> None:
        """``edges`` (M, 2) between ``points`` (N, 2); routes begin at the nodes ``sources`` (B,).

        ``used`` (K,) are the edges that can be driven, by default all.
        """
        used = np.arange(len(edges)) if used is None else used
        self._count = len(edges)
        self._parts = parts = _exposed_parts(points, edges, used, secured)
        # With a margin, so that the edge into an exposed node certainly has an exposed part there.
        exposed = ~secured._replace(radii=secured.radii * (1.0 + ROUNDING)).covers(points)
        exposed[sources] = False  # no edge leads there
        tails = edges[parts.edge, 0]
        self._tails, self._from_exposed = points[tails], exposed[tails]
        self._at_tail = self._from_exposed & (parts.begin == self._tails).all(axis=1)
        self._length = np.hypot(*(parts.end - parts.begin).T)
        # About six parts begin at one place, so pairs of places and discs are filtered first.
        places, place = np.unique(parts.begin, axis=0, return_inverse=True)
        index = place.ravel(), np.arange(len(place))
        self._tree = cKDTree(places)
        self._parts_at = csr_matrix((self._length, index), (len(places), len(place)))
        self._longest = np.zeros(len(places))
        np.maximum.at(self._longest, index[0], self._length)
        self._at_tails = np.bincount(index[0], ~self._at_tail, len(places)) == 0.0

    def entering(self, centres: FloatArray, reach: float) -> csr_matrix:
        """Rows (K, M) of 0 and 1: the edges by which a route enters each disc of ``centres``.

        All discs have the radius ``reach`` [m]. An edge counts if its exposed part meets the disc,
        unless its exposed tail lies in it, since then an edge before has entered it. A route is hit
        exactly if it uses an edge of the row; the row's sum along the route counts its entries.
        """
        rows = [csr_matrix((0, self._count))]
        for first in range(0, len(centres), _BATCH):
            batch = centres[first : first + _BATCH]
            part, site, uncertain = self._close_pairs(batch, reach)
            enters = self._enters(part, batch[site], reach, uncertain)
            places = site[enters], self._parts.edge[part[enters]]
            rows.append(csr_matrix((np.ones(len(places[0])), places), (len(batch), self._count)))
        stacked = csr_matrix(vstack(rows))
        stacked.data[:] = 1.0  # an edge with several exposed parts counts once
        return stacked

    def _close_pairs(self, centres: FloatArray,
                     reach: float) -> tuple[IndexArray, IndexArray, IndexArray]:
        """Find pairs of a part (K,) and a centre (K,) that may meet, by their distances.

        Parts whose exposed tail certainly lies in the disc are left out. The third array has the
        indices of pairs for which it is uncertain whether the part begins in the disc.
        """
        range_ = (reach + self._longest.max(initial=0.0)) * (1.0 + ROUNDING)
        pairs = self._tree.sparse_distance_matrix(cKDTree(centres), range_, output_type='ndarray')
        place, distance = pairs['i'], pairs['v']
        close = distance <= (reach + self._longest[place]) * (1.0 + ROUNDING)
        close &= ~(self._at_tails[place] & (distance < reach * (1.0 - ROUNDING)))
        parts = self._parts_at[place[close]]
        part, pair = parts.indices, np.repeat(np.flatnonzero(close), np.diff(parts.indptr))
        centre, distance = pairs['j'][pair], distance[pair]
        at_tail = self._at_tail[part]
        close = distance <= (reach + self._length[part]) * (1.0 + ROUNDING)
        close &= ~(at_tail & (distance < reach * (1.0 - ROUNDING)))
        uncertain = ~at_tail | (distance <= reach * (1.0 + ROUNDING))
        return part[close], centre[close], np.flatnonzero(uncertain[close])

    def _enters(self, part: IndexArray, centre: FloatArray, reach: float,
                uncertain: IndexArray) -> BoolArray:
        """Return whether parts (K,) enter the discs around ``centre`` (K, 2).

        Only those with the indices ``uncertain`` may begin in the disc.
        """
        end = self._parts.end[part] - centre
        enters = in_disc(end, reach)
        parts, centres = part[uncertain], centre[uncertain]
        enters[uncertain] |= in_disc(self._parts.begin[parts] - centres, reach)
        others = np.flatnonzero(~enters)
        begin = self._parts.begin[part[others]] - centre[others]
        enters[others] = _crosses(begin, end[others], reach)
        entered = self._from_exposed[parts] & in_disc(self._tails[parts] - centres, reach)
        enters[uncertain[entered]] = False
        return enters


class _Parts(NamedTuple):
    """Exposed parts of edges: the edge (K,) of each, and its two ends (K, 2)."""

    edge: IndexArray
    begin: FloatArray
    end: FloatArray


def _exposed_parts(points: FloatArray, edges: IndexArray, used: IndexArray,
                   secured: SecuredArea) -> _Parts:
    """Cut the ``used`` (K,) edges into their parts outside the secured area.

    Each disc splits a part into the piece before it and the piece after it.
    """
    tail, head = (points[edges[used, k]] for k in (0, 1))
    index = np.arange(len(used))
    first, last = np.zeros(len(used)), np.ones(len(used))
    for centre, radius in zip(*secured, strict=True):
        begin, end = _disc_interval(tail[index] - centre, head[index] - centre, radius)
        pieces = (first, np.minimum(last, begin)), (np.maximum(first, end), last)
        index = np.tile(index, 2)
        first, last = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
        valid = last > first
        index, first, last = index[valid], first[valid], last[valid]
    tail, vector = tail[index], (head - tail)[index]
    end = np.where(last[:, None] == 1.0, head[index], tail + last[:, None] * vector)
    return _Parts(used[index], tail + first[:, None] * vector, end)


def _disc_interval(tail: FloatArray, head: FloatArray,
                   radius: float) -> tuple[FloatArray, FloatArray]:
    """Parameters 0..1 at which segments (K,) enter and leave the disc; 1 and 1: they miss it."""
    vector = head - tail
    squared = np.maximum((vector**2).sum(axis=1), np.finfo(float).tiny)
    middle = -(tail * vector).sum(axis=1) / squared
    rest = (radius**2 - ((tail + middle[:, None] * vector)**2).sum(axis=1)) / squared
    half = np.sqrt(np.maximum(rest, 0.0))
    met = (rest > 0.0) & (middle - half < 1.0) & (middle + half > 0.0)
    return np.where(met, middle - half, 1.0), np.where(met, middle + half, 1.0)


def _crosses(begin: FloatArray, end: FloatArray, reach: float) -> BoolArray:
    """Return whether segments (K,) enter the disc between their ends."""
    vector = end - begin
    squared = (vector**2).sum(axis=1)
    projection = -(begin * vector).sum(axis=1)
    inner = (projection > 0.0) & (projection < squared)
    t = np.where(inner, projection / np.where(inner, squared, 1.0), 0.0)
    return np.asarray(inner & in_disc(begin + t[:, None] * vector, reach))
