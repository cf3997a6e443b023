"""A convoy that asks for the next departure while it drives."""

from __future__ import annotations

import math
import time

import numpy as np

from ..arrays import FloatArray
from .inputs import Trip

# A convoy that asks again within this time of its last departure cannot wait for a solve [s].
_UNDER_WAY = 5.0


class Course:
    """Where and when the latest departure began, and how far from the one before.

    A convoy is known by the frame in which its start is given.
    """

    def __init__(self) -> None:
        self._frames = ('', '')
        self._start, self._left, self._step = (math.nan, math.nan), -math.inf, 0.0

    @property
    def drives(self) -> bool:
        """Whether the convoy drove between its last two departures, of which one has just left."""
        return self._step > 0.0 and self._recently

    def under_way(self, trip: Trip) -> bool:
        """Whether the convoy departed a moment ago, and has driven on or was driving then."""
        return (trip.moves and self._recently and self._frames == _frames(trip)
                and (self._step > 0.0 or self._driven(trip) > 0.0))

    def depart(self, trip: Trip, path: FloatArray) -> tuple[float, float] | None:
        """Note a departure on a path (L, 2) [m]; return where the convoy will ask again.

        By then it will be as far along the path as it has come since its last departure. None if it
        does not drive, or will have arrived.
        """
        self._step = self._driven(trip) if self.under_way(trip) else 0.0
        self._frames, self._start, self._left = _frames(trip), trip.start_xy, time.monotonic()
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        if not 0.0 < self._step < along[-1]:
            return None
        x, y = (float(np.interp(self._step, along, each)) for each in path.T)
        return x, y

    def _driven(self, trip: Trip) -> float:
        """Return how far the convoy is from where it last departed [m]; 0 within a cell."""
        away = math.dist(self._start, trip.start_xy)
        return away if away > trip.map.resolution else 0.0

    @property
    def _recently(self) -> bool:
        return time.monotonic() - self._left < _UNDER_WAY


def _frames(trip: Trip) -> tuple[str, str]:
    return trip.map.frame, trip.start.message.header.frame_id
