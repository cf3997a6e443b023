# SPDX-License-Identifier: Apache-2.0
"""Errors of the queue and the worker, and of code that fails unexpectedly."""

from __future__ import annotations

import traceback

from ..errors import AmbushPlannerError, TimeLimit


class SolveCancelled(AmbushPlannerError):
    """The solve was cancelled, or the planner is shutting down."""


class QueueFull(AmbushPlannerError):
    """Too many solves are waiting."""


class WorkerFailed(AmbushPlannerError):
    """The worker process died or could not be started."""


class Unexpected(AmbushPlannerError):
    """An internal error; ``frames`` is the text of its traceback, without values."""

    def __init__(self, message: str, frames: str) -> None:
        super().__init__(message, frames)
        self.frames = frames

    def __str__(self) -> str:
        return str(self.args[0])


def shutting_down() -> SolveCancelled:
    """The error of requests to a planner that is about to end."""
    return SolveCancelled('the planner is shutting down')


def no_plan_in(seconds: float) -> TimeLimit:
    """The error for a solve without any strategy after ``seconds``."""
    return TimeLimit(
        f'no plan after max_planning_time, {seconds:g} s; allow more time, or choose a larger '
        'network.spacing'
    )


def known(error: Exception) -> AmbushPlannerError:
    """Return an error without its frames, which would keep maps and messages alive.

    An error that is not the planner's is replaced by an Unexpected one.
    """
    result = error if isinstance(error, AmbushPlannerError) else unexpected(error)
    each: BaseException | None = error
    while each is not None:
        each.__traceback__ = None
        each = each.__cause__ or each.__context__
    return result


def unexpected(error: Exception) -> Unexpected:
    """Replace an unknown error by its traceback: its message may reveal routes."""
    frames = ''.join(traceback.format_tb(error.__traceback__))
    return Unexpected(f'internal error ({type(error).__name__}); the log says where', frames)


def for_the_log(error: Exception) -> str:
    """The message, with the traceback of an internal error."""
    return f'{error}, at\n{error.frames}' if isinstance(error, Unexpected) else str(error)
