# SPDX-License-Identifier: Apache-2.0
"""Risk map from terrain.

Four factors, each 0..1, make an ambush in a cell costly:

* depth: relative depth within weapon range, divided by ``FULL_DEPTH`` = 0.4 times the weapon range
  (1 if terrain within 300 m is 120 m higher): the vehicle is fired at from above and cannot leave.
* exposure: share of the terrain within weapon range from which the vehicle is visible.
* approach: 1 - distance to the nearest hidden terrain / weapon range, averaged over all directions:
  an attacker can come that close unseen.
* slope: divided by ``slope_limit``: on steep terrain the vehicle is slow and longer under fire.

The cell value is round(99 * risk), where risk is the weighted mean of the factors. Cells steeper
than ``slope_limit`` are obstacles (100); cells of unknown height are unknown (-1).

Off-road trucks climb slopes of about 0.60 on firm, even ground. The default limit is 30 % lower to
allow for soil, load and steeper spots within a cell. The weights are a judgement, not a
measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..arrays import BoolArray, frozen_array
from ..errors import InvalidOption, warn
from ..option_checks import allowed, check_at_least, check_options
from .elevation import Elevation, elevation_from_raster
from .elevation_file import read_raster
from .occupancy import OBSTACLE, UNKNOWN, OccupancyMap, OccupancyOptions
from .relief import barriers, relative_depth, slope
from .risk_map import RiskMap
from .visibility import ViewOptions, viewshed

FULL_DEPTH = 0.4


@dataclass(frozen=True, kw_only=True)
class TerrainOptions:
    """Options of the conversion of terrain to risk.

    Parameters
    ----------
    view
        Weapon range, heights of vehicle and person.
    slope_limit
        Maximum drivable slope (rise/run).
    weights
        Weights of depth, exposure, approach and slope; only their ratio matters.

    Raises InvalidOption if a number is out of range.
    """

    view: ViewOptions = field(default_factory=ViewOptions)
    slope_limit: float = allowed(0.42, low=1e-3)
    weights: tuple[float, float, float, float] = (0.4, 0.2, 0.2, 0.2)

    def __post_init__(self) -> None:
        check_options(self)
        for weight in self.weights:
            check_at_least('weights', weight, 0.0)
        if len(self.weights) != 4 or not sum(self.weights):
            raise InvalidOption('weights must be four numbers (depth, exposure, approach, slope), '
                                f'not all 0, got {self.weights}')


def terrain_map(elevation: Elevation, options: TerrainOptions | None = None,
                progress: Callable[[float], None] | None = None,
                obstacles: BoolArray | None = None) -> OccupancyMap:
    """Compute the risk of terrain as values of a map; ``obstacles`` (H, W) are further ones.

    ``progress`` is called with the completed share of the work. Raises InvalidTerrain if the
    weapon range is shorter than a cell.
    """
    options = options or TerrainOptions()
    reach, steepness = options.view.weapon_range, slope(elevation)
    depth, views = relative_depth(elevation, reach), viewshed(elevation, options.view, progress)
    shares = (
        np.minimum(depth / (FULL_DEPTH * reach), 1.0), views.exposure,
        1.0 - views.approach / reach, np.minimum(steepness / options.slope_limit, 1.0),
    )
    total = sum(options.weights)
    weighed = zip(options.weights, shares, strict=True)
    risk = sum(weight / total * share for weight, share in weighed)
    unknown = np.isnan(elevation.heights)
    values = np.where(unknown, UNKNOWN, np.rint(99.0 * np.where(unknown, 0.0, risk)))
    blocked = steepness > options.slope_limit
    if obstacles is not None:
        blocked |= obstacles
    blocked &= ~unknown
    values = frozen_array(np.where(blocked, OBSTACLE, values), np.int8)
    origin = (*(elevation.corner or (0.0, 0.0)), 0.0)
    return OccupancyMap(values, elevation.resolution, origin, elevation.crs)


def risk_from_terrain(file: Path | str, *, resolution: float | None = None,
                      weapon_range: float = 300.0, options: TerrainOptions | None = None,
                      occupancy: OccupancyOptions | None = None) -> RiskMap:
    """Make the risk map of an elevation model, as ``ambush risk`` does.

    Parameters
    ----------
    file
        A GeoTIFF or another raster that GDAL reads (extra ``gis``).
    resolution
        Cell size [m]; None: the elevation model's.
    weapon_range
        Range of weapons [m]; ``options``, if given, has its own.
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
    return terrain_of_file(file, options, resolution).risk_map(occupancy)


def terrain_of_file(file: Path | str, options: TerrainOptions, resolution: float | None = None,
                    crs: str | None = None,
                    progress: Callable[[float], None] | None = None) -> OccupancyMap:
    """Make the map of an elevation model, whose system is ``crs`` if the file has none."""
    raster = read_raster(Path(file), crs=crs)
    elevation = elevation_from_raster(raster, resolution or 0.0)
    crossed = barriers(raster, elevation, options.slope_limit)
    if share := float(np.mean(crossed & ~np.isnan(elevation.heights))):
        warn(f'{file}: {100.0 * share:.2g} % of the cells of {elevation.resolution:g} m cannot be '
             'crossed, because of narrower ground that is too steep or unknown in the cells of the '
             'file; they are obstacles')
    return terrain_map(elevation, options, progress, crossed)
