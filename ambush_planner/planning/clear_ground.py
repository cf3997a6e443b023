# SPDX-License-Identifier: Apache-2.0
"""Ground that a convoy can drive on the newest map."""

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
_MARGIN = 2  # width of the border around the part of the map that is tested [cells]
# Length of path that is tested together [cells]: the map is read around it.
_PIECE = 500


@dataclass(frozen=True, eq=False)
class ClearGround:
    """The ground of the newest map that is clear of obstacles, by the ``network``'s clearance.

    Each question reads the map only around its places, so these should lie together.
    """

    newest: OccupancyMap
    occupancy: OccupancyOptions
    network: NetworkOptions

    def segments(self, a: FloatArray, b: FloatArray, clearance: float | None = None) -> BoolArray:
        """Return the clear ones of segments a -> b, both (K, 2) [m]; ``clearance``: another one."""
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
        """Return the steps (L - 1,) that a convoy at the first of ``points`` (L, 2) [m] can drive.

        They are clear, except that the first ``WAY_OUT`` needs no clearance: the convoy may have
        strayed from its path. If it stands in an obstacle, it may leave that.
        """
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))[:-1]
        later, at = int(np.searchsorted(along, WAY_OUT)), points[:1]
        near = self.steps(points[:later + 1], 0.0)
        if len(near) and not self.segments(at, at, 0.0)[0]:
            near[:int(near.argmax())] = True
        return np.append(near, self.steps(points[later:]))

    def has_arrived(self, start: tuple[float, float], goal: tuple[float, float]) -> bool:
        """Return whether a start is within a cell of the goal, which is clear."""
        at = np.array([goal])
        return math.dist(start, goal) <= self.newest.resolution and bool(self.segments(at, at)[0])

    def way_out(self, place: tuple[float, float]) -> tuple[float, float]:
        """The nearest clear place within ``WAY_OUT`` of a convoy in a costmap's inflation [m].

        The straight way there meets no cell of 100, which the convoy cannot drive through, other
        than its own. Returns ``place`` if it is clear, or if there is no such way.
        """
        clearance = self.network.clearance
        uv = to_map_axes(self.newest.origin, [place])
        corner, part = self.part(uv, WAY_OUT + clearance)
        at, field = uv - corner, ObstacleField(part, self.network.clear_of_edge)
        if field.clear_points(at, clearance)[0]:
            return place
        lethal_only = replace(self, occupancy=replace(self.occupancy, obstacle_threshold=100))
        _, hard = lethal_only.part(uv, WAY_OUT + clearance)
        lethal = hard.obstacles.copy()
        lethal[hard.cells(at[0])] = False
        centres = np.multiply(np.argwhere(~part.obstacles)[:, ::-1] + 0.5, part.resolution)
        away = np.hypot(*(centres - at).T)
        near = centres[np.argsort(away, kind='stable')[:int((away <= WAY_OUT).sum())]]
        straight = ObstacleField(replace(hard, obstacles=lethal), False).clear_segments(
            np.repeat(at, len(near), axis=0), near, 0.0)
        found = near[straight & field.clear_points(near, clearance)]
        if not len(found):
            return place
        x, y = to_world(self.newest.origin, found[0] + corner).tolist()
        return x, y

    def part(self, uv: FloatArray, reach: float) -> tuple[FloatArray, RiskMap]:
        """Return the lower left corner of the map within ``reach`` of positions, and that map.

        Both in map axes [m]; at least one cell, even if the positions (K, 2) are off the map.
        """
        step, last = self.newest.resolution, np.array(self.newest.values.shape[::-1]) - 1
        margin = math.ceil(reach / step) + _MARGIN
        low: npt.NDArray[np.int64] = np.clip(uv.min(axis=0) // step - margin, 0, last).astype(int)
        high = np.clip(uv.max(axis=0) // step + margin, 0, last).astype(int) + 1
        values = self.newest.values[low[1]:high[1], low[0]:high[0]]
        return np.multiply(low, step), risk_from_occupancy(values, step, options=self.occupancy)
