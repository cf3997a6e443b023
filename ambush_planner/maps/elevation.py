"""The ground as a grid of heights, and how a raster comes to be one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from ..arrays import frozen_array
from ..errors import AmbushPlannerError

HeightArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

# A grid of more cells is a mistake in its resolution, and would not fit in memory.
MAX_CELLS = 100_000_000


class InvalidTerrain(AmbushPlannerError, ValueError):
    """An elevation model, a mask of roads or a map file is not what it should be."""


@dataclass(frozen=True, eq=False)
class Elevation:
    """Heights of the ground on square cells.

    Parameters
    ----------
    heights : (H, W) float
        Height at the centre of each cell [m], row 0 in the south; NaN where it is not known.
    resolution : float
        Edge of a cell [m].
    place : str
        Where the lower left corner lies in the world, for people.

    Raises
    ------
    InvalidTerrain
        The shape or the resolution is not as above, or no height is known.
    """

    heights: HeightArray
    resolution: float
    place: str = ''

    def __post_init__(self) -> None:
        heights = frozen_array(self.heights, np.float32)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InvalidTerrain(
                f'elevation must have at least 2 x 2 cells, got shape {heights.shape}'
            )
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidTerrain(f'resolution must be positive [m], got {self.resolution}')
        if np.isinf(heights).any():
            raise InvalidTerrain('elevation must be finite, or NaN where it is not known')
        if np.isnan(heights).all():
            raise InvalidTerrain('elevation is known nowhere: each cell is NaN or nodata')
        object.__setattr__(self, 'heights', heights)
        object.__setattr__(self, 'resolution', float(self.resolution))


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster as it comes out of a file.

    ``values`` (H, W), row 0 in the south; ``row_step`` and ``column_step`` [m] are the cells' size
    from south to north and from west to east.
    """

    values: npt.NDArray[np.float64]
    row_step: float
    column_step: float
    place: str = ''


def elevation_from(raster: Raster, resolution: float = 0.0) -> Elevation:
    """Bring heights to square cells of ``resolution`` [m]; 0: the raster's shorter step.

    Bilinear between the centres of the raster's cells. Both grids share the lower left corner; the
    result has as many whole cells as fit. A cell is unknown where a height that it follows from is.

    Raises
    ------
    InvalidTerrain
        The resolution leaves fewer than 2 x 2 cells or more than ``MAX_CELLS``.
    """
    resolution = resolution or min(raster.row_step, raster.column_step)
    row, column = _positions(raster, resolution)
    if _is_same_grid(raster, row, column):
        return Elevation(raster.values, resolution, raster.place)
    where = np.meshgrid(row, column, indexing='ij')
    heights = map_coordinates(raster.values, where, order=1, mode='nearest', output=np.float32)
    return Elevation(heights, resolution, raster.place)


def mask_from(raster: Raster, elevation: Elevation) -> BoolArray:
    """Bring a mask (any value but 0) to the cells of ``elevation`` (H, W).

    A cell is in the mask if its centre is, or if it holds the centre of one that is: thin roads
    survive on coarser cells.

    Raises
    ------
    InvalidTerrain
        The mask does not cover the same ground.
    """
    shape, resolution = elevation.heights.shape, elevation.resolution
    row, column = _positions(raster, resolution)
    if (len(row), len(column)) != shape:
        raise InvalidTerrain(
            f'the roads cover {len(row)} x {len(column)} cells of {resolution:g} m, the elevation '
            f'{shape[0]} x {shape[1]}; both files must cover the same ground'
        )
    marked = np.nan_to_num(raster.values) != 0.0
    mask = marked[np.ix_(*(
        np.clip(np.rint(index).astype(np.int64), 0, count - 1)
        for index, count in zip((row, column), marked.shape, strict=True)
    ))]
    rows, columns = np.nonzero(marked)
    rows = ((rows + 0.5) * raster.row_step / resolution).astype(np.int64)
    columns = ((columns + 0.5) * raster.column_step / resolution).astype(np.int64)
    inside = (rows < shape[0]) & (columns < shape[1])
    mask[rows[inside], columns[inside]] = True
    return mask


def _positions(
    raster: Raster, resolution: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Centres of square cells in units of the raster's rows and columns."""
    if not (math.isfinite(resolution) and resolution > 0.0):
        raise InvalidTerrain(f'resolution must be positive [m], got {resolution}')
    steps = (raster.row_step, raster.column_step)
    # A whole number of cells, also where rounding leaves it a hair short.
    counts = [
        int(count * step / resolution + 1e-6)
        for count, step in zip(raster.values.shape, steps, strict=True)
    ]
    if min(counts) < 2 or counts[0] * counts[1] > MAX_CELLS:
        raise InvalidTerrain(
            f'a resolution of {resolution:g} m gives {counts[0]} x {counts[1]} cells; at least '
            f'2 x 2 and at most {MAX_CELLS} in all are possible'
        )
    row, column = (
        (np.arange(count) + 0.5) * resolution / step - 0.5
        for count, step in zip(counts, steps, strict=True)
    )
    return row, column


def _is_same_grid(raster: Raster, *positions: npt.NDArray[np.float64]) -> bool:
    return all(
        len(index) == count and np.allclose(index, np.arange(count), atol=1e-6)
        for index, count in zip(positions, raster.values.shape, strict=True)
    )
