# SPDX-License-Identifier: Apache-2.0
"""Legs of a path (L, 2) [m]: the straight lines between its way points, for a driver's sheet."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..arrays import FloatArray, IndexArray

# Maximum number of legs, unless there are more stops.
MAX_LEGS = 12
# Maximum distance of a path from its legs, as a share of its length, if MAX_LEGS allow it.
MAX_STRAY = 0.005
# Number of points along a path that are looked up in the secured area.
_SAMPLES = 4000


def way_points(path: FloatArray, stops: FloatArray) -> IndexArray:
    """Return the indices (W,) of a path's ends, of its stops (S, 2), and of its main corners.

    The point farthest from the legs becomes a way point, until none is farther than ``MAX_STRAY``
    or there are ``MAX_LEGS``.

    Source: D. Douglas, T. Peucker, *Algorithms for the reduction of the number of points required
    to represent a digitized line*, Cartographica 10, 1973.
    """
    chosen = {0, len(path) - 1, *(int(_away(path, stop).argmin()) for stop in stops)}
    allowed = MAX_STRAY * distances_along(path)[-1]
    while len(chosen) <= MAX_LEGS:
        away = np.concatenate([_from_line(path[first:last], path[last])
                               for first, last in pairwise(sorted(chosen))])
        if away.max() <= allowed:
            break
        chosen.add(int(away.argmax()))
    return np.array(sorted(chosen))


def distances_along(path: FloatArray) -> FloatArray:
    """Distances (L,) along a path from its start [m]."""
    return np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))


def bearings(points: FloatArray) -> FloatArray:
    """Directions (W - 1,) from each point (W, 2) to the next, clockwise from y [degrees]."""
    return np.degrees(np.arctan2(*np.diff(points, axis=0).T)) % 360.0


def secured_stretches(path: FloatArray, places: FloatArray, radius: float) -> FloatArray:
    """Return where a path is within ``radius`` of a place (P, 2): ends (K, 2) along it [m]."""
    along = distances_along(path)
    at = np.linspace(0.0, along[-1], _SAMPLES)
    points = np.column_stack([np.interp(at, along, axis) for axis in path.T])
    secured = np.min([_away(points, place) for place in places], axis=0) <= radius
    edges = np.flatnonzero(np.diff(np.concatenate(([0], secured, [0])))).reshape(-1, 2)
    return at[edges - (0, 1)]


def _away(points: FloatArray, place: FloatArray) -> FloatArray:
    return np.hypot(*(points - place).T)


def _from_line(points: FloatArray, end: FloatArray) -> FloatArray:
    """Distances (K,) of points (K, 2) from the line between the first one and ``end``."""
    start, line = points[0], end - points[0]
    share = (points - start) @ line / max(line @ line, np.finfo(np.float64).tiny)
    return _away(points, start + np.clip(share, 0.0, 1.0)[:, None] * line)
