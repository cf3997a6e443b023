# SPDX-License-Identifier: Apache-2.0
"""Refused requests, and the codes of all errors in the diagnostics.

Codes have the names of the constants of Nav2's ``ComputePathToPose`` if it has one.
"""

from __future__ import annotations

from .. import errors
from ..errors import AmbushPlannerError
from ..recordings.recording_errors import RecordingFailed
from ..worker.solve_errors import QueueFull, SolveCancelled, WorkerFailed


class Refusal(AmbushPlannerError):
    """Why a request is not answered, with its ``code`` in the diagnostics."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class FrameMismatch(Refusal):
    """A pose cannot be transformed into the map's frame."""

    def __init__(self, message: str) -> None:
        super().__init__('TF_ERROR', message)


OK_CODE = 'NONE'

# The first row that matches counts, so subclasses precede their base classes.
_CODES: tuple[tuple[type[Exception], str], ...] = (
    (errors.InvalidPose, 'INVALID_POSE'),
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
    (WorkerFailed, 'WORKER_FAILED'),
    (RecordingFailed, 'RECORDING_FAILED'),
)


def code_of(error: Exception) -> str:
    """Return the code of an error; UNKNOWN if it is not one of the planner's."""
    if isinstance(error, Refusal):
        return error.code
    return next((code for kind, code in _CODES if isinstance(error, kind)), 'UNKNOWN')
