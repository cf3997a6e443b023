# SPDX-License-Identifier: Apache-2.0
"""Risk map from terrain.

Four factors, each 0..1, make an ambush in a cell costly:

* depth: relative depth within weapon range, divided by ``FULL_DEPTH`` = 0.4 times the weapon range
  (1 if terrain within 300 m is 120 m higher): the vehicle is fired at from above and cannot leave.
* exposure: share of the terrain within weapon range from which the vehicle is visible.
* approach: 1 - distance to the nearest hidden terrain / weapon range, averaged over all directions:
  an attacker can come that close unseen.
* slope: divided by ``slope_limit``: on steep terrain the vehicle is slow and longer under fire.

The cell value is round(99 * risk), where risk is the weighted mean of the factors, multiplied by
``road_factor`` on roads because the convoy drives fast there. Cells steeper than ``slope_limit``
are obstacles (100) unless they contain a road; cells of unknown height are unknown (-1).

Off-road trucks climb slopes of about 0.60 on firm, even ground. The default limit is 30 % lower to
allow for soil, load and steeper spots within a cell. The weights are a judgement, not a
measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..arrays import BoolArray, frozen_array
from ..errors import InvalidOption
from ..option_checks import allowed, check_at_least, check_options
from .elevation import Elevation, InvalidTerrain
from .occupancy import OBSTACLE, UNKNOWN, OccupancyMap
from .relief import relative_depth, slope
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
    road_factor
        Factor 0..1 on the risk of cells with a road.

    Raises InvalidOption if a number is out of range.
    """

    view: ViewOptions = field(default_factory=ViewOptions)
    slope_limit: float = allowed(0.42, low=1e-3)
    weights: tuple[float, float, float, float] = (0.4, 0.2, 0.2, 0.2)
    road_factor: float = allowed(0.5, high=1.0)

    def __post_init__(self) -> None:
        check_options(self)
        for weight in self.weights:
            check_at_least('weights', weight, 0.0)
        if len(self.weights) != 4 or not sum(self.weights):
            raise InvalidOption('weights must be four numbers (depth, exposure, approach, slope), '
                                f'not all 0, got {self.weights}')


def terrain_map(elevation: Elevation, options: TerrainOptions | None = None,
                roads: BoolArray | None = None,
                progress: Callable[[float], None] | None = None,
                barriers: BoolArray | None = None) -> OccupancyMap:
    """Compute the risk of terrain as values of a map; ``roads`` (H, W) marks cells with a road.

    ``barriers`` (H, W) marks cells that are obstacles unless they have one. ``progress`` is called
    with the completed share of the work.

    Raises InvalidTerrain if the weapon range is shorter than a cell, or ``roads`` has another
    shape.
    """
    options = options or TerrainOptions()
    shape = elevation.heights.shape
    roads = np.zeros(shape, bool) if roads is None else np.asarray(roads, dtype=bool)
    if roads.shape != shape:
        raise InvalidTerrain(f'roads must have the shape of the elevation, {shape}, '
                             f'got {roads.shape}')
    reach, steepness = options.view.weapon_range, slope(elevation)
    depth, views = relative_depth(elevation, reach), viewshed(elevation, options.view, progress)
    shares = (
        np.minimum(depth / (FULL_DEPTH * reach), 1.0), views.exposure,
        1.0 - views.approach / reach, np.minimum(steepness / options.slope_limit, 1.0),
    )
    total = sum(options.weights)
    weighed = zip(options.weights, shares, strict=True)
    risk = sum(weight / total * share for weight, share in weighed)
    risk = np.where(roads, options.road_factor, 1.0) * risk
    unknown = np.isnan(elevation.heights)
    values = np.where(unknown, UNKNOWN, np.rint(99.0 * np.where(unknown, 0.0, risk)))
    blocked = steepness > options.slope_limit
    if barriers is not None:
        blocked |= barriers
    blocked &= ~roads & ~unknown
    values = frozen_array(np.where(blocked, OBSTACLE, values), np.int8)
    origin = (*(elevation.corner or (0.0, 0.0)), 0.0)
    return OccupancyMap(values, elevation.resolution, origin, elevation.crs)
