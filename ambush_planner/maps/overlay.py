# SPDX-License-Identifier: Apache-2.0
"""Add the obstacles of one map, such as a costmap, to a risk map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, IndexArray
from .obstacles import CellCounts
from .occupancy import OBSTACLE, UNKNOWN, OccupancyMap
from .risk_map import TOUCH, to_map_axes


def with_obstacles_of(risk: OccupancyMap, other: OccupancyMap, threshold: int,
                      unknown: bool) -> OccupancyMap:
    """Return a risk map with the obstacles of another map in the same frame.

    A cell of the risk map becomes an obstacle if any cell of the other map that overlaps it has at
    least the value ``threshold`` or, with ``unknown``, is unknown. If the maps are rotated against
    each other, the rectangle around the rotated cell counts. Ground that the other map does not
    cover stays as it is.
    """
    blocked = (other.values >= threshold) | (unknown & (other.values == UNKNOWN))
    y, x = np.ix_(*(np.arange(count) + 0.5 for count in risk.values.shape))
    scale = risk.resolution / other.resolution
    turn = risk.origin[2] - other.origin[2]
    cosine, sine = scale * math.cos(turn), scale * math.sin(turn)
    if abs(sine) < TOUCH * scale:
        sine = 0.0
    shift = to_map_axes(other.origin, risk.origin[:2]) / other.resolution
    # Without a rotation, rows and columns broadcast instead of all cells being computed.
    u = shift[0] + cosine * x - (sine * y if sine else 0.0)
    v = shift[1] + cosine * y + (sine * x if sine else 0.0)
    half = (abs(cosine) + abs(sine)) / 2.0
    rows, columns = (_range(each, half, size) for each, size in
                     zip((v, u), other.values.shape, strict=True))
    count = CellCounts(blocked).within(rows, columns)
    values = np.where(count > 0, np.int8(OBSTACLE), risk.values)
    return replace(risk, values=values)


def _range(middle: FloatArray, half: float, size: int) -> tuple[IndexArray, IndexArray]:
    """First cells, and those after the last ones, within ``half`` of places [cells]."""
    low, high = np.floor(middle - half + TOUCH), np.ceil(middle + half - TOUCH)
    first, end = (np.clip(each, 0, size).astype(np.int64) for each in (low, high))
    return first, end
