# SPDX-License-Identifier: Apache-2.0
"""All public names of the package."""

from .errors import (
    AmbushPlannerError,
    AmbushPlannerWarning,
    BudgetInfeasible,
    GoalBlocked,
    GoalOutsideMap,
    InvalidCoordinates,
    InvalidNetwork,
    InvalidOption,
    InvalidPose,
    InvalidRiskMap,
    NoRoute,
    SolverFailed,
    StartBlocked,
    StartOutsideMap,
    StopBlocked,
    StopOutsideMap,
    TimeLimit,
)
from .game.game import GameOptions
from .game.solver import solve
from .game.strategy import Strategy, StrategyOptions
from .maps.coordinates import Coordinates
from .maps.elevation import InvalidTerrain
from .maps.occupancy import OccupancyOptions, risk_from_occupancy
from .maps.risk_layers import InvalidLayers
from .maps.risk_map import RiskMap
from .maps.risk_map_file import read_risk_map
from .maps.tables import InvalidFeatures
from .maps.terrain_risk import risk_from_terrain
from .network.construction import NetworkOptions, build_network
from .network.network import Network
from .operations.frontier import FrontierRow, frontier
from .operations.hold import Held, Holding, places_to_hold
from .operations.many import Problem, Solved, solve_many
from .planning.evaluation import evaluate
from .planning.options import DriveOptions, PlanningOptions
from .planning.plan import Plan
from .planning.trip import plan_trip

__all__ = [
    'AmbushPlannerError',
    'AmbushPlannerWarning',
    'BudgetInfeasible',
    'Coordinates',
    'DriveOptions',
    'FrontierRow',
    'GameOptions',
    'GoalBlocked',
    'GoalOutsideMap',
    'Held',
    'Holding',
    'InvalidCoordinates',
    'InvalidFeatures',
    'InvalidLayers',
    'InvalidNetwork',
    'InvalidOption',
    'InvalidPose',
    'InvalidRiskMap',
    'InvalidTerrain',
    'Network',
    'NetworkOptions',
    'NoRoute',
    'OccupancyOptions',
    'Plan',
    'PlanningOptions',
    'Problem',
    'RiskMap',
    'Solved',
    'SolverFailed',
    'StartBlocked',
    'StartOutsideMap',
    'StopBlocked',
    'StopOutsideMap',
    'Strategy',
    'StrategyOptions',
    'TimeLimit',
    'build_network',
    'evaluate',
    'frontier',
    'places_to_hold',
    'plan_trip',
    'read_risk_map',
    'risk_from_occupancy',
    'risk_from_terrain',
    'solve',
    'solve_many',
]
