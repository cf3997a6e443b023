"""How a strategy stands on ground that has changed since it was worked out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..game.revaluation import revalue
from ..maps.obstacles import ObstacleField
from ..maps.occupancy import OccupancyMap, OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..routes.corridor_update import with_moved_end, with_new_obstacles
from ..routes.corridors import Corridors
from ..routes.driven_path import Ends
from .conditioning import ConditionedStrategy
from .plan import Plan, Route, depart

_Cells = npt.NDArray[np.int64]
# With more new obstacle cells than this it counts as another map: no route is kept.
_MOST_CELLS = 100_000
# Where at least a tenth of the routes is clear, one in 10^13 departures needs more.
_MOST_DRAWS = 300
# Of the routes: so few are left out of the draw without solving anew, unless the value rises.
_MOST_LOST = 0.01
# Where fewer routes than this are left, nobody departs before it is solved anew.
_LEAST_SHARE = 0.1
_TOUCH = 1e-6  # of a cell: touching is meeting
_SIDE_MARGIN = 2  # cells around what a connection can meet


@dataclass(frozen=True)
class Standing:
    """A strategy on another map: its value there, a lower bound on what any strategy has there.

    ``share`` is the chance that a route meets no obstacle that is new and leads nowhere where
    nobody may drive any more. Where it is less than 1, the value is that of drawing until a route
    is clear. The bound is over the routes of the strategy's own network: ground that has become
    free counts from the next solve on.
    """

    value: float
    lower_bound: float
    share: float = 1.0

    @property
    def gap(self) -> float:
        """How much better than this one another strategy could be, at most."""
        return self.value - self.lower_bound

    @property
    def blocked(self) -> bool:
        """Whether more routes are lost than may be: most strategies use all ground a little."""
        return self.share < 1.0 - _MOST_LOST

    def stale(self, before: float, tolerance: float) -> bool:
        """Whether another strategy is wanted: ``before`` is the value on the strategy's own map."""
        return self.blocked or self.value > before * (1.0 + tolerance) + 1e-12

    def fit_to_depart(self, max_gap: float, before: float) -> bool:
        """Whether somebody can depart on it meanwhile.

        ``max_gap`` is how much the gap may have grown, as a share of the value, since it was
        ``before`` on the strategy's own map: a risk slack that was asked for is in both.
        """
        grown = self.gap - before
        return self.share >= _LEAST_SHARE and grown <= max_gap * self.value + 1e-12


class ChangedGround:
    """What a plan has to know of other maps of the same ground.

    Parameters
    ----------
    plan, planned_on
        The plan, and the map that it was worked out on.
    occupancy
        How cells are read.
    """

    def __init__(
        self, plan: Plan, planned_on: OccupancyMap, occupancy: OccupancyOptions
    ) -> None:
        self._plan, self._planned_on, self._occupancy = plan, planned_on, occupancy
        self._clearance = plan.options.network.clearance
        network = plan.network
        self._uv = _map_axes(planned_on, network.points)
        self._used = np.flatnonzero(plan.strategy.edge_probability > 0.0)
        self._segments = _Segments(*(self._uv[network.edges[:, k]] for k in (0, 1)))
        self._conditioned: ConditionedStrategy | None = None
        self._cells = self._cells_of_nodes()
        self._latest: _Look | None = None

    def standing(self, newest: OccupancyMap) -> Standing:
        """How the strategy stands on the newest map, which is of the same ground."""
        return self._look(newest).standing

    def holds(self, nodes: IndexArray, newest: OccupancyMap) -> bool:
        """Whether a route is still clear on the newest map."""
        pairs = self._look(newest).lost_pairs
        return not pairs or pairs.isdisjoint(pairwise(nodes.tolist()))

    def draw(self, rng: np.random.Generator, newest: OccupancyMap) -> Route | None:
        """Draw routes until one is clear on the newest map, which nearly all are.

        So a route is drawn with its chance on condition that it is clear; None after too many.
        """
        for _ in range(_MOST_DRAWS):
            route = depart(self._plan, rng)
            if self.holds(route.nodes, newest):
                return route
        return None

    def fitted(self, newest: OccupancyMap, ends: Ends) -> Plan:
        """The plan with corridors that are clear on the newest map, and lead from and to ``ends``.

        The path of a route that ``holds`` is then clear, and so are the ways from and to the ends
        if their straight lines are (``clear``).
        """
        plan, network, options = self._plan, self._plan.network, self._plan.options.network
        corridors = self._corridors(newest)
        for node, place in zip((network.source, network.target), ends, strict=True):
            if tuple(network.points[node].tolist()) != place:
                node %= network.place_count
                corner, part = self._around(newest, node, place)
                corridors = with_moved_end(
                    corridors, node, place, part, corner, self._clearance, plan.tube,
                    options.clear_of_edge,
                )
        return plan if corridors is plan.corridors else replace(plan, corridors=corridors)

    def lost(self, newest: OccupancyMap) -> npt.NDArray[np.bool_]:
        """Which edges (M,) meet an obstacle that is new, or lead where nobody may drive."""
        return self._look(newest).lost

    def clear(self, a: FloatArray, b: FloatArray, newest: OccupancyMap) -> bool:
        """Whether all segments a -> b, both (K, 2), stay clear of the newest map's obstacles."""
        ends = _map_axes(newest, np.concatenate((a, b)))
        size = np.array(newest.values.shape[::-1]) * newest.resolution
        if not ((ends >= 0.0) & (ends <= size)).all():
            return False
        corner, part = self._part(newest, ends, self._clearance)
        tails, heads = np.split(ends - corner, [len(a)])
        return bool(ObstacleField(part).clear_segments(tails, heads, self._clearance).all())

    def _corridors(self, newest: OccupancyMap) -> Corridors:
        """The plan's corridors where there are new obstacles."""
        look = self._look(newest)
        if look.corridors is None:
            look.corridors = with_new_obstacles(
                self._plan.corridors, look.new_obstacles, self._clearance, newest.resolution
            ) if len(look.new_obstacles) else self._plan.corridors
        return look.corridors

    def _around(
        self, newest: OccupancyMap, node: int, place: tuple[float, float]
    ) -> tuple[FloatArray, RiskMap]:
        """The map around the links of a node that is at another place, as far as paths may go."""
        links = self._plan.corridors.links
        at = links[(links == node).any(axis=1)].ravel()
        uv = np.vstack((self._uv[at], _map_axes(newest, np.array([place]))))
        wide = self._plan.tube
        if wide is None:
            wide = float(np.hypot(*(uv - uv[-1]).T).max())
        return self._part(newest, uv, wide + self._clearance)

    def _part(
        self, newest: OccupancyMap, uv: FloatArray, reach: float
    ) -> tuple[FloatArray, RiskMap]:
        """The map around some positions, and where its lower left corner lies."""
        step = newest.resolution
        margin = math.ceil(reach / step) + _SIDE_MARGIN
        low = np.maximum(np.floor(uv.min(axis=0) / step).astype(np.int64) - margin, 0)
        high = np.floor(uv.max(axis=0) / step).astype(np.int64) + margin + 1
        values = newest.values[low[1]:high[1], low[0]:high[0]]
        part = risk_map_from_occupancy(values, step, (0.0, 0.0, 0.0), self._occupancy)
        return low * step, part

    def _look(self, newest: OccupancyMap) -> _Look:
        if self._latest is None or self._latest.newest is not newest:
            if newest is self._planned_on:
                strategy = self._plan.strategy
                standing = Standing(strategy.value, strategy.lower_bound)
                none = np.zeros(len(self._plan.network.edges), dtype=bool)
                self._latest = _Look(newest, standing, np.empty((0, 2)), none, frozenset())
            else:
                self._latest = self._compare(newest)
        return self._latest

    def _compare(self, newest: OccupancyMap) -> _Look:
        network, strategy = self._plan.network, self._plan.strategy
        cells, alpha = self._new_obstacles(newest), self._losses(newest, self._cells)
        centres = np.multiply(cells[:_MOST_CELLS] + 0.5, newest.resolution)
        lost = np.zeros(len(network.edges), dtype=bool)
        if len(cells) > _MOST_CELLS:
            return _Look(newest, Standing(math.inf, 0.0, 0.0), centres, lost, frozenset())
        lost[self._segments.met(centres, self._distance(newest))] = True
        lost |= (alpha > self._plan.options.game.alpha_threshold)[network.heads]
        share, p = 1.0, strategy.edge_probability
        if lost[self._used].any():
            if self._conditioned is None:
                self._conditioned = ConditionedStrategy(strategy)
            share, p = self._conditioned.avoiding(lost)
        known = revalue(strategy, self._plan.options.game, alpha, p)
        pairs = frozenset(map(tuple, network.edges[lost].tolist()))
        return _Look(newest, Standing(known.value, known.bound, share), centres, lost, pairs)

    def _distance(self, newest: OccupancyMap) -> float:
        """From a cell's centre, so that what stays further away cannot meet the cell."""
        return self._clearance + (math.sqrt(0.5) + _TOUCH) * newest.resolution

    def _new_obstacles(self, newest: OccupancyMap) -> _Cells:
        """Cells (K, 2) = (column, row) that are obstacles now and were none."""
        before, now = self._planned_on.values.ravel(), newest.values.ravel()
        # Flat: for the rows and columns of a map of 4000 x 4000 numpy takes five times as long.
        changed = np.flatnonzero(before != now)
        was, is_now = (_obstacles(each[changed], self._occupancy) for each in (before, now))
        rows, columns = np.divmod(changed[is_now & ~was], newest.values.shape[1])
        return np.stack((columns, rows), axis=1)

    def _losses(self, grid: OccupancyMap, cells: _Cells) -> FloatArray:
        """Alpha (N,) of the nodes on a map, where they lie in these ``cells``."""
        values = grid.values[cells[:, 1], cells[:, 0]][None, :]
        risk_map = risk_map_from_occupancy(values, 1.0, options=self._occupancy)
        alpha: FloatArray = risk_map.alpha[0].copy()
        network = self._plan.network
        alpha[network.ends] = 0.0
        return alpha

    def _cells_of_nodes(self) -> _Cells:
        """Cells (N, 2) = (column, row) of the nodes.

        A node on the border between cells has the loss of one of them, which the rounding of its
        position may have turned into the other one: it is the one whose loss the node has.
        """
        on = self._planned_on
        last = np.array(on.values.shape[::-1]) - 1
        uv, alpha = self._uv / on.resolution, self._plan.network.alpha
        found: _Cells = np.clip(np.floor(uv + _TOUCH), 0, last).astype(np.int64)
        for shift in ((-1, -1), (-1, 1), (1, -1)):
            other = np.flatnonzero(self._losses(on, found) != alpha)
            moved = np.floor(uv[other] + _TOUCH * np.array(shift))
            found[other] = np.clip(moved, 0, last).astype(np.int64)
        return found


@dataclass(eq=False)
class _Look:
    """What the newest map means: centres (K, 2) of cells, and the edges that are lost.

    The edges are given as a mask (M,) and as pairs (tail, head). ``corridors`` are those left.
    """

    newest: OccupancyMap
    standing: Standing
    new_obstacles: FloatArray
    lost: npt.NDArray[np.bool_]
    lost_pairs: frozenset[tuple[int, ...]]
    corridors: Corridors | None = None


class _Segments:
    """Segments a -> b, both (K, 2), among which those near a place are found quickly."""

    def __init__(self, a: FloatArray, b: FloatArray) -> None:
        self._a, self._b = a, b
        self._middles = cKDTree((a + b) / 2) if len(a) else None
        self._half = float(np.hypot(*(b - a).T).max(initial=0.0)) / 2

    def met(self, places: FloatArray, distance: float) -> IndexArray:
        """The segments that come within ``distance`` of one of the places (K, 2)."""
        if self._middles is None or not len(places):
            return np.empty(0, dtype=np.int64)
        near = self._middles.query_ball_point(places, self._half + distance)
        place = np.repeat(np.arange(len(places)), [len(each) for each in near])
        segment = np.array([k for each in near for k in each], dtype=np.int64)
        a, b, c = self._a[segment], self._b[segment], places[place]
        along = b - a
        squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
        t = np.clip(((c - a) * along).sum(axis=1) / squared, 0.0, 1.0)
        gaps = np.hypot(*(a + t[:, None] * along - c).T)
        return np.unique(segment[gaps <= distance])


def _obstacles(values: npt.NDArray[np.int8], options: OccupancyOptions) -> npt.NDArray[np.bool_]:
    unknown = (values == -1) & (options.unknown_alpha < 0.0)
    found: npt.NDArray[np.bool_] = (values >= options.obstacle_threshold) | unknown
    return found


def _map_axes(grid: OccupancyMap, points: FloatArray) -> FloatArray:
    """World positions (K, 2) in map axes [m], to the last digit as ``RiskMap`` has them."""
    empty = RiskMap(np.zeros((1, 1)), np.zeros((1, 1), bool), grid.resolution, grid.origin)
    return empty.to_map_axes(points)
