"""The story on one page: a risk map becomes a plan once, and a plan becomes a route each time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .arrays import frozen_array
from .bottleneck import Bottleneck, find_bottleneck
from .construction import NetworkOptions, build_network
from .game import GameOptions
from .network import IndexArray, Network
from .risk_map import FloatArray, RiskMap
from .strategy import Strategy, StrategyOptions, solve


@dataclass(frozen=True)
class PlanningOptions:
    """All options of a plan: how the network is laid, what the game is, which optimum is taken."""

    network: NetworkOptions = field(default_factory=NetworkOptions)
    game: GameOptions = field(default_factory=GameOptions)
    strategy: StrategyOptions = field(default_factory=StrategyOptions)


@dataclass(frozen=True, eq=False)
class Plan:
    """What is worked out once for a map, a start and a goal; ``seconds`` says how long it took.

    ``bottleneck`` tells which sites decide the strategy's value.
    """

    risk_map: RiskMap
    network: Network
    strategy: Strategy
    bottleneck: Bottleneck
    seconds: float


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
    strategy = solve(network, options.game, options.strategy)
    bottleneck = find_bottleneck(strategy)
    return Plan(risk_map, network, strategy, bottleneck, time.monotonic() - begin)


def depart(a_plan: Plan, rng: np.random.Generator) -> Route:
    """Draw the route of one departure."""
    nodes = a_plan.strategy.sample_route(rng)
    return Route(frozen_array(nodes, np.int64), frozen_array(a_plan.network.points[nodes], float))
