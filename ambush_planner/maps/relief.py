# SPDX-License-Identifier: Apache-2.0
"""Slope of the terrain, barriers in it, and depth of each cell below the terrain around it."""

from __future__ import annotations

import math

import numpy as np
import scipy  # loads ndimage when it is used

from ..arrays import BoolArray, IndexArray
from .elevation import Elevation, HeightArray, Raster

# Maximum number of rectangles that approximate a disc.
MAX_RECTANGLES = 16
# Rows of a raster whose slope is computed at a time; bounds the memory.
ROWS = 512


def slope(elevation: Elevation) -> HeightArray:
    """Rise over run of each cell (H, W): 0.42 is 42 %, or 23 degrees; NaN if unknown.

    The norm of the gradient by central differences, one-sided at the border: exact on planes and,
    off the border, on quadratic surfaces. Unknown neighbours take the nearest known height.

    Source: L. W. Zevenbergen, C. R. Thorne, *Quantitative analysis of land surface topography*,
    Earth Surface Processes and Landforms 12, 1987.
    """
    heights, unknown = elevation.heights, np.isnan(elevation.heights)
    if unknown.any():
        heights = heights[tuple(scipy.ndimage.distance_transform_edt(
            unknown, return_distances=False, return_indices=True))]
    steepness = np.hypot(*np.gradient(heights, elevation.resolution))
    return np.where(unknown, np.nan, steepness).astype(np.float32)


def barriers(raster: Raster, elevation: Elevation, slope_limit: float) -> BoolArray:
    """Cells (H, W) of an elevation that cannot be crossed in the finer cells of its raster.

    Without them, each way from cell to cell is one in the raster, too: the largest connected part
    of a cell's ground that is known and not too steep meets that of the next cell. Interpolated
    heights miss ravines, dikes and walls that are narrower than a cell.
    """
    shape, resolution = elevation.heights.shape, elevation.resolution
    steps = raster.row_step, raster.column_step
    if resolution <= max(steps) * (1.0 + 1e-6):
        return np.zeros(shape, bool)
    # Which row and column of the elevation contain the centre of each of the raster's.
    row, column = (((np.arange(count) + 0.5) * step / resolution).astype(np.int64)
                   for count, step in zip(raster.values.shape, steps, strict=True))
    row, column = row[row < shape[0]], column[column < shape[1]]
    passable = np.empty((len(row), len(column)), bool)
    for begin in range(0, len(row), ROWS):
        around = raster.values[max(begin - 1, 0): begin + ROWS + 1]
        steepness = np.hypot(*np.gradient(around, *steps))[begin - max(begin - 1, 0):]
        part = passable[begin: begin + ROWS]
        part[:] = steepness[: len(part), : len(column)] <= slope_limit
    return _uncrossed(passable, row, column)


def _uncrossed(passable: BoolArray, row: IndexArray, column: IndexArray) -> BoolArray:
    """The cells (H, W) without a way through their passable cells (h, w), as in ``barriers``.

    ``row`` (h,) and ``column`` (w,) are those of the cells that the passable ones are in.
    """
    (top, bottom), (left, right) = (
        (np.flatnonzero(np.diff(each, prepend=-1)), np.flatnonzero(np.diff(each, append=-1)))
        for each in (row, column))
    shape = len(top), len(left)
    # A blank row and column between two cells keeps their parts apart.
    spread = np.ix_(np.arange(len(row)) + row, np.arange(len(column)) + column)
    apart = np.zeros((len(row) + shape[0], len(column) + shape[1]), bool)
    apart[spread] = passable
    part, count = scipy.ndimage.label(apart)
    owner = np.zeros(count + 1, np.int64)
    every_row, every_column = np.arange(len(row)), np.arange(len(column))
    for rows, columns in ((top, every_column), (bottom, every_column), (every_row, left),
                          (every_row, right)):
        here = part[np.ix_(rows + row[rows], columns + column[columns])]
        owner[here] = 1 + row[rows, None] * shape[1] + column[columns]
    owner[0] = 0
    # The largest part of each cell among those that reach its sides; 0: none.
    extent = np.sum([np.bincount(part[k: k + ROWS].ravel(), minlength=count + 1)
                     for k in range(0, len(part), ROWS)], axis=0)
    order, largest = np.argsort(extent, kind='stable'), np.zeros(shape[0] * shape[1] + 1, np.int64)
    largest[owner[order]] = order
    is_largest = np.zeros(count + 1, bool)
    is_largest[largest[1:]], is_largest[0] = True, False
    passable = is_largest[part][spread]
    largest = largest[1:].reshape(shape)
    found, sizes = largest == 0, extent[largest]
    # Of two cells whose common side cannot be crossed, the one with the smaller part.
    up = np.logical_or.reduceat(passable[bottom[:-1]] & passable[top[1:]], left, axis=1)
    aside = np.logical_or.reduceat(passable[:, right[:-1]] & passable[:, left[1:]], top, axis=0)
    for crossed, cells, size in ((up, found, sizes), (aside.T, found.T, sizes.T)):
        shut, less = ~(crossed | cells[:-1] | cells[1:]), size[:-1] < size[1:]
        cells[:-1] |= shut & less
        cells[1:] |= shut & ~less
    return found


def relative_depth(elevation: Elevation, radius: float) -> HeightArray:
    """Height of the highest known terrain within ``radius`` [m] above each cell (H, W) [m], >= 0.

    0 on crests and plains, large in gorges; NaN if the cell's height is unknown. Distances are
    between cell centres. Discs of more than ``MAX_RECTANGLES`` rows are approximated from inside by
    rectangles, to at least 95 % of the radius in each direction.
    """
    known = np.where(np.isnan(elevation.heights), -np.inf, elevation.heights)
    highest = known.copy()
    for rows, columns in disc_rectangles(radius / elevation.resolution):
        window = known
        for axis, size in enumerate((rows, columns)):
            window = scipy.ndimage.maximum_filter1d(window, 2 * size + 1, axis, mode='constant',
                                                    cval=-np.inf)
        np.maximum(highest, window, out=highest)
    return (highest - elevation.heights).astype(np.float32)


def disc_rectangles(radius: float) -> list[tuple[int, int]]:
    """Half sizes (rows, columns) of centred rectangles whose union is a disc [cells]."""
    reach = math.floor(radius)
    if reach < MAX_RECTANGLES:
        rows = np.arange(reach + 1)
    else:
        angles = np.linspace(0.0, math.pi / 2.0, MAX_RECTANGLES + 1)
        rows = np.unique(np.floor(radius * np.sin(angles)).astype(np.int64))
    columns = np.floor(np.sqrt(radius**2 - rows**2)).astype(np.int64)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
