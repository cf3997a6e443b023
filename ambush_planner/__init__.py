"""Random routes for convoys that somebody may be waiting for: the ambush game on a risk map."""

from .core.batch import Problem, Solved, solve_many
from .core.construction import NetworkOptions, build_network
from .core.day import DayEffect, day_effect, sample_departures
from .core.errors import (
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
from .core.evaluation import evaluate
from .core.frontier import FrontierRow, frontier
from .core.game import GameOptions
from .core.network import Network
from .core.planner import PlanningOptions
from .core.risk_map import RiskMap
from .core.strategy import Strategy, StrategyOptions, solve
from .core.trip import plan_trip

__all__ = [
    'AmbushPlannerError',
    'BudgetInfeasible',
    'DayEffect',
    'FrontierRow',
    'GameOptions',
    'GoalBlocked',
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
    'plan_trip',
    'solve',
    'solve_many',
]
