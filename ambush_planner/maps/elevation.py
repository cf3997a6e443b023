# SPDX-License-Identifier: Apache-2.0
"""Elevation grids, and resampling of rasters to their square cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, frozen_array
from ..errors import AmbushPlannerError
from .risk_map import LOSSES

HeightArray = npt.NDArray[np.float32]

# Maximum size of a grid [cells]; a larger one would not fit in memory: a wrong resolution?
MAX_CELLS = 100_000_000
# Minimum interpolation weight; smaller ones are rounding of a sample's position.
_MIN_WEIGHT = 1e-6


class InvalidTerrain(AmbushPlannerError, ValueError):
    """An elevation model or a map file is malformed."""


@dataclass(frozen=True, eq=False)
class Elevation:
    """Terrain heights on square cells.

    Parameters
    ----------
    heights : (H, W) float
        Height at the centre of each cell [m], row 0 in the south; NaN if unknown.
    resolution : float
        Cell size [m].
    corner : (x, y) or None
        World position of the lower left corner [m]; None if unknown.
    crs : str or None
        Coordinate system of world positions; None if unknown.

    Raises InvalidTerrain if the shape or the resolution is invalid, or no height is known.
    """

    heights: HeightArray
    resolution: float
    corner: tuple[float, float] | None = None
    crs: str | None = None

    def __post_init__(self) -> None:
        heights = frozen_array(self.heights, np.float32)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InvalidTerrain(
                f'elevation must have at least 2 x 2 cells, got shape {heights.shape}'
            )
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidTerrain(f'resolution must be positive [m], got {self.resolution}')
        if np.isinf(heights).any():
            raise InvalidTerrain('elevation must be finite, or NaN if unknown')
        if np.isnan(heights).all():
            raise InvalidTerrain('no elevation is known: every cell is NaN or nodata')
        object.__setattr__(self, 'heights', heights)
        object.__setattr__(self, 'resolution', float(self.resolution))


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster as read from a file.

    ``values`` (H, W) has row 0 in the south; ``row_step`` and ``column_step`` [m] are the cell size
    from south to north and from west to east. ``corner`` is the world position of the lower left
    corner [m], in the coordinate system ``crs``; None if unknown. ``losses`` are those of the
    values 0 and 100 of a risk map.
    """

    values: npt.NDArray[Any]
    row_step: float
    column_step: float
    corner: tuple[float, float] | None = None
    crs: str | None = None
    losses: tuple[float, float] = LOSSES


def elevation_from_raster(raster: Raster, resolution: float = 0.0) -> Elevation:
    """Resample heights to square cells of ``resolution`` [m]; 0: the raster's shorter step.

    Interpolates bilinearly between cell centres and extrapolates linearly beyond the outermost
    ones, so that planes keep their slope up to the border. Both grids share the lower left corner,
    and only whole cells are kept. A cell is unknown if any height it is computed from is unknown.

    Raises InvalidTerrain if the resolution leaves fewer than 2 x 2 cells or more than
    ``MAX_CELLS``.
    """
    resolution = resolution or min(raster.row_step, raster.column_step)
    row, column = _positions(raster, resolution)
    heights = raster.values
    if not raster.row_step == raster.column_step == resolution:
        heights = _interpolated(_interpolated(heights, row).T, column).T
    return Elevation(heights, resolution, raster.corner, raster.crs)


def _interpolated(values: npt.NDArray[Any], row: FloatArray) -> npt.NDArray[Any]:
    """Rows of values (H, W) at places that need not be whole: linear, also beyond the ends."""
    first = np.clip(np.floor(row + _MIN_WEIGHT), 0, len(values) - 2).astype(np.int64)
    share = (row - first).astype(np.float32)[:, None]
    low, high = values[first], values[first + 1]
    # The unknown neighbour of a known height that a place coincides with does not count.
    between = np.where(np.abs(share) <= _MIN_WEIGHT, low, low + share * (high - low))
    return np.where(np.abs(share - 1.0) <= _MIN_WEIGHT, high, between)


def _positions(raster: Raster, resolution: float) -> tuple[FloatArray, FloatArray]:
    """Row and column coordinates of the centres of square cells, in raster cells."""
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise InvalidTerrain(f'resolution must be positive [m], got {resolution}')
    steps = (raster.row_step, raster.column_step)
    # The tolerance keeps a last cell that rounding makes a hair short.
    counts = [int(count * step / resolution + 1e-6)
              for count, step in zip(raster.values.shape, steps, strict=True)]
    if min(counts) < 2 or counts[0] * counts[1] > MAX_CELLS:
        raise InvalidTerrain(
            f'a resolution of {resolution:g} m gives {counts[0]} x {counts[1]} cells; the grid '
            f'must have at least 2 x 2 and at most {MAX_CELLS} cells'
        )
    row, column = (np.asarray((np.arange(count) + 0.5) * resolution / step - 0.5, dtype=np.float64)
                   for count, step in zip(counts, steps, strict=True))
    return row, column
