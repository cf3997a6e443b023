"""Errors of requests, and the codes of all errors in the diagnostics.

Codes have the names of the constants of Nav2's ``ComputePathToPose`` if it has one.
"""

from __future__ import annotations

from ..errors import (
    AmbushPlannerError,
    BudgetInfeasible,
    GoalBlocked,
    GoalOutsideMap,
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
from ..recordings import RecordingFailed
from ..worker.solve_errors import QueueFull, SolveCancelled, WorkerFailed


class NoMap(AmbushPlannerError):
    """No risk map has arrived."""


class NoStart(AmbushPlannerError):
    """No start has arrived."""


class NoGoal(AmbushPlannerError):
    """No goal has arrived."""


class FrameMismatch(AmbushPlannerError):
    """A pose cannot be transformed into the map's frame."""


class GroundChanges(AmbushPlannerError):
    """The map or the robot changes faster than plans are solved."""


class InvalidPlanner(AmbushPlannerError):
    """The goal of an action names another planner."""


class NotActive(AmbushPlannerError):
    """The node is not active."""


class UnreadableMessage(AmbushPlannerError):
    """The bytes on a topic are not a message of its type."""


OK_CODE = 'NONE'

# The first row that matches counts, so subclasses precede their base classes.
_CODES: tuple[tuple[type[Exception], str], ...] = (
    (NoMap, 'NO_MAP'),
    (NoStart, 'NO_START'),
    (NoGoal, 'NO_GOAL'),
    (InvalidPose, 'INVALID_POSE'),
    (UnreadableMessage, 'INVALID_MESSAGE'),
    (FrameMismatch, 'TF_ERROR'),
    (StartOutsideMap, 'START_OUTSIDE_MAP'),
    (GoalOutsideMap, 'GOAL_OUTSIDE_MAP'),
    (StopOutsideMap, 'STOP_OUTSIDE_MAP'),
    (StartBlocked, 'START_OCCUPIED'),
    (GoalBlocked, 'GOAL_OCCUPIED'),
    (StopBlocked, 'STOP_OCCUPIED'),
    (NoRoute, 'NO_VALID_PATH'),
    (BudgetInfeasible, 'NO_VALID_PATH'),
    (TimeLimit, 'TIMEOUT'),
    (InvalidRiskMap, 'INVALID_MAP'),
    (InvalidNetwork, 'INVALID_NETWORK'),
    (InvalidOption, 'INVALID_OPTION'),
    (SolverFailed, 'SOLVER_FAILED'),
    (SolveCancelled, 'CANCELLED'),
    (QueueFull, 'BUSY'),
    (NotActive, 'INACTIVE'),
    (InvalidPlanner, 'INVALID_PLANNER'),
    (GroundChanges, 'OUT_OF_DATE'),
    (WorkerFailed, 'WORKER_FAILED'),
    (RecordingFailed, 'RECORDING_FAILED'),
)


def code_of(error: Exception) -> str:
    """Return the code of an error; UNKNOWN if it is not one of the planner's."""
    return next((code for kind, code in _CODES if isinstance(error, kind)), 'UNKNOWN')
