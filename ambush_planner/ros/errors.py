# SPDX-License-Identifier: Apache-2.0
"""Errors of the node: their codes in diagnostics and results, and the boundary that catches them.

Codes have the names of the constants of Nav2's ``ComputePathToPose`` if it has one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Lock
from typing import Any, TypeVar

from rclpy.context import Context
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from .. import errors
from ..errors import AmbushPlannerError
from ..recordings.recording_errors import RecordingFailed
from ..worker.solve_errors import QueueFull, SolveCancelled, WorkerFailed, for_the_log, known

_Result = TypeVar('_Result')
# How often an answer is sent to a client that is not known yet; each time takes 0.1 s.
_SENDS = 30


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


class ErrorBoundary:
    """Logs errors and passes each to ``report`` with what it concerns.

    Only the first of several errors of one code in one place is logged; ``log_repeated``, to be
    called about once a second, logs how many followed and resets the count. Thread-safe.
    """

    def __init__(self, context: Context, logger: RcutilsLogger,
                 report: Callable[[str, Exception], None]) -> None:
        self._context, self._logger, self._report = context, logger, report
        # How often each error has come since the last log_repeated, and the text of the latest.
        self._latest: dict[tuple[str, str], tuple[int, str]] = {}
        self._lock = Lock()

    def attempt(self, what: str, concern: str,
                action: Callable[[], _Result]) -> tuple[_Result | None, Exception | None]:
        """Return (result, None) or (None, error)."""
        try:
            return action(), None
        except Exception as raised:
            error = known(raised)
        if self._context.ok():
            text, key = f'{what}: {for_the_log(error)}', (what, code_of(error))
            with self._lock:
                count = self._latest.get(key, (0, ''))[0] + 1
                self._latest[key] = count, text
            if count == 1:
                self._logger.error(text)
            self._report(concern, error)
        return None, error

    def log_repeated(self) -> None:
        """Log how many errors have not been logged."""
        with self._lock:
            latest, self._latest = self._latest, {}
        for count, text in latest.values():
            if count > 1:
                self._logger.error(f'{text} (and {count - 1} more like this)')


def protect_services(node: Node) -> None:
    """Catch the errors of the services that rclpy itself has added to ``node``.

    They raise, for instance, at a parameter value of an unknown type, and at a transition that the
    node's state does not have. Their answers are sent until the client is known.
    """
    warnings.filterwarnings('error', 'failed to send response', RuntimeWarning)

    def answer_anyway(name: str, callback: Callable[[Any, Any], Any], request: Any,
                      response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            # The error's own message could repeat the content of the request.
            node.get_logger().error(f'{name}: refused, {type(error).__name__}')
            return response

    service: Any
    for service in list(node.services):
        service.callback = partial(answer_anyway, service.srv_name, service.callback)
        service.send_response = partial(send_until_known, service.send_response)


def send_until_known(send: Callable[[Any, Any], None], response: Any, header: Any) -> None:
    """Send an answer, again if the middleware has not discovered its client within 0.1 s.

    A lifecycle manager calls as soon as it has discovered the service, and would then wait for ever
    where rclpy only warns; that warning is made an error here.
    """
    for _ in range(_SENDS):
        with suppress(RuntimeWarning):
            return send(response, header)
