# SPDX-License-Identifier: Apache-2.0
"""From the file of an elevation model to a risk map, in one step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .elevation import elevation_from_raster, mask_from_raster
from .elevation_file import read_raster
from .occupancy import OccupancyMap, OccupancyOptions
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
        How terrain is converted to risk.
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
    elevation = elevation_from_raster(read_raster(Path(file), crs=crs), resolution or 0.0)
    mask = mask_from_raster(read_raster(Path(roads), 'roads'), elevation) if roads else None
    return terrain_map(elevation, options, mask, progress)
