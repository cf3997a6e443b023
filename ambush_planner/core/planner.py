"""The story on one page: a risk map becomes a plan once, and a plan becomes a route each time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray, IndexArray, frozen_array
from .bottleneck import Bottleneck, find_bottleneck
from .construction import NetworkOptions, build_network, chosen_spacing
from .corridors import Corridors, make_corridors
from .cover import with_hiding_places
from .driven_path import driven_path, driven_paths
from .game import GameOptions
from .network import Network
from .obstacles import nearest_free_cell
from .options import check_at_least
from .risk_map import OccupancyOptions, RiskMap, risk_map_from_occupancy
from .strategy import Strategy, StrategyOptions, solve

# Tube with a reach, in distances of nodes.
DEFAULT_TUBE = 0.35


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
            check_at_least("tube", self.tube, 0.0, "m")
        check_at_least("turning_radius", self.turning_radius, 0.0, "m")


@dataclass(frozen=True)
class PlanningOptions:
    """All options of a plan: how the network is laid, what the game is, which optimum is taken."""

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)
    drive: DriveOptions = field(default_factory=DriveOptions)


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
    """

    values: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    occupancy: OccupancyOptions
    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    goal_tolerance: float
    options: PlanningOptions


@dataclass(frozen=True, eq=False)
class Plan:
    """What is worked out once for a map, a start and a goal; ``seconds`` says how long it took.

    ``bottleneck`` tells which sites decide the strategy's value. ``corridors`` are the room beside
    the routes that the driven path may use. ``spacing`` is the distance of nodes that the network
    was made with, but no less than the map's resolution [m].
    """

    network: Network
    strategy: Strategy
    bottleneck: Bottleneck
    corridors: Corridors
    drive: DriveOptions
    spacing: float
    seconds: float

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
) -> Plan:
    """Build the network and solve the game; raises what ``build_network`` and ``solve`` raise."""
    options = options or PlanningOptions()
    begin = time.monotonic()
    network = build_network(risk_map, start_xy, goal_xy, options.network)
    return replace(plan_on(risk_map, network, options), seconds=time.monotonic() - begin)


def plan_on(risk_map: RiskMap, network: Network, options: PlanningOptions) -> Plan:
    """Solve the game on a network that was built on the map; raises what ``solve`` raises."""
    begin = time.monotonic()
    spacing = node_spacing(risk_map, options.network)
    tube = _tube(options, spacing)
    reach = options.game.ambush_radius + (tube or 0.0)
    if options.game.ambush_in_obstacles and reach > 0.0:
        network = with_hiding_places(network, risk_map, reach, spacing)
    strategy = solve(network, replace(options.game, ambush_radius=reach), options.strategy)
    bottleneck = find_bottleneck(strategy, begin + options.strategy.time_limit)
    corridors = make_corridors(
        strategy.network, risk_map, options.network.clearance, tube, options.network.clear_of_edge
    )
    seconds = time.monotonic() - begin
    return Plan(
        strategy.network, strategy, bottleneck, corridors, options.drive, spacing, seconds
    )


def _tube(options: PlanningOptions, spacing: float) -> float | None:
    """The tube in use [m]; None for the one that leaves the plain game as it is."""
    if options.drive.tube is None and options.game.ambush_radius > 0.0:
        return DEFAULT_TUBE * spacing
    return options.drive.tube


def node_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """The distance of nodes, but no less than the map's resolution [m]."""
    return max(risk_map.resolution, chosen_spacing(risk_map, options))


def plan_from_request(request: PlanRequest) -> Plan:
    """Read the map, move a blocked goal as far as it may be, and plan.

    Raises
    ------
    InvalidRiskMap
        The map is malformed. All else as ``plan`` raises it.
    """
    risk_map, goal_xy = read_request(request)
    return plan(risk_map, request.start_xy, goal_xy, request.options)


def read_request(request: PlanRequest) -> tuple[RiskMap, tuple[float, float]]:
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


def departure_path(a_plan: Plan, route: Route, spacing: float) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the path that is driven, at most ``spacing`` [m] apart.

    Raises
    ------
    InvalidOption
        That would be more than ``MOST_POSES``.
    """
    return driven_path(a_plan.corridors, route.nodes, spacing, a_plan.drive.turning_radius)


def departure_paths(
    a_plan: Plan, n: int, spacing: float, rng: np.random.Generator
) -> list[FloatArray]:
    """Draw ``n`` departures and return their paths, as ``departure_path`` does."""
    routes = a_plan.strategy.sample_routes(n, rng)
    return driven_paths(a_plan.corridors, routes, spacing, a_plan.drive.turning_radius)
