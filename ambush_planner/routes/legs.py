"""Legs of a path: the straight lines between its way points, for a driver's sheet."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray

# Maximum number of legs; a path with more stops has a leg to each.
MAX_LEGS = 12
# Maximum distance of a path from its legs, as a share of its length, if MAX_LEGS allow it.
MAX_STRAY = 0.005
# Points along a path at which held ground is looked for.
_SAMPLES = 4000


@dataclass(frozen=True, eq=False)
class Legs:
    """Way points (W, 2) [m] of a path, the first its start, and the distances (W,) to them [m].

    Distances are along the path, so the last one is its length.
    """

    way_points: FloatArray
    distances: FloatArray


def legs(path: FloatArray, stops: FloatArray) -> Legs:
    """Return the legs of a path (L, 2) [m]; its ends, ``stops`` (S, 2) and corners are way points.

    The point farthest from the legs becomes a way point, until none is farther than ``MAX_STRAY``
    or there are ``MAX_LEGS``.

    Source: D. Douglas, T. Peucker, *Algorithms for the reduction of the number of points required
    to represent a digitized line*, Cartographica 10, 1973.
    """
    along = distances_along(path)
    chosen = {0, len(path) - 1, *(int(_away(path, stop).argmin()) for stop in stops)}
    while len(chosen) <= MAX_LEGS:
        ends = np.array(sorted(chosen))
        away = np.concatenate([_from_line(path[first:last], path[last])
                               for first, last in pairwise(ends)])
        if away.max() <= MAX_STRAY * along[-1]:
            break
        chosen.add(int(away.argmax()))
    at: IndexArray = np.array(sorted(chosen))
    return Legs(path[at], along[at])


def distances_along(path: FloatArray) -> FloatArray:
    """Distances (L,) along a path (L, 2) from its start [m]."""
    return np.concatenate(([0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()))


def bearings(points: FloatArray) -> FloatArray:
    """Directions (W - 1,) from each point (W, 2) to the next, clockwise from y [degrees]."""
    east, north = np.diff(points, axis=0).T
    return np.degrees(np.arctan2(east, north)) % 360.0


def held_stretches(path: FloatArray, places: FloatArray,
                   radius: float) -> list[tuple[float, float]]:
    """Return where a path (L, 2) is within ``radius`` of a place (P, 2): distances along it [m]."""
    along = distances_along(path)
    at = np.linspace(0.0, along[-1], _SAMPLES)
    points = np.column_stack([np.interp(at, along, axis) for axis in path.T])
    held = np.min([_away(points, place) for place in places], axis=0) <= radius
    edges = np.flatnonzero(np.diff(np.concatenate(([0], held, [0])))).reshape(-1, 2)
    return [(float(at[first]), float(at[last - 1])) for first, last in edges]


def _away(points: FloatArray, place: npt.ArrayLike) -> FloatArray:
    return np.hypot(*(points - np.asarray(place)).T)


def _from_line(points: FloatArray, end: FloatArray) -> FloatArray:
    """Distances (K,) of points (K, 2) from the line between the first one and ``end``."""
    start, line = points[0], end - points[0]
    share = (points - start) @ line / max(line @ line, np.finfo(np.float64).tiny)
    return _away(points, start + np.clip(share, 0.0, 1.0)[:, None] * line)
