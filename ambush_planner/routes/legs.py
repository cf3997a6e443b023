# SPDX-License-Identifier: Apache-2.0
"""Legs of a path (L, 2) [m]: the straight lines between its way points; and simpler lines."""

from __future__ import annotations

import math
from collections.abc import Iterable
from heapq import heapify, heappop, heappush
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray, IndexArray

# Maximum number of legs, unless there are more stops.
MAX_LEGS = 12
# Largest distance of a path from its legs, as a share of its length, unless MAX_LEGS prevents it.
MAX_DEVIATION = 0.005
# Number of points along a path at which the secured area is tested.
_SAMPLES = 4000


def corners_of_legs(path: FloatArray, stops: FloatArray) -> IndexArray:
    """Return the indices (W,) of a path's ends, of its stops (S, 2), and of its main corners."""
    return main_corners(path, MAX_DEVIATION * float(distances_along(path)[-1]),
                        [int(_distance_from(path, stop).argmin()) for stop in stops], MAX_LEGS)


def main_corners(line: FloatArray, tolerance: float, fixed: Iterable[int] = (),
                 max_parts: float = math.inf) -> IndexArray:
    """Return the indices (K,) of the corners that simplify a line (L, 2).

    The ends and the ``fixed`` points are corners. The point farthest from the straight parts
    becomes a corner as well, until none is farther than ``tolerance`` [m] or there are
    ``max_parts``.

    Source: D. Douglas, T. Peucker, *Algorithms for the reduction of the number of points required
    to represent a digitized line*, Cartographica 10, 1973.
    """
    corners = sorted({0, len(line) - 1, *fixed})
    parts = [_farthest(line, *part) for part in pairwise(corners)]
    heapify(parts)
    while parts and -parts[0][0] > tolerance and len(corners) <= max_parts:
        _, corner, first, last = heappop(parts)
        corners.append(corner)
        for part in ((first, corner), (corner, last)):
            heappush(parts, _farthest(line, *part))
    return np.array(sorted(corners))


def distances_along(path: FloatArray) -> FloatArray:
    """Distances (L,) along a path from its start [m]."""
    return np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))


def bearings(points: FloatArray) -> FloatArray:
    """Directions (W - 1,) from each point (W, 2) to the next, clockwise from y [degrees]."""
    return np.degrees(np.arctan2(*np.diff(points, axis=0).T)) % 360.0


def secured_stretches(path: FloatArray, places: FloatArray, radius: float) -> FloatArray:
    """Stretches of a path within ``radius`` of a place (P, 2): their ends (K, 2) along it [m]."""
    travelled = distances_along(path)
    samples = np.linspace(0.0, travelled[-1], _SAMPLES)
    points = np.column_stack([np.interp(samples, travelled, axis) for axis in path.T])
    secured = np.min([_distance_from(points, place) for place in places], axis=0) <= radius
    edges = np.flatnonzero(np.diff(np.concatenate(([0], secured, [0])))).reshape(-1, 2)
    return samples[edges - (0, 1)]


def _distance_from(points: FloatArray, place: FloatArray) -> FloatArray:
    return np.hypot(*(points - place).T)


def _farthest(line: FloatArray, first: int, last: int) -> tuple[float, int, int, int]:
    """Largest distance from a chord, negated for a heap; index of the point; ends of the chord."""
    start, chord = line[first], line[last] - line[first]
    share = (line[first:last] - start) @ chord / max(chord @ chord, np.finfo(np.float64).tiny)
    distance = _distance_from(line[first:last], start + np.clip(share, 0.0, 1.0)[:, None] * chord)
    return -float(distance.max()), first + int(distance.argmax()), first, last
