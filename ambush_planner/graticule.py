# SPDX-License-Identifier: Apache-2.0
"""Round coordinates around pictures of maps: graticule, ticks, scale bar and north."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .errors import InvalidCoordinates
from .maps.coordinates import Coordinates
from .maps.risk_map import RiskMap


@dataclass(frozen=True, eq=False)
class Graticule:
    """Ticks of a picture, for x along its lower edge and for y along its left one, and lines.

    ``ticks`` are world coordinates [m] and texts: round latitudes and longitudes, of which
    ``lines`` (K, 2) [m] cross the picture, as they are not parallel to its edges; or the map's own
    coordinates in ``unit``, '' for degrees.
    """

    ticks: tuple[tuple[FloatArray, list[str]], ...]
    lines: tuple[FloatArray, ...]
    unit: str


def graticule(risk_map: RiskMap, box: FloatArray, most: int) -> Graticule:
    """Ticks in a box ((left, bottom), (right, top)) [m], up to about ``most`` along an edge.

    Maps without a coordinate system have their own coordinates, in km from a size of 2 km on.
    """
    system = known_system(risk_map.crs)
    if system is None:
        unit, scale = ('km', 1000.0) if max(risk_map.size) >= 2000.0 else ('m', 1.0)
        own = [_round_values(low, high, most) for low, high in box.T.tolist()]
        return Graticule(tuple((at, [f'{value / scale:g}' for value in at]) for at in own), (),
                         unit)
    (left, bottom), (right, top) = box.tolist()
    around = system.to_lat_lon([(left, bottom), (right, bottom), (left, top), (right, top)])
    ticks, lines = [], []
    for axis, end in enumerate(((right, bottom), (left, top))):
        edge = np.linspace((left, bottom), end)
        degrees = system.to_lat_lon(edge)
        kind = int(np.ptp(degrees, axis=0).argmax())  # 0: latitudes vary along it
        order = degrees[:, kind].argsort()
        found = degrees[order, kind]
        values = _round_values(found[0], found[-1], most)
        ticks.append((np.interp(values, found, edge[order, axis]), [
            f'{abs(value):.6g}°{("NS", "EW")[kind][int(value < 0.0)]}' for value in values]))
        low, high = around.min(axis=0), around.max(axis=0)
        other = np.linspace(low[1 - kind], high[1 - kind], 30)
        step = _round_step(found[-1] - found[0], most)
        for value in np.arange(math.ceil(low[kind] / step), high[kind] / step) * step:
            line = np.column_stack((np.full(30, value), other)[:: 1 - 2 * kind])
            lines.append(system.from_lat_lon(line))
    return Graticule(tuple(ticks), tuple(lines), '')


def known_system(crs: str | None) -> Coordinates | None:
    """Return the coordinate system; None if it is unknown, or pyproj is not installed."""
    try:
        return Coordinates(crs or '')
    except InvalidCoordinates:
        return None


def north(crs: str | None, at: FloatArray) -> FloatArray | None:
    """The direction (2,) of true north at a place [m]; None if the system is unknown."""
    if (system := known_system(crs)) is None:
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
