# SPDX-License-Identifier: Apache-2.0
"""Ambushes with a reach: the secured area, and the edges that bring a route into a site's disc.

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

# Discs that are handled together: bounds the memory, pairs of a disc and an edge nearby.
_CENTRES_AT_ONCE = 500


def inside(offset: FloatArray, radius: float) -> BoolArray:
    """Return whether points, by their offsets (K, 2) from a centre, lie in the closed disc.

    All code decides this here, so that consecutive edges agree about their common node.
    """
    return np.asarray(np.einsum('ij,ij->i', offset, offset) <= radius * radius)


class SecuredArea(NamedTuple):
    """Discs of the secured area: ``centres`` (E, 2) and ``radii`` (E,) [m]."""

    centres: FloatArray
    radii: FloatArray

    def shrunk(self, by: float) -> SecuredArea:
        """The discs with radii reduced ``by`` some metres, without those that vanish."""
        kept = self.radii > by
        return SecuredArea(self.centres[kept], self.radii[kept] - by)

    def covers(self, points: FloatArray) -> BoolArray:
        """Return whether points (K, 2) are in the secured area."""
        covered = np.zeros(len(points), dtype=bool)
        for centre, radius in zip(*self, strict=True):
            covered |= inside(points - centre, radius)
        return covered


def secured_area(ends: FloatArray, radius: float,
                 places: Sequence[tuple[float, float, float]] = ()) -> SecuredArea:
    """Discs of ``radius`` [m] around the ``ends`` (E, 2) of legs, and ``places`` (x, y, radius)."""
    more = np.array(places, dtype=np.float64).reshape(-1, 3)
    return SecuredArea(np.concatenate((ends, more[:, :2])),
                       np.append(np.full(len(ends), radius), more[:, 2]))


class ExposedEdges:
    """The parts of edges, by default all, outside the secured area, and the discs they enter."""

    def __init__(self, points: FloatArray, edges: IndexArray, secured: SecuredArea,
                 begins: IndexArray, used: IndexArray | None = None) -> None:
        """``edges`` (M, 2) between ``points`` (N, 2); routes begin at some nodes (B,).

        ``used`` (K,): which edges can be driven, by default all.
        """
        used = np.arange(len(edges)) if used is None else used
        self._count = len(edges)
        self._parts = parts = _exposed_parts(points, edges, used, secured)
        # By a margin, so that the edge before an exposed node certainly has an exposed part there.
        exposed = ~secured._replace(radii=secured.radii * (1.0 + ROUNDING)).covers(points)
        exposed[begins] = False  # no edge before it
        tails = edges[parts.edge, 0]
        self._tails, self._from_exposed = points[tails], exposed[tails]
        self._at_tail = self._from_exposed & (parts.begin == self._tails).all(axis=1)
        self._length = np.hypot(*(parts.end - parts.begin).T)
        # About six parts begin at a place: most pairs of place and disc are out of the question.
        places, place = np.unique(parts.begin, axis=0, return_inverse=True)
        index = place.ravel(), np.arange(len(place))
        self._tree = cKDTree(places)
        self._parts_at = csr_matrix((self._length, index), (len(places), len(place)))
        self._longest = np.zeros(len(places))
        np.maximum.at(self._longest, index[0], self._length)
        self._at_tails = np.bincount(index[0], ~self._at_tail, len(places)) == 0.0

    def entering(self, centres: FloatArray, reach: float) -> csr_matrix:
        """(K, M) of 0 and 1: the edges by which a route enters the discs of radius ``reach`` [m].

        An edge counts if its exposed part meets the disc, unless the edge before it has brought the
        route there. A route is hit exactly if it uses one of the row's edges; the sum of the row
        along the route is the number of times that the route enters the disc.
        """
        rows = [csr_matrix((0, self._count))]
        for first in range(0, len(centres), _CENTRES_AT_ONCE):
            some = centres[first : first + _CENTRES_AT_ONCE]
            part, site, unsure = self._close_pairs(some, reach)
            enters = self._enters(part, some[site], reach, unsure)
            places = site[enters], self._parts.edge[part[enters]]
            rows.append(csr_matrix((np.ones(len(places[0])), places), (len(some), self._count)))
        found = csr_matrix(vstack(rows))
        found.data[:] = 1.0  # once, however many exposed parts
        return found

    def _close_pairs(self, centres: FloatArray,
                     reach: float) -> tuple[IndexArray, IndexArray, IndexArray]:
        """(part, centre) pairs that may meet, without parts that the route enters the disc before.

        They begin at an exposed node in the disc. The third array has the indices of the pairs
        whose part may begin in the disc all the same.
        """
        far = (reach + self._longest.max(initial=0.0)) * (1.0 + ROUNDING)
        pairs = self._tree.sparse_distance_matrix(cKDTree(centres), far, output_type='ndarray')
        place, distance = pairs['i'], pairs['v']
        near = distance <= (reach + self._longest[place]) * (1.0 + ROUNDING)
        near &= ~(self._at_tails[place] & (distance < reach * (1.0 - ROUNDING)))
        beginning = self._parts_at[place[near]]
        part, pair = beginning.indices, np.repeat(np.flatnonzero(near), np.diff(beginning.indptr))
        centre, distance = pairs['j'][pair], distance[pair]
        at_tail = self._at_tail[part]
        near = distance <= (reach + self._length[part]) * (1.0 + ROUNDING)
        near &= ~(at_tail & (distance < reach * (1.0 - ROUNDING)))
        unsure = ~at_tail | (distance <= reach * (1.0 + ROUNDING))
        return part[near], centre[near], np.flatnonzero(unsure[near])

    def _enters(self, part: IndexArray, centre: FloatArray, reach: float,
                unsure: IndexArray) -> BoolArray:
        """Return whether parts (K,) enter the discs around ``centre`` (K, 2).

        Only those with the indices ``unsure`` may begin in the disc.
        """
        end = self._parts.end[part] - centre
        enters = inside(end, reach)
        doubtful, centres = part[unsure], centre[unsure]
        enters[unsure] |= inside(self._parts.begin[doubtful] - centres, reach)
        others = np.flatnonzero(~enters)
        begin = self._parts.begin[part[others]] - centre[others]
        enters[others] = _crosses(begin, end[others], reach)
        before = self._from_exposed[doubtful] & inside(self._tails[doubtful] - centres, reach)
        enters[unsure[before]] = False
        return enters


class _Parts(NamedTuple):
    """Exposed parts of edges: their edges (K,), and both ends (K, 2)."""

    edge: IndexArray
    begin: FloatArray
    end: FloatArray


def _exposed_parts(points: FloatArray, edges: IndexArray, used: IndexArray,
                   secured: SecuredArea) -> _Parts:
    """The parts of the ``used`` (K,) edges outside the secured area."""
    tail, head = (points[edges[used, k]] for k in (0, 1))
    which = np.arange(len(used))
    first, last = np.zeros(len(used)), np.ones(len(used))
    for centre, radius in zip(*secured, strict=True):
        begin, end = _inside_interval(tail[which] - centre, head[which] - centre, radius)
        pieces = (first, np.minimum(last, begin)), (np.maximum(first, end), last)
        which = np.tile(which, 2)
        first, last = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
        kept = last > first
        which, first, last = which[kept], first[kept], last[kept]
    tail, along = tail[which], (head - tail)[which]
    end = np.where(last[:, None] == 1.0, head[which], tail + last[:, None] * along)
    return _Parts(used[which], tail + first[:, None] * along, end)


def _inside_interval(tail: FloatArray, head: FloatArray,
                     radius: float) -> tuple[FloatArray, FloatArray]:
    """Return the shares of segments (K,) where they enter and leave the disc; (1, 1): none."""
    along = head - tail
    squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    middle = -(tail * along).sum(axis=1) / squared
    rest = (radius**2 - ((tail + middle[:, None] * along)**2).sum(axis=1)) / squared
    half = np.sqrt(np.maximum(rest, 0.0))
    met = (rest > 0.0) & (middle - half < 1.0) & (middle + half > 0.0)
    return np.where(met, middle - half, 1.0), np.where(met, middle + half, 1.0)


def _crosses(begin: FloatArray, end: FloatArray, reach: float) -> BoolArray:
    """Return whether segments (K,) come into the disc between their ends."""
    along = end - begin
    squared = (along**2).sum(axis=1)
    projection = -(begin * along).sum(axis=1)
    inner = (projection > 0.0) & (projection < squared)
    t = np.where(inner, projection / np.where(inner, squared, 1.0), 0.0)
    return np.asarray(inner & inside(begin + t[:, None] * along, reach))
