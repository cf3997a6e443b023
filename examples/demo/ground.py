# SPDX-License-Identifier: Apache-2.0
"""The demo's terrain: the Jacksboro fault, Tennessee and Kentucky, as a risk map.

The elevations are ``jacksboro_fault_dem.npz`` of matplotlib's sample data: 344 x 403 heights on a
grid of 1/1200 degree, northernmost row first, 74.4 m from west to east and 92.7 m from south to
north. They are resampled to cells of 90 m: 354 x 333 cells, 31.9 km x 30.0 km. The weapon range is
500 m (a rifle). 8 % of the cells are too steep: the flanks of the ridges, with openings at streams.
"""

from __future__ import annotations

import math

import numpy as np
from matplotlib.cbook import get_sample_data

from ambush_planner.maps import (
    Elevation,
    OccupancyMap,
    Raster,
    TerrainOptions,
    ViewOptions,
    elevation_from_raster,
    terrain_map,
)

ELEVATION = 'jacksboro_fault_dem.npz'
RESOLUTION = 90.0
# Length of one degree of latitude on a sphere with the Earth's mean radius [m].
METRES_PER_DEGREE = 111_195.0
OPTIONS = TerrainOptions(view=ViewOptions(weapon_range=500.0))
# Centres of free cells, (x, y) [m] from the map's south-west corner.
START = (2025.0, 12015.0)
GOAL = (26055.0, 27945.0)


def load_ground() -> OccupancyMap:
    """Make the map of the risk; raises OSError without matplotlib's sample data."""
    return terrain_map(load_elevation(), OPTIONS)


def load_elevation() -> Elevation:
    """Load the heights; raises OSError without matplotlib's sample data."""
    with np.load(get_sample_data(ELEVATION, asfileobj=False)) as file:
        sample = dict(file)
    # ymin and ymax are swapped in the file; their mean is correct.
    latitude = float(sample['ymin'] + sample['ymax']) / 2
    # Over 0.3 degrees of latitude, one scale is off by at most 0.2 %.
    scale = METRES_PER_DEGREE * math.cos(math.radians(latitude))
    steps = METRES_PER_DEGREE * float(sample['dy']), scale * float(sample['dx'])
    heights = np.asarray(sample['elevation'], dtype=np.float64)[::-1]
    return elevation_from_raster(Raster(heights, *steps), RESOLUTION)
