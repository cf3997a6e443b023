"""Real ground to plan on: the Jacksboro fault, Tennessee and Kentucky, as an occupancy grid.

The elevations are those of ``jacksboro_fault_dem.npz``, which ships with matplotlib's sample data:
344 x 403 heights on a grid of 1/1200 degree, northernmost row first, 74.4 m from west to east and
92.7 m from south to north. They are resampled bilinearly to squares of ``RESOLUTION`` = 90 m, row 0
in the south: 354 x 333 cells, 31.9 km x 30.0 km. For a cell of height h [m]:

* Slope: the length of the gradient of h by central differences, so over 180 m. Where it is over
  ``SLOPE_LIMIT`` = 0.42 (23 degrees) the cell is an obstacle, value 100. Off-road trucks are built
  to climb about 0.60 on firm, even ground; 30 % is taken off for soil, load and the steeper pitches
  that an average over 180 m hides. 8 % of the cells are steeper: the flanks of the ridges, with
  gaps where streams cut through. (0.30 would close 32 %, 0.50 only 1 %.)
* Risk: being overlooked makes an ambush costly. With d = (highest h within ``VIEW_RADIUS`` = 500 m,
  about the range of a rifle) - h, the value is round(99 min(d / ``FULL_RISK_DEPTH``, 1)): 0 on
  crests and open plains, 99 at ``FULL_RISK_DEPTH`` = 200 m and more below the surroundings.

The planner's default reads value v as a loss of 1 + 9 v / 100 for an ambush there.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from matplotlib.cbook import get_sample_data
from scipy.ndimage import map_coordinates, maximum_filter

FloatArray = npt.NDArray[np.float64]

RESOLUTION = 90.0
SLOPE_LIMIT = 0.42
VIEW_RADIUS = 500.0
FULL_RISK_DEPTH = 200.0
OBSTACLE = 100
METRES_PER_DEGREE = 111_200.0

# Centres of free cells, (x, y) [m] from the map's south-west corner.
START = (2025.0, 12015.0)
GOAL = (26055.0, 27945.0)


def load_occupancy() -> npt.NDArray[np.int8]:
    """Occupancy grid (H, W) of the real ground, row 0 in the south, cells of ``RESOLUTION``.

    Raises
    ------
    OSError
        matplotlib's sample data are not installed.
    """
    return occupancy_values(load_elevation(RESOLUTION), RESOLUTION)


def load_elevation(resolution: float) -> FloatArray:
    """Elevation (H, W) [m] on square cells of ``resolution`` [m], row 0 in the south."""
    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as file:
        sample = dict(file)
    # The file calls its first row's latitude ymin although it is the northern one.
    north_up = np.asarray(sample["elevation"], dtype=np.float64)
    latitude = math.radians(float(sample["ymin"] + sample["ymax"]) / 2)
    row_step = METRES_PER_DEGREE * float(sample["dy"])
    column_step = METRES_PER_DEGREE * float(sample["dx"]) * math.cos(latitude)
    return resample(north_up[::-1], row_step, column_step, resolution)


def resample(
    heights: FloatArray, row_step: float, column_step: float, resolution: float
) -> FloatArray:
    """Bring a grid of cells ``row_step`` x ``column_step`` [m] to square cells, bilinearly.

    Both grids share the lower left corner; the result has as many whole cells as fit.
    """
    rows = int(heights.shape[0] * row_step / resolution)
    columns = int(heights.shape[1] * column_step / resolution)
    row = (np.arange(rows) + 0.5) * resolution / row_step - 0.5
    column = (np.arange(columns) + 0.5) * resolution / column_step - 0.5
    where = np.meshgrid(row, column, indexing="ij")
    return map_coordinates(heights, where, order=1, mode="nearest", output=np.float64)


def occupancy_values(elevation: FloatArray, resolution: float) -> npt.NDArray[np.int8]:
    """Values 0..99 by risk, 100 for obstacles, by the formulas at the top of this file."""
    risk = 99.0 * np.minimum(overlooked_depth(elevation, resolution) / FULL_RISK_DEPTH, 1.0)
    too_steep = slope(elevation, resolution) > SLOPE_LIMIT
    return np.where(too_steep, OBSTACLE, np.rint(risk)).astype(np.int8)


def slope(elevation: FloatArray, resolution: float) -> FloatArray:
    """Rise over run of each cell (H, W), by central differences."""
    along_rows, along_columns = np.gradient(elevation, resolution)
    return np.hypot(along_rows, along_columns)


def overlooked_depth(elevation: FloatArray, resolution: float) -> FloatArray:
    """How far the highest ground within ``VIEW_RADIUS`` lies above each cell (H, W) [m], >= 0."""
    reach = int(VIEW_RADIUS // resolution)
    offset = np.arange(-reach, reach + 1) * resolution
    disc = np.hypot(offset[:, None], offset[None, :]) <= VIEW_RADIUS
    return maximum_filter(elevation, footprint=disc, mode="nearest") - elevation
