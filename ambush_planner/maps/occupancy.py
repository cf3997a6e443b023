# SPDX-License-Identifier: Apache-2.0
"""Occupancy grids, and the conversion of their values -1..100 to losses and obstacles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray
from ..errors import InvalidOption, InvalidRiskMap
from ..option_checks import allowed, check_options
from .coordinates import agree
from .risk_map import LOSSES, MAX_LOSS, MIN_LOSS, GradedLosses, RiskMap, check_place

# Values of an obstacle's cells and of unknown ones.
OBSTACLE, UNKNOWN = 100, -1
NO_RISK = ('every free cell of the map has the same loss, so the map carries no risk: only '
           'obstacles and lengths decide the routes. In mode trinary a map has no grades of risk; '
           'use mode scale or raw, or make a risk map with ambush risk')


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """Values (H, W) with row 0 the lowest, cell size [m] and origin (x, y, yaw) [m, m, rad].

    ``crs`` is the coordinate system of world positions, None if unknown; ``losses`` are those of
    the values 0 and 100.
    """

    values: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crs: str | None = None
    losses: tuple[float, float] = LOSSES

    def risk_map(self, options: OccupancyOptions | None = None) -> RiskMap:
        """Convert the values to losses; raises InvalidRiskMap, also if ``crs`` is another one.

        The losses of the options hold if they are not the default ones.
        """
        options = options or OccupancyOptions()
        if (options.alpha_min, options.alpha_max) == LOSSES:
            least, most = self.losses
            options = replace(options, alpha_min=least, alpha_max=most)
        options = replace(options, crs=agreed_crs(self.crs, options.crs))
        return risk_from_occupancy(self.values, self.resolution, self.origin, options)


def agreed_crs(known: str | None, given: str | None) -> str | None:
    """Return the coordinate system of a file, or the given one if it has none; None if unknown.

    Raises InvalidRiskMap if both are known and differ.
    """
    if known and given and not agree(known, given):
        raise InvalidRiskMap(f'the file is in {known}, not in {given}; leave out --crs')
    return known or given or None


@dataclass(frozen=True, kw_only=True)
class OccupancyOptions:
    """Conversion of the values of an occupancy grid to losses.

    A value v in 0..100 gives alpha = alpha_min + (alpha_max - alpha_min) * v / 100. Values of at
    least ``obstacle_threshold`` are obstacles. Unknown cells (-1) have the loss ``unknown_alpha``;
    None: they are obstacles. ``crs`` is the coordinate system of maps that have none; None:
    unknown.

    Raises InvalidOption if a number is not finite or out of range.
    """

    alpha_min: float = allowed(LOSSES[0], least=MIN_LOSS, high=MAX_LOSS)
    alpha_max: float = allowed(LOSSES[1], least=MIN_LOSS, high=MAX_LOSS)
    obstacle_threshold: int = allowed(OBSTACLE, low=1, high=OBSTACLE + 1)
    unknown_alpha: float | None = allowed(None, float, least=MIN_LOSS, high=MAX_LOSS,
                                          automatic=-1.0)
    crs: str | None = allowed(None, str, automatic='')

    def __post_init__(self) -> None:
        check_options(self)
        if self.alpha_min > self.alpha_max:
            raise InvalidOption('alpha_min <= alpha_max must hold, got alpha_min '
                                f'{self.alpha_min} and alpha_max {self.alpha_max}')


def risk_from_occupancy(values: npt.ArrayLike, resolution: float,
                            origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
                            options: OccupancyOptions | None = None) -> RiskMap:
    """Convert an occupancy grid to a risk map.

    Parameters
    ----------
    values : (H, W)
        -1 (unknown) or 0..100, row 0 the lowest, as in nav_msgs/OccupancyGrid.
    resolution
        Cell size [m].
    origin
        World pose (x, y, yaw) of the lower left corner [m, m, rad].
    options
        What values mean.

    Raises
    ------
    InvalidRiskMap
        A value is outside -1..100, or the map is malformed.

    Examples
    --------
    >>> from ambush_planner import risk_from_occupancy
    >>> risk_map = risk_from_occupancy([[0, 50], [100, -1]], resolution=0.5)
    >>> risk_map.alpha[0].tolist(), risk_map.obstacles[1].tolist()
    ([1.0, 5.5], [True, True])
    """
    options = options or OccupancyOptions()
    grid = np.asarray(values)
    check_occupancy(grid, resolution, origin)
    unknown = grid == -1
    if np.issubdtype(grid.dtype, np.integer) and grid.ndim == 2:
        losses = _losses(np.append(np.arange(OBSTACLE + 1), UNKNOWN), options)  # the last at -1
        levels, grade = np.unique(losses, return_inverse=True)
        alpha: Any = GradedLosses(levels, grade.astype(np.uint8)[grid])
    else:
        alpha = _losses(grid, options)
    return RiskMap(alpha, obstacles_in(grid, options), resolution, origin, options.crs,
                   unknown if options.unknown_alpha is None and unknown.any() else None)


def _losses(values: npt.NDArray[Any], options: OccupancyOptions) -> FloatArray:
    """The losses of values of an occupancy grid."""
    unknown, span = values == UNKNOWN, options.alpha_max - options.alpha_min
    alpha = options.alpha_min + span * np.where(unknown, 0, values) / 100.0
    if options.unknown_alpha is not None:
        alpha = np.where(unknown, options.unknown_alpha, alpha)
    return np.asarray(alpha)


def obstacles_in(values: npt.NDArray[Any], options: OccupancyOptions) -> BoolArray:
    """Return which values of an occupancy grid are obstacles."""
    unknown = (values == -1) & (options.unknown_alpha is None)
    return np.asarray((values >= options.obstacle_threshold) | unknown)


def carries_risk(values: npt.NDArray[np.number[Any]], options: OccupancyOptions) -> bool:
    """Return whether the free cells of an occupancy grid differ in their loss, as they should.

    True also if the options give all of them the same loss.
    """
    if options.alpha_min == options.alpha_max:
        return True
    free = values[(values >= 0) & (values < options.obstacle_threshold)]
    return free.size == 0 or bool(np.ptp(free) > 0)


def check_occupancy(values: npt.NDArray[np.number[Any]], resolution: float,
                    origin: tuple[float, float, float]) -> None:
    """Check an occupancy grid without the far slower conversion to a risk map.

    Raises InvalidRiskMap if a value is outside -1..100, or the map is malformed.
    """
    check_place(resolution, origin)
    bad = ~((values >= -1) & (values <= 100))  # NaN too
    if bad.any():
        where = tuple(int(k) for k in np.argwhere(bad)[0])
        raise InvalidRiskMap(
            f'cell values must be in -1..100, got {values[where]} at (row, column) {where} '
            f'({int(bad.sum())} such cells)'
        )
