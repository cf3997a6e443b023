# SPDX-License-Identifier: Apache-2.0
"""Errors of requests, and the codes of all errors in the diagnostics.

Codes have the names of the constants of Nav2's ``ComputePathToPose`` if it has one.
"""

from __future__ import annotations

from .. import errors
from ..errors import AmbushPlannerError
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
    (errors.InvalidPose, 'INVALID_POSE'),
    (UnreadableMessage, 'INVALID_MESSAGE'),
    (FrameMismatch, 'TF_ERROR'),
    (errors.StartOutsideMap, 'START_OUTSIDE_MAP'),
    (errors.GoalOutsideMap, 'GOAL_OUTSIDE_MAP'),
    (errors.StopOutsideMap, 'STOP_OUTSIDE_MAP'),
    (errors.StartBlocked, 'START_OCCUPIED'),
    (errors.GoalBlocked, 'GOAL_OCCUPIED'),
    (errors.StopBlocked, 'STOP_OCCUPIED'),
    (errors.NoRoute, 'NO_VALID_PATH'),
    (errors.BudgetInfeasible, 'NO_VALID_PATH'),
    (errors.TimeLimit, 'TIMEOUT'),
    (errors.InvalidRiskMap, 'INVALID_MAP'),
    (errors.InvalidNetwork, 'INVALID_NETWORK'),
    (errors.InvalidOption, 'INVALID_OPTION'),
    (errors.SolverFailed, 'SOLVER_FAILED'),
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
