"""The story on one page: a risk map becomes a plan once, and a plan becomes a route each time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from .arrays import frozen_array
from .bottleneck import Bottleneck, find_bottleneck
from .construction import NetworkOptions, build_network, chosen_spacing
from .game import GameOptions
from .network import IndexArray, Network
from .obstacles import nearest_free_cell
from .risk_map import FloatArray, OccupancyOptions, RiskMap, risk_map_from_occupancy
from .strategy import Strategy, StrategyOptions, solve


@dataclass(frozen=True)
class PlanningOptions:
    """All options of a plan: how the network is laid, what the game is, which optimum is taken."""

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)


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

    ``bottleneck`` tells which sites decide the strategy's value. ``spacing`` is the distance of
    nodes that the network was made with, but no less than the map's resolution [m].
    """

    network: Network
    strategy: Strategy
    bottleneck: Bottleneck
    spacing: float
    seconds: float

    @property
    def goal_xy(self) -> tuple[float, float]:
        """Where the routes end [m]: the goal that was asked for, or where it was moved to."""
        x, y = self.network.points[self.network.target].tolist()
        return x, y


@dataclass(frozen=True, eq=False)
class Route:
    """One departure's route: node indices (K,) and their world positions (K, 2) [m]."""

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
    strategy = solve(network, options.game, options.strategy)
    bottleneck = find_bottleneck(strategy)
    spacing = node_spacing(risk_map, options.network)
    return Plan(network, strategy, bottleneck, spacing, time.monotonic() - begin)


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
    clearance = request.options.network.clearance
    return risk_map, nearest_free_cell(
        risk_map, request.goal_xy, request.goal_tolerance, clearance
    )


def depart(a_plan: Plan, rng: np.random.Generator) -> Route:
    """Draw the route of one departure."""
    nodes = a_plan.strategy.sample_route(rng)
    return Route(frozen_array(nodes, np.int64), frozen_array(a_plan.network.points[nodes], float))
