"""Requests and plans: a risk map becomes a plan once, and a plan gives a route per departure."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption, TimeLimit
from ..game.bottleneck import Bottleneck, find_bottleneck
from ..game.game import GameOptions
from ..game.revaluation import open_gap
from ..game.strategy import Strategy, StrategyOptions, solve
from ..game.strategy_solver import Multipliers
from ..maps.obstacles import nearest_free_cell
from ..maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, chosen_spacing
from ..network.hiding_places import with_hiding_places
from ..network.network import Network
from ..option_checks import check_at_least
from ..routes.corridors import Corridors, make_corridors
from ..routes.driven_path import Ends, different_paths, driven_path, driven_paths

# Default tube if the game has a reach, in node spacings.
DEFAULT_TUBE = 0.35
# Number of routes drawn to count the different paths.
DRAWN = 1000


@dataclass(frozen=True)
class DriveOptions:
    """Options that turn a drawn route into the driven path; raises InvalidOption.

    Parameters
    ----------
    tube
        Largest distance of the path from the drawn route [m]. It is added to the reach of the
        game, so that the certificate covers the driven path. None: with a reach, ``DEFAULT_TUBE``
        spacings; without one, the path only avoids nodes that its route does not use.
    turning_radius
        Least radius of turns [m], if the corridors have enough room.
    tracking_error
        Largest distance of the robot from the path [m], added to the reach like the tube. Only for
        games with a reach.
    """

    tube: float | None = None
    turning_radius: float = 0.0
    tracking_error: float = 0.0

    def __post_init__(self) -> None:
        if self.tube is not None:
            check_at_least('tube', self.tube, 0.0, 'm')
        check_at_least('turning_radius', self.turning_radius, 0.0, 'm')
        check_at_least('tracking_error', self.tracking_error, 0.0, 'm')


@dataclass(frozen=True)
class PlanningOptions:
    """All options of a plan.

    If the time limit passes, a strategy is still accepted whose gap beyond the risk slack is at
    most ``max_gap`` times its value.
    """

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)
    max_gap: float = 0.1

    def __post_init__(self) -> None:
        check_at_least('max_gap', self.max_gap, 0.0, finite=False)
        if self.drive.tracking_error > 0.0 and not self.game.ambush_radius > 0.0:
            raise InvalidOption(f'route.tracking_error {self.drive.tracking_error} is added to the '
                                'reach of ambushes, so game.ambush_radius must be over 0 [m]')


@dataclass(frozen=True, eq=False)
class WarmStart:
    """The multipliers of another strategy, and its nodes' positions ``points`` (N, 2) [m]."""

    points: FloatArray
    multipliers: Multipliers

    def on(self, network: Network) -> Multipliers:
        """The multipliers for another network: each site's from the nearest node."""
        if np.array_equal(self.points, network.points):
            return self.multipliers
        _, nearest = cKDTree(self.points).query(network.points)
        sites = frozen_array(self.multipliers.sites[nearest], np.float64)
        return Multipliers(sites, self.multipliers.budgets)


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """All inputs of a plan.

    Parameters
    ----------
    values : (H, W) int8, resolution, origin
        An occupancy grid, as ``risk_map_from_occupancy`` takes it.
    occupancy
        The conversion of its values to losses.
    start_xy, goal_xy
        World positions [m].
    goal_tolerance
        How far a goal in an obstacle may be moved [m].
    options
        Network, game and strategy.
    stops_xy, order
        Stops [m] and their order, as ``plan_trip`` takes them.
    warm
        A similar strategy to start the search from.
    """

    values: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    occupancy: OccupancyOptions
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float
    options: PlanningOptions
    stops_xy: tuple[tuple[float, float], ...] = ()
    order: str = 'given'
    warm: WarmStart | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """The strategy for a map, a start and a goal, with all that departures need.

    ``corridors`` is the space around the routes that the driven path may use. ``spacing`` is the
    distance of the network's nodes, at least the map's resolution [m]. ``different_paths`` counts
    those of ``DRAWN`` routes; None: the time limit had passed. ``seconds`` is the planning time.
    ``order`` has the indices of a trip's stops as they are visited, and ``order_found`` is 'given',
    'best' or 'heuristic'.
    """

    network: Network
    strategy: Strategy
    bottleneck: Bottleneck
    corridors: Corridors
    options: PlanningOptions
    spacing: float
    different_paths: int | None
    seconds: float
    order: tuple[int, ...] = ()
    order_found: str = 'given'

    @property
    def stops_xy(self) -> tuple[tuple[float, float], ...]:
        """The stops as they are visited [m]."""
        stops = self.network.points[self.network.stops].tolist()
        return tuple((x, y) for x, y in stops)

    @property
    def tube(self) -> float | None:
        """Largest distance of paths from the drawn route [m]; None: they avoid other nodes."""
        return _tube(self.options, self.spacing)

    @property
    def goal_xy(self) -> tuple[float, float]:
        """End of the routes [m]: the requested goal, or where it was moved to."""
        x, y = self.network.points[self.network.target].tolist()
        return x, y


@dataclass(frozen=True, eq=False)
class Route:
    """One departure's drawn route: node indices (K,) and their world positions (K, 2) [m]."""

    nodes: IndexArray
    points: FloatArray


def solve_on_network(risk_map: RiskMap, network: Network, options: PlanningOptions,
                     warm: WarmStart | None = None) -> Strategy:
    """Solve the game on a network built on the map; raises the errors of ``solve``."""
    network = add_hiding_places(network, risk_map, options)
    start = warm.on(network) if warm else None
    return _solve_within_max_gap(network, options, reach(risk_map, options), start)


def make_plan(risk_map: RiskMap, strategy: Strategy, options: PlanningOptions,
              begin: float) -> Plan:
    """Complete a plan from its strategy; ``begin`` [s] is when planning began."""
    spacing = node_spacing(risk_map, options.network)
    tube = _tube(options, spacing)
    bottleneck = find_bottleneck(strategy, begin + options.strategy.time_limit)
    corridors = make_corridors(strategy.network, risk_map, options.network.clearance, tube,
                               options.network.clear_of_edge)
    different = None
    if time.monotonic() < begin + options.strategy.time_limit:
        # A fixed seed keeps the count independent of the departures' draws.
        drawn = strategy.sample_routes(DRAWN, np.random.default_rng(0))
        different = different_paths(corridors, drawn)
    return Plan(strategy.network, strategy, bottleneck, corridors, options, spacing, different,
                time.monotonic() - begin)


def _solve_within_max_gap(network: Network, options: PlanningOptions, radius: float,
                          start: Multipliers | None) -> Strategy:
    """The strategy for the reach ``radius`` [m]; at the time limit, one within ``max_gap``."""
    game = replace(options.game, ambush_radius=radius)
    try:
        return solve(network, game, options.strategy, start)
    except TimeLimit as late:
        strategy = late.strategy
        if strategy is None:
            raise
        gap = open_gap(strategy, options.strategy)
        if gap <= options.max_gap * strategy.value:
            return strategy
        raise TimeLimit(f'after {options.strategy.time_limit:g} s the strategy may be '
                        f'{gap / strategy.value:.2g} of its value from the best, more than max_gap '
                        f'{options.max_gap:g}; allow more time, or choose a larger spacing',
                        strategy) from late


def reach(risk_map: RiskMap, options: PlanningOptions) -> float:
    """The reach of an ambush in the solved game [m]: radius, tube and tracking error."""
    tube = _tube(options, node_spacing(risk_map, options.network))
    return options.game.ambush_radius + (tube or 0.0) + options.drive.tracking_error


def add_hiding_places(network: Network, risk_map: RiskMap, options: PlanningOptions) -> Network:
    """Add the obstacle cells in which an ambusher can hide, if the game includes them."""
    radius = reach(risk_map, options)
    if not options.game.ambush_in_obstacles or radius == 0.0:
        return network
    spacing = node_spacing(risk_map, options.network)
    return with_hiding_places(network, risk_map, radius, spacing)


def _tube(options: PlanningOptions, spacing: float) -> float | None:
    """The tube [m]; None if the game stays the plain one."""
    if options.drive.tube is None and options.game.ambush_radius > 0.0:
        return DEFAULT_TUBE * spacing
    return options.drive.tube


def node_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """The distance of nodes, at least the map's resolution [m]."""
    return max(risk_map.resolution, chosen_spacing(risk_map, options))


def risk_map_and_goal(request: PlanRequest) -> tuple[RiskMap, tuple[float, float]]:
    """The risk map and the goal, moved off obstacles within the tolerance [m].

    Raises InvalidRiskMap if the map is malformed.
    """
    risk_map = risk_map_from_occupancy(request.values, request.resolution, request.origin,
                                       request.occupancy)
    network = request.options.network
    return risk_map, nearest_free_cell(risk_map, request.goal_xy, request.goal_tolerance,
                                       network.clearance, network.clear_of_edge)


def depart(a_plan: Plan, rng: np.random.Generator) -> Route:
    """Draw the route of one departure."""
    nodes = a_plan.strategy.sample_route(rng)
    return Route(frozen_array(nodes, np.int64), frozen_array(a_plan.network.points[nodes], float))


def departure_path(a_plan: Plan, route: Route, spacing: float,
                   ends: Ends | None = None) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the driven path, at most ``spacing`` [m] apart.

    ``ends`` are start and goal [m] if they differ from the route's. Raises InvalidOption if there
    would be more than ``MOST_POSES``.
    """
    radius = a_plan.options.drive.turning_radius
    return driven_path(a_plan.corridors, route.nodes, spacing, radius, ends)


def departure_paths(a_plan: Plan, n: int, spacing: float,
                    rng: np.random.Generator) -> list[FloatArray]:
    """Draw ``n`` departures and return their paths, as ``departure_path`` does."""
    routes = a_plan.strategy.sample_routes(n, rng)
    return driven_paths(a_plan.corridors, routes, spacing, a_plan.options.drive.turning_radius)
