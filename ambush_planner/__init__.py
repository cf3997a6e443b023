"""Random routes for convoys that somebody may be waiting for: the ambush game on a risk map."""

from .errors import (
    AmbushPlannerError,
    BudgetInfeasible,
    GoalBlocked,
    InvalidNetwork,
    InvalidOption,
    InvalidRiskMap,
    NoRoute,
    NotDistinct,
    SolverFailed,
    StartBlocked,
    StopBlocked,
    TimeLimit,
)
from .game.game import GameOptions
from .game.strategy import Strategy, StrategyOptions, solve
from .maps.risk_map import RiskMap
from .network.construction import NetworkOptions, build_network
from .network.network import Network
from .planning.evaluation import evaluate
from .planning.frontier import FrontierRow, frontier, trip_frontier
from .planning.holding import Held, Holding, places_to_hold
from .planning.many import Problem, Solved, solve_many
from .planning.options import PlanningOptions
from .planning.trip import plan_trip
from .routes.days import DayEffect, day_effect, sample_departures

__all__ = [
    'AmbushPlannerError',
    'BudgetInfeasible',
    'DayEffect',
    'FrontierRow',
    'GameOptions',
    'GoalBlocked',
    'Held',
    'Holding',
    'InvalidNetwork',
    'InvalidOption',
    'InvalidRiskMap',
    'Network',
    'NetworkOptions',
    'NoRoute',
    'NotDistinct',
    'PlanningOptions',
    'Problem',
    'RiskMap',
    'Solved',
    'SolverFailed',
    'StartBlocked',
    'StopBlocked',
    'Strategy',
    'StrategyOptions',
    'TimeLimit',
    'build_network',
    'day_effect',
    'evaluate',
    'frontier',
    'sample_departures',
    'places_to_hold',
    'plan_trip',
    'solve',
    'solve_many',
    'trip_frontier',
]
