# SPDX-License-Identifier: Apache-2.0
"""Elevation grids, and resampling of rasters to their square cells."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from ..arrays import BoolArray, FloatArray, frozen_array
from ..errors import AmbushPlannerError
from .risk_map import LOSSES

HeightArray = npt.NDArray[np.float32]

# Maximum size of a grid [cells]; a larger one would not fit in memory: a wrong resolution?
MAX_CELLS = 100_000_000
# Minimum interpolation weight; smaller ones are rounding of a sample's position.
_MIN_WEIGHT = 1e-6


class InvalidTerrain(AmbushPlannerError, ValueError):
    """An elevation model, a road mask or a map file is malformed."""


@dataclass(frozen=True, eq=False)
class Elevation:
    """Terrain heights on square cells.

    Parameters
    ----------
    heights : (H, W) float
        Height at the centre of each cell [m], row 0 in the south; NaN if unknown.
    resolution : float
        Cell size [m].
    corner : (x, y)
        World position of the lower left corner [m].
    crs : str or None
        Coordinate system of world positions; None if unknown.

    Raises InvalidTerrain if the shape or the resolution is invalid, or no height is known.
    """

    heights: HeightArray
    resolution: float
    corner: tuple[float, float] = (0.0, 0.0)
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
    corner [m], in the coordinate system ``crs``. ``heights`` (H, W) are those of a risk map whose
    file has them, too, and ``losses`` those of its values 0 and 100.
    """

    values: FloatArray
    row_step: float
    column_step: float
    corner: tuple[float, float] = (0.0, 0.0)
    crs: str | None = None
    heights: HeightArray | None = None
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
    if raster.row_step == raster.column_step == resolution:
        return Elevation(raster.values.astype(np.float32), resolution, raster.corner, raster.crs)
    # The odd reflection extrapolates linearly by one cell.
    values = np.pad(raster.values, 1, 'reflect', reflect_type='odd')
    positions = np.meshgrid(row + 1.0, column + 1.0, indexing='ij')
    unknown = np.isnan(values)
    heights = map_coordinates(np.where(unknown, 0.0, values), positions, order=1, mode='nearest',
                              output=np.float32)
    if unknown.any():
        share = map_coordinates(unknown.astype(np.float32), positions, order=1, mode='nearest')
        heights[share > _MIN_WEIGHT] = np.nan
    return Elevation(heights, resolution, raster.corner, raster.crs)


def mask_from_raster(raster: Raster, elevation: Elevation) -> BoolArray:
    """Resample a mask (nonzero means set) to the cells of ``elevation`` (H, W).

    A cell is set if the mask is set at its centre, or if it contains the centre of a set mask cell,
    so that thin roads survive on coarser cells.

    Raises InvalidTerrain if the mask does not cover the same area.
    """
    shape, resolution = elevation.heights.shape, elevation.resolution
    row, column = _positions(raster, resolution)
    if (len(row), len(column)) != shape:
        raise InvalidTerrain(
            f'the roads cover {len(row)} x {len(column)} cells of {resolution:g} m, the elevation '
            f'{shape[0]} x {shape[1]}; both files must cover the same area'
        )
    apart = math.dist(raster.corner, elevation.corner)
    if raster.crs and elevation.crs and (
            raster.crs != elevation.crs or apart > 2.0 * max(raster.row_step, resolution)):
        raise InvalidTerrain(f'the roads begin at {raster.corner} ({raster.crs}), the elevation at '
                             f'{elevation.corner} ({elevation.crs}); both files must cover the '
                             'same area')
    marked = np.nan_to_num(raster.values) != 0.0
    mask = nearest_cells(marked, row, column)
    rows, columns = np.nonzero(marked)
    rows = ((rows + 0.5) * raster.row_step / resolution).astype(np.int64)
    columns = ((columns + 0.5) * raster.column_step / resolution).astype(np.int64)
    inside = (rows < shape[0]) & (columns < shape[1])
    mask[rows[inside], columns[inside]] = True
    return mask


def square_cells(raster: Raster) -> Raster:
    """The same values on square cells of the shorter step, by nearest cells."""
    step = min(raster.row_step, raster.column_step)
    row, column = _positions(raster, step)
    heights = raster.heights
    return replace(raster, values=nearest_cells(raster.values, row, column), row_step=step,
                   column_step=step,
                   heights=None if heights is None else nearest_cells(heights, row, column))


def nearest_cells(values: npt.NDArray[Any], row: FloatArray,
                  column: FloatArray) -> npt.NDArray[Any]:
    """The values at rows and columns that need not be whole."""
    return values[np.ix_(*(np.clip(np.rint(index).astype(np.int64), 0, count - 1)
                           for index, count in zip((row, column), values.shape, strict=True)))]


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
