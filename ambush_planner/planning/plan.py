"""The story on one page: a risk map becomes a plan once, and a plan becomes a route each time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import TimeLimit
from ..game.bottleneck import Bottleneck, find_bottleneck
from ..game.game import GameOptions
from ..game.revaluation import open_gap
from ..game.strategy import Strategy, StrategyOptions, solve
from ..game.strategy_solver import Multipliers
from ..maps.obstacles import nearest_free_cell
from ..maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ..maps.risk_map import RiskMap
from ..network.construction import NetworkOptions, build_network, chosen_spacing
from ..network.hiding_places import with_hiding_places
from ..network.network import Network
from ..option_checks import check_at_least
from ..routes.corridors import Corridors, make_corridors
from ..routes.driven_path import Ends, different_paths, driven_path, driven_paths

# Tube with a reach, in distances of nodes.
DEFAULT_TUBE = 0.35
# Routes that are drawn to count their different paths.
DRAWN = 1000


@dataclass(frozen=True)
class DriveOptions:
    """How a drawn route becomes the path that is driven.

    Parameters
    ----------
    tube
        Largest distance of the path from the drawn route [m]. The game is solved with this much
        more reach, so that its certificate covers what is driven. None: without a reach, as far as
        the path meets no node that its route does not use, so the game stays the plain one; with
        a reach, ``DEFAULT_TUBE`` spacings.
    turning_radius
        Turns are at least this wide [m] where the corridors leave the room for it.

    Raises
    ------
    InvalidOption
        A value is out of range or of another type.
    """

    tube: float | None = None
    turning_radius: float = 0.0

    def __post_init__(self) -> None:
        if self.tube is not None:
            check_at_least('tube', self.tube, 0.0, 'm')
        check_at_least('turning_radius', self.turning_radius, 0.0, 'm')


@dataclass(frozen=True)
class PlanningOptions:
    """All options of a plan: how the network is laid, what the game is, which optimum is taken.

    Where the time limit passes, the strategy that was reached is taken if no other one can be
    better by more than ``max_gap`` of its value, beyond the risk slack.
    """

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)
    max_gap: float = 0.1

    def __post_init__(self) -> None:
        check_at_least('max_gap', self.max_gap, 0.0, finite=False)


@dataclass(frozen=True, eq=False)
class WarmStart:
    """The law of a strategy on other ground, and where its nodes (N, 2) are [m]."""

    points: FloatArray
    multipliers: Multipliers

    def on(self, network: Network) -> Multipliers:
        """The law with each site's multiplier taken from the node that was nearest."""
        if np.array_equal(self.points, network.points):
            return self.multipliers
        _, nearest = cKDTree(self.points).query(network.points)
        sites = frozen_array(self.multipliers.sites[nearest], np.float64)
        return Multipliers(sites, self.multipliers.budgets)


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """Everything that a plan follows from.

    Parameters
    ----------
    values : (H, W) int8, resolution, origin
        An occupancy grid, as ``risk_map_from_occupancy`` takes it.
    occupancy
        How its values are read as losses.
    start_xy, goal_xy
        World positions [m].
    goal_tolerance
        How far a goal in an obstacle may be moved [m].
    options
        Network, game and strategy.
    stops_xy, order
        Where to go by, as ``plan_trip`` takes them [m].
    warm
        Where the search for the strategy starts, if anything like it is known.
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
    """What is worked out once for a map, a start and a goal; ``seconds`` says how long it took.

    ``options`` are what it was worked out with.

    ``bottleneck`` tells which sites decide the strategy's value. ``corridors`` are the room beside
    the routes that the driven path may use. ``spacing`` is the distance of nodes that the network
    was made with, but no less than the map's resolution [m]. ``different_paths`` is how many
    different ones ``DRAWN`` routes make, at most; None: there was no time to count. ``order`` are
    the indices of the stops of a trip as they are visited, and ``order_found`` tells how: 'given',
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
        """How far paths may leave the drawn route [m]; None: as far as no other node is met."""
        return _tube(self.options, self.spacing)

    @property
    def goal_xy(self) -> tuple[float, float]:
        """Where the routes end [m]: the goal that was asked for, or where it was moved to."""
        x, y = self.network.points[self.network.target].tolist()
        return x, y


@dataclass(frozen=True, eq=False)
class Route:
    """One departure's drawn route: node indices (K,) and their world positions (K, 2) [m]."""

    nodes: IndexArray
    points: FloatArray


def plan(
    risk_map: RiskMap,
    start_xy: npt.ArrayLike,
    goal_xy: npt.ArrayLike,
    options: PlanningOptions | None = None,
    warm: WarmStart | None = None,
) -> Plan:
    """Build the network and solve the game; raises what ``build_network`` and ``solve`` raise."""
    options = options or PlanningOptions()
    begin = time.monotonic()
    network = build_network(risk_map, start_xy, goal_xy, options.network)
    return replace(plan_on_network(risk_map, network, options, warm), seconds=time.monotonic() - begin)


def plan_on_network(
    risk_map: RiskMap, network: Network, options: PlanningOptions, warm: WarmStart | None = None
) -> Plan:
    """Solve the game on a network that was built on the map; raises what ``solve`` raises."""
    begin = time.monotonic()
    return make_plan(risk_map, solve_on_network(risk_map, network, options, warm), options, begin)


def solve_on_network(
    risk_map: RiskMap, network: Network, options: PlanningOptions, warm: WarmStart | None = None
) -> Strategy:
    """Solve the game on a network; raises what ``solve`` raises."""
    network = add_hiding_places(network, risk_map, options)
    start = warm.on(network) if warm else None
    return _solve_within_max_gap(network, options, reach(risk_map, options), start)


def make_plan(
    risk_map: RiskMap, strategy: Strategy, options: PlanningOptions, begin: float
) -> Plan:
    """What else a plan tells of its strategy; ``begin`` is when the work on it began."""
    spacing = node_spacing(risk_map, options.network)
    tube = _tube(options, spacing)
    bottleneck = find_bottleneck(strategy, begin + options.strategy.time_limit)
    corridors = make_corridors(
        strategy.network, risk_map, options.network.clearance, tube, options.network.clear_of_edge
    )
    different = None
    if time.monotonic() < begin + options.strategy.time_limit:
        # Always of the same draws: the count tells nothing of what is drawn later.
        drawn = strategy.sample_routes(DRAWN, np.random.default_rng(0))
        different = different_paths(corridors, drawn)
    seconds = time.monotonic() - begin
    return Plan(
        strategy.network, strategy, bottleneck, corridors, options, spacing, different, seconds
    )


def _solve_within_max_gap(
    network: Network, options: PlanningOptions, radius: float, start: Multipliers | None
) -> Strategy:
    """The strategy for the reach ``radius`` [m], or what was reached if that is good enough."""
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
        raise TimeLimit(
            f'the strategy that was found in {options.strategy.time_limit:g} s may be '
            f'{gap / strategy.value:.2g} of its value from the best, more than max_gap, '
            f'{options.max_gap:g}; allow more time, or choose a larger spacing',
            strategy,
        ) from late


def reach(risk_map: RiskMap, options: PlanningOptions) -> float:
    """How far an ambush reaches from its site in the game that is solved [m]: with the tube."""
    tube = _tube(options, node_spacing(risk_map, options.network))
    return options.game.ambush_radius + (tube or 0.0)


def add_hiding_places(network: Network, risk_map: RiskMap, options: PlanningOptions) -> Network:
    """The network with the obstacle cells in which an ambusher can hide, if the game has them."""
    radius = reach(risk_map, options)
    if not options.game.ambush_in_obstacles or radius == 0.0:
        return network
    spacing = node_spacing(risk_map, options.network)
    return with_hiding_places(network, risk_map, radius, spacing)


def _tube(options: PlanningOptions, spacing: float) -> float | None:
    """The tube in use [m]; None for the one that leaves the plain game as it is."""
    if options.drive.tube is None and options.game.ambush_radius > 0.0:
        return DEFAULT_TUBE * spacing
    return options.drive.tube


def node_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """The distance of nodes, but no less than the map's resolution [m]."""
    return max(risk_map.resolution, chosen_spacing(risk_map, options))


def risk_map_and_goal(request: PlanRequest) -> tuple[RiskMap, tuple[float, float]]:
    """Return the risk map, and the goal moved as far as it has to be and may be [m].

    Raises
    ------
    InvalidRiskMap
        The map is malformed.
    """
    risk_map = risk_map_from_occupancy(
        request.values, request.resolution, request.origin, request.occupancy
    )
    network = request.options.network
    return risk_map, nearest_free_cell(
        risk_map, request.goal_xy, request.goal_tolerance, network.clearance, network.clear_of_edge
    )


def depart(a_plan: Plan, rng: np.random.Generator) -> Route:
    """Draw the route of one departure."""
    nodes = a_plan.strategy.sample_route(rng)
    return Route(frozen_array(nodes, np.int64), frozen_array(a_plan.network.points[nodes], float))


def departure_path(
    a_plan: Plan, route: Route, spacing: float, ends: Ends | None = None
) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the path that is driven, at most ``spacing`` [m] apart.

    ``ends`` are start and goal [m] where the plan's corridors lead from and to these.

    Raises
    ------
    InvalidOption
        That would be more than ``MOST_POSES``.
    """
    radius = a_plan.options.drive.turning_radius
    return driven_path(a_plan.corridors, route.nodes, spacing, radius, ends)


def departure_paths(
    a_plan: Plan, n: int, spacing: float, rng: np.random.Generator
) -> list[FloatArray]:
    """Draw ``n`` departures and return their paths, as ``departure_path`` does."""
    routes = a_plan.strategy.sample_routes(n, rng)
    return driven_paths(a_plan.corridors, routes, spacing, a_plan.options.drive.turning_radius)
