"""The risk map that follows from the ground.

Four shares, each 0..1, say what makes an ambush costly in a cell:

* depth: relative depth within weapon range, over ``FULL_DEPTH`` = 0.4 times the weapon range (full
  at 120 m of higher ground within 300 m): fire from above, and nowhere to go.
* exposure: share of the ground within weapon range from which the vehicle is seen.
* approach: 1 - distance of the nearest hidden ground / weapon range, the mean over all directions:
  so near somebody comes unseen.
* slope: over ``slope_limit``: the steeper, the slower, the longer under fire.

The value is round(99 risk), risk their weighted mean, times ``road_factor`` on roads: there the
convoy is fast. Cells of slope over ``slope_limit`` are obstacles (100) unless a road leads through
them; cells of unknown height are unknown (-1).

The slope limit: off-road trucks are built to climb about 0.60 on firm, even ground; 30 % is taken
off for soil, load and the steeper pitches that a cell hides. The weights are a judgement, not a
measurement: who knows better sets them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .elevation import BoolArray, Elevation, HeightArray, InvalidTerrain
from .relief import relative_depth, slope
from .visibility import ViewOptions, viewshed

OBSTACLE, UNKNOWN = 100, -1
FULL_DEPTH = 0.4


@dataclass(frozen=True)
class TerrainOptions:
    """How ground is read as risk.

    Parameters
    ----------
    view
        Weapon range, heights of vehicle and person.
    slope_limit
        Rise over run that is not driven over.
    weights
        Of depth, exposure, approach and slope; what counts is their ratio.
    road_factor
        The risk on roads, over what it were there without a road: 0..1.

    Raises
    ------
    InvalidTerrain
        A number is out of range.
    """

    view: ViewOptions = field(default_factory=ViewOptions)
    slope_limit: float = 0.42
    weights: tuple[float, float, float, float] = (0.4, 0.2, 0.2, 0.2)
    road_factor: float = 0.5

    def __post_init__(self) -> None:
        if not (math.isfinite(self.slope_limit) and self.slope_limit > 0.0):
            raise InvalidTerrain(f'slope_limit must be positive, got {self.slope_limit}')
        if not 0.0 <= self.road_factor <= 1.0:
            raise InvalidTerrain(f'road_factor must be in 0..1, got {self.road_factor}')
        sound = all(math.isfinite(weight) and weight >= 0.0 for weight in self.weights)
        if len(self.weights) != 4 or not sound or sum(self.weights) <= 0.0:
            raise InvalidTerrain(
                'weights must be four numbers >= 0 (depth, exposure, approach, slope), not all 0, '
                f'got {self.weights}'
            )


@dataclass(frozen=True, eq=False)
class TerrainMap:
    """The risk map and what it follows from; all (H, W), row 0 in the south.

    Attributes
    ----------
    values : int8
        As in an occupancy grid: 0..99 risk, 100 obstacle, -1 unknown.
    resolution : float
        Edge of a cell [m].
    slope, depth, exposure, approach
        Rise over run, [m], share, [m].
    roads : bool
    """

    values: npt.NDArray[np.int8]
    resolution: float
    slope: HeightArray
    depth: HeightArray
    exposure: HeightArray
    approach: HeightArray
    roads: BoolArray


def terrain_map(
    elevation: Elevation,
    options: TerrainOptions | None = None,
    roads: BoolArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> TerrainMap:
    """Make the risk map of the ground; ``roads`` (H, W) marks cells that a road leads through.

    ``progress`` is told the share of the work that is done.

    Raises
    ------
    InvalidTerrain
        The weapon range is shorter than a cell, or ``roads`` has another shape.
    """
    options = options or TerrainOptions()
    shape = elevation.heights.shape
    roads = np.zeros(shape, bool) if roads is None else np.asarray(roads, dtype=bool)
    if roads.shape != shape:
        raise InvalidTerrain(f'roads must have the shape of the elevation, {shape}, '
                             f'got {roads.shape}')
    steepness = slope(elevation)
    depth = relative_depth(elevation, options.view.weapon_range)
    views = viewshed(elevation, options.view, progress)
    layers = (steepness, depth, views.exposure, views.approach, roads)
    values = _values(elevation, layers, options)
    for layer in (values, *layers):
        layer.setflags(write=False)
    return TerrainMap(values, elevation.resolution, *layers)


def _values(
    elevation: Elevation,
    layers: tuple[HeightArray, HeightArray, HeightArray, HeightArray, BoolArray],
    options: TerrainOptions,
) -> npt.NDArray[np.int8]:
    """Cell values by the formulas at the top of this file."""
    steepness, depth, exposure, approach, roads = layers
    reach = options.view.weapon_range
    shares = (
        np.minimum(depth / (FULL_DEPTH * reach), 1.0),
        exposure,
        1.0 - approach / reach,
        np.minimum(steepness / options.slope_limit, 1.0),
    )
    total = sum(options.weights)
    weighed = zip(options.weights, shares, strict=True)
    risk = sum(weight / total * share for weight, share in weighed)
    risk = np.where(roads, options.road_factor, 1.0) * risk
    unknown = np.isnan(elevation.heights)
    values = np.where(unknown, UNKNOWN, np.rint(99.0 * np.where(unknown, 0.0, risk)))
    blocked = (steepness > options.slope_limit) & ~roads & ~unknown
    return np.where(blocked, OBSTACLE, values).astype(np.int8)
