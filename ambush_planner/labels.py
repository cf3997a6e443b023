# SPDX-License-Identifier: Apache-2.0
"""Places for names and numbers in a picture, where they cover nothing that is needed."""

from __future__ import annotations

import numpy as np

from .arrays import BoolArray, FloatArray, IndexArray

# Distances of a label from its point that are tried, as multiples of the gap, and directions.
_RINGS, _DIRECTIONS = (1.0, 2.5, 5.0, 8.0, 12.0, 17.0, 23.0, 30.0), 16
# What covering another label or leaving the picture costs, and covering a busy point, up to some
# of them, in rings farther away.
_COVERED, _BUSY, _MOST = 1000.0, 1.5, 4


class Labels:
    """The rectangles of labels so far in a picture; lengths are in its units.

    ``frame`` (2, 2) has the corners of the picture. Labels do not cover the rectangles ``taken``
    (T, 4) = (left, bottom, right, top) and each other, nor, if possible, the ``busy`` points
    (N, 2).
    """

    def __init__(self, frame: FloatArray, busy: FloatArray, taken: FloatArray) -> None:
        self._frame, self._busy, self._taken = frame, busy, taken

    def place(self, point: FloatArray, size: FloatArray, gap: float,
              is_round: bool = False) -> FloatArray:
        """The centre (2,) of a label of a size (2,) near a point, at least ``gap`` from it."""
        angles = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
        around = np.column_stack((np.cos(angles), np.sin(angles)))
        around /= 1.0 if is_round else np.abs(around).max(axis=1, keepdims=True)
        away = np.repeat(_RINGS, _DIRECTIONS)[:, None] * gap
        centres = point + np.tile(around, (len(_RINGS), 1)) * (size / 2.0 + away)
        covered, busy = self._costs(centres, size)
        ring = np.repeat(np.arange(len(_RINGS)), _DIRECTIONS)
        best = (ring + _COVERED * covered + _BUSY * np.minimum(busy, _MOST)).argmin()
        return self._take(centres[best], size)

    def choose(self, places: FloatArray, size: FloatArray) -> FloatArray | None:
        """The centre (2,) of a label on one of some places (C, 2); None if it would cover others.

        Of the places where it covers fewest busy points, it is the middle one.
        """
        covered, busy = self._costs(places, size)
        if covered.all():
            return None
        best = np.flatnonzero(~covered & (busy == busy[~covered].min()))
        return self._take(places[best[len(best) // 2]], size)

    def _costs(self, centres: FloatArray, size: FloatArray) -> tuple[BoolArray, IndexArray]:
        """Return whether labels at centres (C, 2) do not fit, and the busy points they cover."""
        low, high = centres - size / 2.0, centres + size / 2.0
        left, right = self._taken[:, :2], self._taken[:, 2:]
        over = np.all((low[:, None] < right) & (high[:, None] > left), axis=2)
        outside = np.any((low < self._frame[0]) | (high > self._frame[1]), axis=1)
        busy = np.all((self._busy > low[:, None]) & (self._busy < high[:, None]), axis=2)
        return np.asarray(over.any(axis=1) | outside), np.asarray(busy.sum(axis=1))

    def _take(self, centre: FloatArray, size: FloatArray) -> FloatArray:
        box = np.concatenate((centre - size / 2.0, centre + size / 2.0))
        self._taken = np.vstack((self._taken, box))
        return centre
