# SPDX-License-Identifier: Apache-2.0
"""Assess plans and drawn paths on another map, and on other roads.

Unlike in ``changed_ground``, the map may have other cells. A stretch of road is lost if it lies on
a road of the plan, but on no new road that can be driven in the same direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IndexArray, members
from ..game.hits import joint_law
from ..game.revaluation import revalue
from ..game.strategy import TripStrategy
from ..maps.obstacles import ObstacleField, nearest_on_segments
from ..maps.risk_map import RiskMap
from ..maps.road_file import RoadGraph
from ..network.construction import NetworkOptions
from .ambush_costs import has_cell_sites
from .cell_losses import CellLosses, CellSearch
from .changed_ground import Assessment
from .conditioning import ConditionedStrategy, clear_laws
from .options import ROAD_TUBE, PlanningOptions

# Largest distance of a place on a road from its line, and between sampled places [m].
_ON_ROAD, _STEP = 2.0 * ROAD_TUBE, 10.0
# Least cosine of the angle between a stretch and the road that it follows.
_MIN_COSINE = 0.7


class Blocked(NamedTuple):
    """First blocked place (x, y) of a path [m], its distance ``along`` the path [m].

    ``places`` is the number of separate blocked stretches.
    """

    xy: tuple[float, float]
    along: float
    places: int


@dataclass(frozen=True, eq=False)
class NewGround:
    """A map and, for plans on roads, the roads on it in its coordinates."""

    risk_map: RiskMap
    roads: RoadGraph | None = None

    def blocked(self, path: FloatArray, before: NewGround,
                options: NetworkOptions) -> Blocked | None:
        """Find where a path (L, 2 or 3) is blocked that was clear ``before``; None: nowhere."""
        a, b = path[:-1, :2], path[1:, :2]
        lost = ~self._clear(a, b, before, options) & before._clear(a, b, before, options)
        if not lost.any():
            return None
        first = int(lost.argmax())
        along = float(np.hypot(*(b - a)[:first].T).sum())
        x, y = (0.5 * (a[first] + b[first])).tolist()
        return Blocked((x, y), along, int((np.diff(lost, prepend=False) & lost).sum()))

    def assess(self, trip: TripStrategy, before: NewGround,
               planning: PlanningOptions) -> Assessment:
        """Assess strategies on this ground, if only their clear routes are driven."""
        legs, network, cell_sites = trip.joint, trip.game.network, has_cell_sites(trip)
        cells = CellLosses(self.risk_map, planning.game.ambush_in_obstacles)
        alpha = cells.losses_at(network.points)
        alpha[[(leg.network.source, leg.network.target) for leg in trip.legs]] = 0.0
        alpha[(network.alpha == 0.0) & cell_sites] = 0.0  # the search below covers these nodes
        forbidden, lost = alpha > planning.game.alpha_threshold, list[BoolArray]()
        for leg in trip.legs:
            leg_network, used = leg.network, np.flatnonzero(leg.edge_probability > 0.0)
            lost.append(forbidden[leg_network.heads])
            tails, heads = leg_network.points[leg_network.edges[used]].swapaxes(0, 1)
            lost[-1][used] |= ~self._clear(tails, heads, before, planning.network)
        share, laws = clear_laws(map(ConditionedStrategy, trip.legs), lost)
        if not share > 0.0:
            return Assessment(math.inf, 0.0, 0.0)
        law = joint_law(legs, laws)
        known = revalue(trip, alpha, law)
        value = known.value
        if cell_sites and value < math.inf:
            search = CellSearch(cells, legs.games, law.uses(legs.edge_count) > 0.0)
            value = max([value, *search.worst(law, value).mean_loss[:1]])
        return Assessment(value, known.bound, share)

    def _clear(self, a: FloatArray, b: FloatArray, before: NewGround,
               options: NetworkOptions) -> BoolArray:
        """Return whether segments a -> b, both (K, 2) [m], can be driven here (K,)."""
        field = ObstacleField(self.risk_map, options.clear_of_edge)
        begin, end = (self.risk_map.to_map_axes(each) for each in (a, b))
        clear = field.clear_segments(begin, end, options.clearance)
        if self.roads is not None and before.roads is not None and self is not before:
            clear &= _on_roads(a, b, self.roads) | ~_on_roads(a, b, before.roads)
        return clear


def _on_roads(a: FloatArray, b: FloatArray, roads: RoadGraph) -> BoolArray:
    """Return whether segments a -> b, both (K, 2) [m], follow roads in an allowed direction."""
    if not len(roads.pairs):
        return np.zeros(len(a), dtype=bool)
    begin, end = roads.points[roads.pairs].swapaxes(0, 1)
    segment, places = _sample(a, b)
    piece, on_piece = _sample(begin, end)
    limit = _ON_ROAD + 0.5 * _STEP
    pairs = cKDTree(places).sparse_distance_matrix(cKDTree(on_piece), limit, output_type='ndarray')
    place, road, step = places[pairs['i']], piece[pairs['j']], (b - a)[segment[pairs['i']]]
    distance = np.hypot(*(nearest_on_segments(place, begin[road], end[road]) - place).T)
    line = end[road] - begin[road]
    cosine = (step * line).sum(axis=1) / np.maximum(np.hypot(*step.T) * np.hypot(*line.T), 1e-12)
    allowed = roads.speeds[road, (cosine < 0.0).astype(np.int64)] > 0.0
    good = (distance <= _ON_ROAD) & (np.abs(cosine) >= _MIN_COSINE) & allowed
    on_road = np.zeros(len(places), dtype=bool)
    on_road[pairs['i'][good]] = True
    follows = np.ones(len(a), dtype=bool)
    follows[segment[~on_road]] = False
    return follows


def _sample(a: FloatArray, b: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Sample segments a -> b at most ``_STEP`` apart: segment (P,) and position (P, 2) of each."""
    count = np.maximum(np.ceil(np.hypot(*(b - a).T) / _STEP), 1.0).astype(np.int64)
    segment, k = members(count)
    share = ((k + 0.5) / count[segment])[:, None]
    return segment, a[segment] * (1.0 - share) + b[segment] * share
