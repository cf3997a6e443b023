# SPDX-License-Identifier: Apache-2.0
"""The ground that a convoy can drive on the newest map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, FloatArray
from ..maps.obstacles import ObstacleField
from ..maps.occupancy import OccupancyMap, OccupancyOptions, risk_from_occupancy
from ..maps.risk_map import RiskMap, to_map_axes, to_world
from ..network.construction import NetworkOptions

# Maximum length of the way out of an obstacle [m].
WAY_OUT = 1.0
_MARGIN = 2  # width of the border around the part of the map that is read [cells]
# Length of path that is tested at once [cells]: the map is read around it.
_PIECE = 500


@dataclass(frozen=True, eq=False)
class ClearGround:
    """Tests whether ground of the newest map is clear of obstacles by the ``network``'s clearance.

    Each call reads the map only around its places, so these should lie close together.
    """

    newest: OccupancyMap
    occupancy: OccupancyOptions
    network: NetworkOptions

    def segments(self, a: FloatArray, b: FloatArray, clearance: float | None = None) -> BoolArray:
        """Return whether segments a -> b, both (K, 2) [m], are clear: (K,).

        ``clearance`` [m] replaces that of the network.
        """
        if not len(a):
            return np.zeros(0, dtype=bool)
        reach = self.network.clearance if clearance is None else clearance
        uv = to_map_axes(self.newest.origin, np.stack((a, b)))
        corner, part = self.part(uv.reshape(-1, 2), reach)
        tails, heads = uv - corner
        return ObstacleField(part, self.network.clear_of_edge).clear_segments(tails, heads, reach)

    def steps(self, points: FloatArray, clearance: float | None = None) -> BoolArray:
        """Return whether the steps (L - 1,) of a path with ``points`` (L, 2) [m] are clear."""
        along = np.cumsum(np.hypot(*np.diff(points, axis=0).T))
        cuts = np.diff(along // (_PIECE * self.newest.resolution)).nonzero()[0] + 1
        pieces = np.split(np.arange(len(along)), cuts)
        return np.concatenate([self.segments(points[piece], points[piece + 1], clearance)
                               for piece in pieces])

    def drivable_steps(self, points: FloatArray) -> BoolArray:
        """Return whether a convoy can drive the steps (L - 1,) of a path from its place.

        The first of ``points`` (L, 2) [m] is the convoy's place. Steps have to be clear, but the
        first ``WAY_OUT`` needs no clearance: the convoy may have strayed from its path. If it
        stands in an obstacle, it may leave that.
        """
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))[:-1]
        later, start = int(np.searchsorted(along, WAY_OUT)), points[:1]
        drivable = self.steps(points[:later + 1], 0.0)
        if len(drivable) and not self.segments(start, start, 0.0)[0]:
            drivable[:int(drivable.argmax())] = True
        return np.append(drivable, self.steps(points[later:]))

    def has_arrived(self, start: tuple[float, float], goal: tuple[float, float]) -> bool:
        """Return whether a start is within a cell of the goal, which is clear."""
        xy = np.array([goal])
        return math.dist(start, goal) <= self.newest.resolution and bool(self.segments(xy, xy)[0])

    def way_out(self, place: tuple[float, float]) -> tuple[float, float]:
        """Return the nearest clear place within ``WAY_OUT`` of a convoy in a costmap's inflation.

        The straight way there meets no lethal cell (100) but the convoy's own. Returns ``place``
        itself if it is clear, or if there is no such way.
        """
        clearance = self.network.clearance
        uv = to_map_axes(self.newest.origin, [place])
        corner, part = self.part(uv, WAY_OUT + clearance)
        position, field = uv - corner, ObstacleField(part, self.network.clear_of_edge)
        if field.clear_points(position, clearance)[0]:
            return place
        lethal_only = replace(self, occupancy=replace(self.occupancy, obstacle_threshold=100))
        _, lethal_map = lethal_only.part(uv, WAY_OUT + clearance)
        lethal = lethal_map.obstacles.copy()
        lethal[lethal_map.cells(position[0])] = False
        centres = np.multiply(np.argwhere(~part.obstacles)[:, ::-1] + 0.5, part.resolution)
        distance = np.hypot(*(centres - position).T)
        nearest = centres[np.argsort(distance, kind='stable')[:int((distance <= WAY_OUT).sum())]]
        straight = ObstacleField(replace(lethal_map, obstacles=lethal), False).clear_segments(
            np.repeat(position, len(nearest), axis=0), nearest, 0.0)
        candidates = nearest[straight & field.clear_points(nearest, clearance)]
        if not len(candidates):
            return place
        x, y = to_world(self.newest.origin, candidates[0] + corner).tolist()
        return x, y

    def part(self, uv: FloatArray, reach: float) -> tuple[FloatArray, RiskMap]:
        """Cut out the map within ``reach`` of positions (K, 2): lower left corner, and part.

        Positions and corner are in map axes [m]. The part has at least one cell, even if all
        positions are off the map.
        """
        step, last = self.newest.resolution, np.array(self.newest.values.shape[::-1]) - 1
        margin = math.ceil(reach / step) + _MARGIN
        low: npt.NDArray[np.int64] = np.clip(uv.min(axis=0) // step - margin, 0, last).astype(int)
        high = np.clip(uv.max(axis=0) // step + margin, 0, last).astype(int) + 1
        values = self.newest.values[low[1]:high[1], low[0]:high[0]]
        return np.multiply(low, step), risk_from_occupancy(values, step, options=self.occupancy)
