# SPDX-License-Identifier: Apache-2.0
"""Risk maps of files of elevation models, in one step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import warn
from .elevation import elevation_from_raster, mask_from_raster
from .elevation_file import read_raster
from .occupancy import OccupancyMap, OccupancyOptions
from .relief import barriers
from .risk_map import RiskMap
from .terrain_risk import TerrainOptions, terrain_map
from .visibility import ViewOptions


def risk_from_terrain(file: Path | str, *, resolution: float | None = None,
                      weapon_range: float = 300.0, roads: Path | str | None = None,
                      options: TerrainOptions | None = None,
                      occupancy: OccupancyOptions | None = None) -> RiskMap:
    """Make the risk map of an elevation model, as ``ambush risk`` does.

    Parameters
    ----------
    file
        A GeoTIFF (extra ``gis``) or an npz file.
    resolution
        Cell size [m]; None: the elevation model's.
    weapon_range
        Range of weapons [m]; ``options``, if given, has its own.
    roads
        A raster of roads: its cells other than 0.
    options
        Conversion of terrain to risk.
    occupancy
        How risk 0..99 is converted to losses.

    Returns
    -------
    RiskMap
        With the coordinate system of the elevation model.

    Raises
    ------
    InvalidTerrain, OSError
        A file or an option cannot be used.

    Examples
    --------
    >>> risk_map = risk_from_terrain('dem.tif', weapon_range=500.0)  # doctest: +SKIP
    """
    options = options or TerrainOptions(view=ViewOptions(weapon_range=weapon_range))
    return terrain_of_file(file, options, resolution, roads).risk_map(occupancy)


def terrain_of_file(file: Path | str, options: TerrainOptions, resolution: float | None = None,
                    roads: Path | str | None = None, crs: str | None = None,
                    progress: Callable[[float], None] | None = None) -> OccupancyMap:
    """Make the map of an elevation model, whose system is ``crs`` if the file has none."""
    raster = read_raster(Path(file), crs=crs)
    elevation = elevation_from_raster(raster, resolution or 0.0)
    mask = mask_from_raster(read_raster(Path(roads), 'roads', crs), elevation) if roads else None
    crossed = barriers(raster, elevation, options.slope_limit)
    if share := float(np.mean(crossed & ~np.isnan(elevation.heights))):
        warn(f'{file}: {100.0 * share:.2g} % of the cells of {elevation.resolution:g} m cannot be '
             'crossed, because of narrower ground that is too steep or unknown in the cells of the '
             'file; they are obstacles, except on roads')
    return terrain_map(elevation, options, mask, progress, crossed)
