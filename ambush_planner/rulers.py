# SPDX-License-Identifier: Apache-2.0
"""Round coordinates along the edges of pictures of maps, scale bar and north."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .errors import InvalidCoordinates
from .maps.coordinates import Coordinates
from .maps.risk_map import RiskMap


def ticks(risk_map: RiskMap, box: FloatArray, most: int) -> tuple[
        list[tuple[FloatArray, list[str]]], str]:
    """Ticks along x and y in a box ((left, bottom), (right, top)) [m], and their unit.

    They are world coordinates [m] with texts, up to about ``most`` along an edge; in km on maps
    from a size of 2 km on.
    """
    unit, scale = ('km', 1000.0) if max(risk_map.size) >= 2000.0 else ('m', 1.0)
    found = [_round_values(low, high, most) for low, high in box.T.tolist()]
    return [(at, [f'{value / scale:.10g}' for value in at]) for at in found], unit


def north(crs: str | None, at: FloatArray) -> FloatArray | None:
    """The direction (2,) of true north at a place [m]; None if the system is unknown."""
    try:
        system = Coordinates(crs or '')
    except InvalidCoordinates:  # also if pyproj is not installed
        return None
    away = system.from_lat_lon(system.to_lat_lon(at) + (1e-4, 0.0)) - at
    return np.asarray(away / np.hypot(*away))


@dataclass(frozen=True)
class ScaleBar:
    """A bar of a round length [m] from its left end ``xy``; its text is above or below it."""

    xy: tuple[float, float]
    length: float
    is_low: bool

    @property
    def text(self) -> str:
        """The length with its unit."""
        return f'{self.length / 1000:g} km' if self.length >= 1000.0 else f'{self.length:g} m'


def scale_bar(box: FloatArray, avoid: FloatArray | None) -> ScaleBar:
    """The bar in the corner of a box farthest from the places (K, 2) to ``avoid``.

    Without places, that is the lower left one.
    """
    (left, bottom), (right, top) = box.tolist()
    length = _round_step(0.3 * (right - left), 1.0, down=True)
    aside, up = 0.04 * (right - left), 0.04 * (top - bottom)
    corners = np.array([(x, y) for y in (bottom + up, top - up)
                        for x in (left + aside, right - aside - length)])
    best = 0
    if avoid is not None:
        gaps = corners[:, None] + (0.5 * length, 0.0) - avoid
        best = int(np.hypot(*gaps.T).min(axis=0).argmax())
    x, y = corners[best].tolist()
    return ScaleBar((x, y), length, best < 2)


def _round_step(extent: float, most: float, down: bool = False) -> float:
    """The least of ..., 1, 2, 5, 10, ... of which ``most`` cover an extent; or the one below it."""
    share = extent / most
    power = 10.0 ** math.floor(math.log10(share) + 1e-9)
    steps = [each * power for each in (1.0, 2.0, 5.0, 10.0)]
    least = next(each for each in steps if each >= share * (1.0 - 1e-9))
    if down and least > share * (1.0 + 1e-9):
        return steps[steps.index(least) - 1]
    return least


def _round_values(low: float, high: float, most: int) -> FloatArray:
    step = _round_step(high - low, most)
    count = np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return count.astype(np.float64) * step
