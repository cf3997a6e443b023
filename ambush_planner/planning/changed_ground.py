"""Assess a strategy on a map that has changed since it was solved."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..game.certificate.certificate import Certificate
from ..game.game import Game
from ..game.law.chain import chain_of
from ..game.revaluation import revalue
from ..maps.obstacles import ObstacleField
from ..maps.occupancy import OccupancyMap, OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap, to_world
from ..network.construction import NetworkOptions
from ..routes.corridor_update import with_moved_end, with_new_obstacles
from ..routes.corridors import Corridors
from ..routes.driven_path import Ends
from .cell_losses import CellSearch, LatestLosses
from .conditioning import ConditionedStrategy
from .options import holds_anywhere
from .plan import Plan, Route, depart

_Cells = npt.NDArray[np.int64]
# Maximum number of new obstacle cells; with more, no route is kept.
_MOST_CELLS = 100_000
# Maximum number of draws until a route is clear. If a tenth of the routes is clear, one departure
# in 10^13 needs more.
_MOST_DRAWS = 300
# Solve again once more than this share of the routes is blocked.
_MOST_BLOCKED = 0.01
# Nobody departs before the next solve if a smaller share of the routes is clear.
LEAST_CLEAR = 0.1
# Relative overrun of the length budget that is a solver's rounding.
_LENGTH_TOLERANCE = 1e-6
_TOUCH = 1e-6  # distance at which cells count as touched [cells]
_MARGIN = 2  # width of the border around the part of the map that is tested [cells]
# Number of steps of a path that are tested together: the map is read around them.
_PIECE = 50
# Maximum length of the way out of an obstacle [m].
WAY_OUT = 1.0


@dataclass(frozen=True)
class Assessment:
    """The value of a strategy on another map, and a lower bound on that of any strategy there.

    The bound holds for the strategy's own network: ground that has become free counts after the
    next solve. ``clear_share`` is the probability that a route meets no new obstacle and no place
    that must not be entered; if it is below 1, the value is that of drawing until a route is clear.
    ``expected_length`` [``travel_unit``] is the mean over the clear routes (inf if none is),
    ``length_budget`` what ``max_detour`` allows.
    """

    value: float
    lower_bound: float
    clear_share: float = 1.0
    expected_length: float = math.inf
    length_budget: float = math.inf
    travel_unit: str = 'm'

    @property
    def gap(self) -> float:
        """Upper bound on how much lower another strategy's value could be."""
        return self.value - self.lower_bound

    @property
    def is_blocked(self) -> bool:
        """Whether too many routes are blocked; most strategies use all ground a little."""
        return self.clear_share < 1.0 - _MOST_BLOCKED

    @property
    def is_over_budget(self) -> bool:
        """Whether the clear routes are longer on average than the length budget allows."""
        return self.length_budget * (1.0 + _LENGTH_TOLERANCE) < self.expected_length < math.inf

    @property
    def concern(self) -> str:
        """What to know about the length of the clear routes, in words; '' if nothing."""
        if not self.is_over_budget:
            return ''
        return (f'the routes that are clear on the current map have a mean length of '
                f'{self.expected_length:.4g} {self.travel_unit}, '
                f'{self.expected_length / self.length_budget:.3g} times the budget of '
                f'{self.length_budget:.4g} {self.travel_unit} (strategy.max_detour)')

    def is_stale(self, original_value: float, tolerance: float) -> bool:
        """Whether to solve again; ``original_value`` is that on the strategy's own map."""
        return self.is_blocked or self.value > original_value * (1.0 + tolerance) + 1e-12

    def allows_departure(self, max_gap: float, original_gap: float) -> bool:
        """Whether a convoy may depart on the strategy before the next solve.

        ``max_gap`` bounds, as a share of the value, how much the gap may exceed ``original_gap``,
        the gap on the strategy's own map; both include the risk slack.
        """
        growth = self.gap - original_gap
        return self.clear_share >= LEAST_CLEAR and growth <= max_gap * self.value + 1e-12


class ChangedGround:
    """Assesses a plan, and draws its routes, on other maps of the same ground.

    The plan was solved on the map ``planned_on``; ``occupancy`` says how cell values are read.
    Several plans may share the ``losses`` of the newest map.
    """

    def __init__(self, plan: Plan, planned_on: OccupancyMap, occupancy: OccupancyOptions,
                 losses: LatestLosses | None = None) -> None:
        self._cell_losses = losses or LatestLosses()
        self.plan, self._planned_on, self._occupancy = plan, planned_on, occupancy
        self._clearance = plan.options.network.clearance
        network = plan.network
        self._uv = _map_axes(planned_on, network.points)
        self._used = np.flatnonzero(plan.strategy.edge_probability > 0.0)
        self._segments = _Segments(*(self._uv[network.edges[:, k]] for k in (0, 1)))
        # Whether an ambusher can hide in an obstacle, at the loss of the nearest free cell.
        self._hiding = plan.strategy.game.reach > 0.0 and plan.options.game.ambush_in_obstacles
        self._cells = self._cells_of_nodes()
        self._latest: Comparison | None = None

    def assess(self, newest: OccupancyMap) -> Assessment:
        """Return the value of the strategy on the newest map, which is of the same ground."""
        look = self.compare(newest)
        if look.assessment is None:
            look.assessment = self._assess(look)
        return look.assessment

    def is_clear(self, nodes: IndexArray, newest: OccupancyMap) -> bool:
        """Whether a route is clear on the newest map."""
        pairs = self.compare(newest).lost_pairs
        return not pairs or pairs.isdisjoint(pairwise(nodes.tolist()))

    def connects(self, newest: OccupancyMap, ends: Ends) -> bool:
        """Whether all first and last edges in use can be driven from the start and to the goal.

        All of them: whether the plan suits must not depend on the route that is drawn.
        """
        network, (start, goal) = self.plan.network, ends
        visits = network.places[[network.source, *network.stops, network.target]]
        if len(np.unique(visits)) < len(visits):
            return False  # a place visited twice cannot be moved for one visit only
        if any(one == other for one, other in pairwise((start, *self.plan.stops_xy, goal))):
            return False  # the solve will refuse it
        clear = (self.plan.strategy.edge_probability > 0.0) & ~self.lost(newest)
        points = network.points.copy()
        points[[network.source, network.target]] = start, goal
        # Start and goal separately: the rectangle around both may be the whole map.
        for at_end in network.tails == network.source, network.heads == network.target:
            a, b = (points[each[clear & at_end]] for each in (network.tails, network.heads))
            # A step of length 0 has no direction.
            if (a == b).all(axis=1).any() or not self.clear(a, b, newest).all():
                return False
        return True

    def draw(self, rng: np.random.Generator, newest: OccupancyMap) -> Route | None:
        """Draw routes until one is clear on the newest map; None after too many draws.

        A route then has its conditional probability, given that it is clear.
        """
        for _ in range(_MOST_DRAWS):
            route = depart(self.plan, rng)
            if self.is_clear(route.nodes, newest):
                return route
        return None

    def fitted(self, newest: OccupancyMap, ends: Ends, joins: IndexArray | None = None) -> Plan:
        """Return the plan with corridors between ``ends`` that are clear on the newest map.

        The path of a clear route is then clear, and so are the connections to the ends if their
        straight lines are (``clear``). The start is connected with the same nodes as before, or
        with the places ``joins`` (K,).
        """
        plan, network, options = self.plan, self.plan.network, self.plan.options.network
        corridors = self._corridors(newest)
        for node, place in zip((network.source, network.target), ends, strict=True):
            if tuple(network.points[node].tolist()) != place:
                others = joins if node == network.source else None
                node = int(network.places[node])
                corner, part = self._around(newest, node, place, others)
                corridors = with_moved_end(corridors, node, place, part, corner, self._clearance,
                                           plan.tube, options.clear_of_edge, others)
        return plan if corridors is plan.corridors else replace(plan, corridors=corridors)

    @cached_property
    def conditioned(self) -> ConditionedStrategy:
        """The strategy on condition that routes avoid some edges."""
        return ConditionedStrategy(self.plan.strategy)

    def lost(self, newest: OccupancyMap) -> npt.NDArray[np.bool_]:
        """Return which edges (M,) meet a new obstacle or lead to a node over the threshold."""
        return self.compare(newest).lost

    def clear(self, a: FloatArray, b: FloatArray, newest: OccupancyMap) -> npt.NDArray[np.bool_]:
        """Which segments a -> b, both (K, 2), stay clear of the newest map's obstacles: (K,).

        Those of one call should lie together: the map is read around all of them.
        """
        return clear_segments(a, b, newest, self._occupancy, self.plan.options.network)

    def _corridors(self, newest: OccupancyMap) -> Corridors:
        """Return the plan's corridors among the new obstacles."""
        look = self.compare(newest)
        if look.corridors is None:
            look.corridors = with_new_obstacles(
                self.plan.corridors, look.new_obstacles, self._clearance, newest.resolution
            ) if len(look.new_obstacles) else self.plan.corridors
        return look.corridors

    def _around(self, newest: OccupancyMap, node: int, place: tuple[float, float],
                neighbours: IndexArray | None) -> tuple[FloatArray, RiskMap]:
        """Return the map around the links of a moved node, as far as paths may go."""
        links, at = self.plan.corridors.links, neighbours
        if at is None:
            at = links[(links == node).any(axis=1)].ravel()
        uv = np.vstack((self._uv[at], _map_axes(newest, np.array([place]))))
        wide = self.plan.tube
        if wide is None:
            wide = float(np.hypot(*(uv - uv[-1]).T).max())
        return _part(newest, self._occupancy, uv, wide + self._clearance)

    def compare(self, newest: OccupancyMap) -> Comparison:
        """Compare the newest map with the one planned on."""
        if self._latest is None or self._latest.newest is not newest:
            self._latest = self._comparison(newest)
        return self._latest

    def _comparison(self, newest: OccupancyMap) -> Comparison:
        network = self.plan.network
        lost = np.zeros(len(network.edges), dtype=bool)
        if newest is self._planned_on:
            return Comparison(newest, np.empty((0, 2)), lost, frozenset(), network.alpha)
        cells, alpha = self._new_obstacles(newest), self._losses(newest, self._cells)
        centres = np.multiply(cells[:_MOST_CELLS] + 0.5, newest.resolution)
        if len(cells) > _MOST_CELLS:
            return Comparison(newest, centres, ~lost, frozenset(), alpha)
        lost[self._segments.met(centres, self._reach(newest))] = True
        lost |= (alpha > self.plan.options.game.alpha_threshold)[network.heads]
        pairs = frozenset(map(tuple, network.edges[lost].tolist()))
        return Comparison(newest, centres, lost, pairs, alpha)

    def _assess(self, look: Comparison) -> Assessment:
        """Return the value of the strategy on the compared map, without the lost edges."""
        network, strategy = self.plan.network, self.plan.strategy
        own = Certificate(strategy.value, strategy.lower_bound)
        clear_share, p = 1.0, strategy.edge_probability
        if look.newest is self._planned_on:
            return self._assessment(own, clear_share, p)
        if look.lost.all():
            return Assessment(math.inf, 0.0, 0.0)
        if look.lost[self._used].any():
            clear_share, p = self.conditioned.avoiding(look.lost)
        unchanged = p is strategy.edge_probability and np.array_equal(look.alpha, network.alpha)
        known = own if unchanged else revalue(strategy, look.alpha, p)
        known = self.at_any_cell(known, look.newest, strategy.game, p, unchanged)
        return self._assessment(known, clear_share, p)

    def at_any_cell(self, at_sites: Certificate, newest: OccupancyMap, game: Game, p: FloatArray,
                    on_others: bool = False) -> Certificate:
        """The certificate of p (M,) in a game, against ambushers at any cell if the plan's is.

        Only at cells that have changed if ``at_sites`` holds ``on_others``.
        """
        planned_on, options = self._planned_on, self.plan.options
        if not holds_anywhere(options) or math.isinf(at_sites.value):
            return at_sites
        now, before = newest.values.ravel(), planned_on.values.ravel()
        changed = np.flatnonzero(now != before)
        if not self._hiding:
            # Cells that have become obstacles hide nobody. If only such cells have changed, all
            # ambushers of the planned map count, so that its losses need not be computed again.
            changed = changed[~_obstacles(now[changed], self._occupancy)]
        other = len(changed) > 0
        if on_others and not other:
            return at_sites
        cells = self._cell_losses.on(newest if other else planned_on, self._occupancy,
                                     self._hiding)
        among = None
        if on_others and not self._hiding:
            among = np.stack(np.divmod(changed, newest.values.shape[1]), axis=1)
        search = CellSearch(cells, game, np.flatnonzero(p > 0.0))
        worst = search.worst(chain_of(game.network, p), at_sites.value, among=among)
        return replace(at_sites, value=max([at_sites.value, *worst.mean_loss[:1]]))

    def _assessment(self, certificate: Certificate, clear_share: float,
                    p: FloatArray) -> Assessment:
        """Return the assessment of drawing clear routes, which use the edges with p (M,)."""
        plan = self.plan
        return Assessment(certificate.value, certificate.bound, clear_share,
                          float(p @ plan.network.travel_costs) if p.any() else math.inf,
                          plan.options.strategy.max_detour * plan.strategy.shortest_length,
                          plan.network.travel_unit)

    def _reach(self, newest: OccupancyMap) -> float:
        """Return the distance from a cell's centre beyond which nothing meets the cell [m]."""
        return self._clearance + (math.sqrt(0.5) + _TOUCH) * newest.resolution

    def _new_obstacles(self, newest: OccupancyMap) -> _Cells:
        """Return the cells (K, 2) = (column, row) that have become obstacles."""
        before, now = self._planned_on.values.ravel(), newest.values.ravel()
        # Flat indices: with rows and columns numpy takes five times as long.
        changed = np.flatnonzero(before != now)
        was, is_now = (_obstacles(each[changed], self._occupancy) for each in (before, now))
        rows, columns = np.divmod(changed[is_now & ~was], newest.values.shape[1])
        return np.stack((columns, rows), axis=1)

    def _losses(self, grid: OccupancyMap, cells: _Cells) -> FloatArray:
        """Return alpha (N,) of nodes that lie in these ``cells`` of a map."""
        if self._hiding:
            losses = self._cell_losses.on(grid, self._occupancy, True)
            alpha = losses.in_cells(cells[:, ::-1])
        else:
            values = grid.values[cells[:, 1], cells[:, 0]][None, :]
            risk_map = risk_map_from_occupancy(values, 1.0, options=self._occupancy)
            alpha = risk_map.alpha[0].copy()
        alpha[self.plan.network.ends] = 0.0
        return alpha

    def _cells_of_nodes(self) -> _Cells:
        """Return the cells (N, 2) = (column, row) of the nodes.

        The position of a node on the border between two cells may be rounded to either. The cell
        returned is the one whose loss the node has.
        """
        on = self._planned_on
        last = np.array(on.values.shape[::-1]) - 1
        uv, alpha = self._uv / on.resolution, self.plan.network.alpha
        found: _Cells = np.clip(np.floor(uv + _TOUCH), 0, last).astype(np.int64)
        for shift in ((-1, -1), (-1, 1), (1, -1)):
            other = np.flatnonzero(self._losses(on, found) != alpha)
            moved = np.floor(uv[other] + _TOUCH * np.array(shift))
            found[other] = np.clip(moved, 0, last).astype(np.int64)
        return found


def clear_segments(a: FloatArray, b: FloatArray, newest: OccupancyMap, occupancy: OccupancyOptions,
                   network: NetworkOptions) -> npt.NDArray[np.bool_]:
    """Which segments a -> b, both (K, 2) [m], keep the network's clearance on a map: (K,).

    The map is read around all of them; ``occupancy`` says how.
    """
    ends = _map_axes(newest, np.concatenate((a, b)))
    size = np.array(newest.values.shape[::-1]) * newest.resolution
    on_map: npt.NDArray[np.bool_] = np.all((ends >= 0.0) & (ends <= size), axis=1)
    found: npt.NDArray[np.bool_] = on_map[:len(a)] & on_map[len(a):]
    if found.any():
        tails, heads = ends.reshape(2, -1, 2)[:, found]
        corner, part = _part(newest, occupancy, np.concatenate((tails, heads)), network.clearance)
        found[found] = ObstacleField(part, network.clear_of_edge).clear_segments(
            tails - corner, heads - corner, network.clearance)
    return found


def drivable_steps(points: FloatArray, newest: OccupancyMap, occupancy: OccupancyOptions,
                   network: NetworkOptions) -> npt.NDArray[np.bool_]:
    """Which steps (L - 1,) a convoy at the first of the ``points`` (L, 2) [m] can drive on a map.

    They keep the network's clearance, except for the first ``WAY_OUT``: the convoy may have strayed
    from its path. If it stands in an obstacle, it may leave that.
    """
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))[:-1]
    later, at = int(np.searchsorted(along, WAY_OUT)), points[:1]
    no_clearance = replace(network, clearance=0.0)
    near = clear_steps(points[:later + 1], newest, occupancy, no_clearance)
    if not clear_segments(at, at, newest, occupancy, no_clearance)[0]:
        near[:int(near.argmax())] = True
    return np.append(near, clear_steps(points[later:], newest, occupancy, network))


def clear_steps(points: FloatArray, newest: OccupancyMap, occupancy: OccupancyOptions,
                network: NetworkOptions) -> npt.NDArray[np.bool_]:
    """Which steps (L - 1,) of a path with ``points`` (L, 2) [m] keep the clearance on a map."""
    steps = np.arange(len(points) - 1)
    pieces = np.array_split(steps, max(1, math.ceil(len(steps) / _PIECE)))
    return np.concatenate([clear_segments(points[piece], points[piece + 1], newest, occupancy,
                                          network) for piece in pieces])


def has_arrived(start: tuple[float, float], goal: tuple[float, float], newest: OccupancyMap,
                occupancy: OccupancyOptions, network: NetworkOptions) -> bool:
    """Whether a start is within a cell of the goal, which is clear."""
    at = np.array([goal])
    return (math.dist(start, goal) <= newest.resolution
            and bool(clear_segments(at, at, newest, occupancy, network)[0]))


def way_out(place: tuple[float, float], newest: OccupancyMap, occupancy: OccupancyOptions,
            network: NetworkOptions) -> tuple[float, float]:
    """The nearest clear place within ``WAY_OUT`` of a convoy in a costmap's inflation [m].

    The straight way there meets no cell of 100, which the convoy cannot drive through, other than
    its own. Returns ``place`` if it is clear, or if there is no such way.
    """
    uv = _map_axes(newest, np.array([place]))
    if not ((uv >= 0.0) & (uv < np.multiply(newest.values.shape[::-1], newest.resolution))).all():
        return place  # off the map
    corner, part = _part(newest, occupancy, uv, WAY_OUT + network.clearance)
    at, field = uv - corner, ObstacleField(part, network.clear_of_edge)
    if field.clear_points(at, network.clearance)[0]:
        return place
    _, hard = _part(newest, replace(occupancy, obstacle_threshold=100), uv,
                    WAY_OUT + network.clearance)
    lethal = hard.obstacles.copy()
    lethal[hard.cells(at[0])] = False
    centres = np.multiply(np.argwhere(~part.obstacles)[:, ::-1] + 0.5, newest.resolution)
    away = np.hypot(*(centres - at).T)
    near = centres[np.argsort(away, kind='stable')[:int((away <= WAY_OUT).sum())]]
    straight = ObstacleField(replace(hard, obstacles=lethal), False).clear_segments(
        np.repeat(at, len(near), axis=0), near, 0.0)
    found = near[straight & field.clear_points(near, network.clearance)]
    if not len(found):
        return place
    x, y = to_world(newest.origin, found[0] + corner).tolist()
    return x, y


def _part(grid: OccupancyMap, occupancy: OccupancyOptions, uv: FloatArray,
          reach: float) -> tuple[FloatArray, RiskMap]:
    """Return the lower left corner of the map within ``reach`` of positions, and that map."""
    step = grid.resolution
    margin = math.ceil(reach / step) + _MARGIN
    low = np.maximum(np.floor(uv.min(axis=0) / step).astype(np.int64) - margin, 0)
    high = np.floor(uv.max(axis=0) / step).astype(np.int64) + margin + 1
    values = grid.values[low[1]:high[1], low[0]:high[0]]
    return low * step, risk_map_from_occupancy(values, step, (0.0, 0.0, 0.0), occupancy)


@dataclass(eq=False)
class Comparison:
    """The newest map compared with the one planned on, and the plan's assessment there.

    ``new_obstacles`` (K, 2) are centres of cells [m] in map axes; the lost edges are a mask (M,)
    and pairs (tail, head); ``alpha`` (N,) are the nodes' losses now.
    """

    newest: OccupancyMap
    new_obstacles: FloatArray
    lost: npt.NDArray[np.bool_]
    lost_pairs: frozenset[tuple[int, ...]]
    alpha: FloatArray
    corridors: Corridors | None = None
    assessment: Assessment | None = None


class _Segments:
    """Segments a -> b, both (K, 2), indexed by position."""

    def __init__(self, a: FloatArray, b: FloatArray) -> None:
        self._a, self._b = a, b
        self._middles = cKDTree((a + b) / 2) if len(a) else None
        self._half = float(np.hypot(*(b - a).T).max(initial=0.0)) / 2

    def met(self, places: FloatArray, distance: float) -> IndexArray:
        """Return the segments that come within ``distance`` of one of the places (K, 2)."""
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
    unknown = (values == -1) & (options.unknown_alpha is None)
    found: npt.NDArray[np.bool_] = (values >= options.obstacle_threshold) | unknown
    return found


def _map_axes(grid: OccupancyMap, points: FloatArray) -> FloatArray:
    """Return world positions (K, 2) in map axes [m], with the rounding of ``RiskMap``."""
    empty = RiskMap(np.zeros((1, 1)), np.zeros((1, 1), bool), grid.resolution, grid.origin)
    return empty.to_map_axes(points)
