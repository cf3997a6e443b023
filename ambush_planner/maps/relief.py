# SPDX-License-Identifier: Apache-2.0
"""Slope of the terrain, and depth of each cell below the terrain around it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, maximum_filter1d

from .elevation import Elevation, HeightArray

# Maximum number of rectangles that approximate a disc.
MAX_RECTANGLES = 16


def slope(elevation: Elevation) -> HeightArray:
    """Rise over run of each cell (H, W): 0.42 is 42 %, or 23 degrees; NaN if unknown.

    The norm of the gradient by central differences, one-sided at the border: exact on planes and,
    off the border, on quadratic surfaces. Unknown neighbours take the nearest known height.

    Source: L. W. Zevenbergen, C. R. Thorne, *Quantitative analysis of land surface topography*,
    Earth Surface Processes and Landforms 12, 1987.
    """
    along_rows, along_columns = np.gradient(_filled(elevation.heights), elevation.resolution)
    steepness = np.hypot(along_rows, along_columns)
    return np.where(np.isnan(elevation.heights), np.nan, steepness).astype(np.float32)


def relative_depth(elevation: Elevation, radius: float) -> HeightArray:
    """Height of the highest known terrain within ``radius`` [m] above each cell (H, W) [m], >= 0.

    0 on crests and plains, large in gorges; NaN if the cell's height is unknown. Distances are
    between cell centres. Discs of more than ``MAX_RECTANGLES`` rows are approximated from inside by
    rectangles, to at least 95 % of the radius in each direction.
    """
    known = np.where(np.isnan(elevation.heights), -np.inf, elevation.heights)
    highest = known.copy()
    for rows, columns in disc_rectangles(radius / elevation.resolution):
        window = maximum_filter1d(known, 2 * columns + 1, axis=1, mode='constant', cval=-np.inf)
        window = maximum_filter1d(window, 2 * rows + 1, axis=0, mode='constant', cval=-np.inf)
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


def _filled(heights: HeightArray) -> npt.NDArray[np.float32]:
    """Replace unknown heights by those of the nearest known cells."""
    unknown = np.isnan(heights)
    if not unknown.any():
        return heights
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]
