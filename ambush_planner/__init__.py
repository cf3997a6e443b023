"""Random routes for convoys that somebody may be waiting for: the ambush game on a risk map."""

from .errors import (
    AmbushPlannerError,
    BudgetInfeasible,
    GoalBlocked,
    InvalidNetwork,
    InvalidOption,
    InvalidRiskMap,
    NoRoute,
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
from .planning.many import Problem, Solved, solve_many
from .planning.options import PlanningOptions
from .planning.trip import plan_trip

__all__ = [
    'AmbushPlannerError',
    'BudgetInfeasible',
    'FrontierRow',
    'GameOptions',
    'GoalBlocked',
    'InvalidNetwork',
    'InvalidOption',
    'InvalidRiskMap',
    'Network',
    'NetworkOptions',
    'NoRoute',
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
    'evaluate',
    'frontier',
    'plan_trip',
    'solve',
    'solve_many',
    'trip_frontier',
]
