"""Slope, and how deep a place lies below the ground around it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, maximum_filter1d

from .elevation import Elevation, HeightArray

# A disc of more rows than this is covered by as many rectangles as this.
MOST_RECTANGLES = 16


def slope(elevation: Elevation) -> HeightArray:
    """Rise over run of each cell (H, W): 0.42 is 42 %, or 23 degrees.

    The length of the gradient by central differences, so over two cells; at the border by
    one-sided ones. Exact on planes, and inside on surfaces of second degree. Beside unknown ground
    the nearest known height stands for what is missing; NaN where the height is not known.

    Source: L. W. Zevenbergen, C. R. Thorne, *Quantitative analysis of land surface topography*,
    Earth Surface Processes and Landforms 12, 1987.
    """
    along_rows, along_columns = np.gradient(_filled(elevation.heights), elevation.resolution)
    steepness = np.hypot(along_rows, along_columns)
    return np.where(np.isnan(elevation.heights), np.nan, steepness).astype(np.float32)


def relative_depth(elevation: Elevation, radius: float) -> HeightArray:
    """How far the highest ground within ``radius`` [m] lies above each cell (H, W) [m], >= 0.

    0 on crests and plains, large in gorges: whoever holds that ground fires down. The distance is
    that of cells' centres; discs of more than ``MOST_RECTANGLES`` rows are covered from inside
    by rectangles, to at least 95 % of the radius in each direction. NaN where the height is not
    known; unknown ground around does not count.
    """
    known = np.where(np.isnan(elevation.heights), -np.inf, elevation.heights)
    highest = known.copy()
    for rows, columns in disc_rectangles(radius / elevation.resolution):
        window = maximum_filter1d(known, 2 * columns + 1, axis=1, mode='constant', cval=-np.inf)
        window = maximum_filter1d(window, 2 * rows + 1, axis=0, mode='constant', cval=-np.inf)
        np.maximum(highest, window, out=highest)
    return (highest - elevation.heights).astype(np.float32)


def disc_rectangles(radius: float) -> list[tuple[int, int]]:
    """Half sizes (rows, columns) of centred rectangles whose union is a disc; all in cells."""
    reach = math.floor(radius)
    if reach < MOST_RECTANGLES:
        rows = np.arange(reach + 1)
    else:
        angles = np.linspace(0.0, math.pi / 2.0, MOST_RECTANGLES + 1)
        rows = np.unique(np.floor(radius * np.sin(angles)).astype(np.int64))
    columns = np.floor(np.sqrt(radius**2 - rows**2)).astype(np.int64)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _filled(heights: HeightArray) -> npt.NDArray[np.float32]:
    """Heights with those of the nearest known cells where they are not known."""
    unknown = np.isnan(heights)
    if not unknown.any():
        return heights
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]
