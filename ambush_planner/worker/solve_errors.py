"""How a solve can end without an answer of the planner's own."""

from __future__ import annotations

import traceback

from ..errors import AmbushPlannerError, TimeLimit


class SolveCancelled(AmbushPlannerError):
    """Somebody ended the solve, or the planner was closed."""


class QueueFull(AmbushPlannerError):
    """So many solves wait that no other one is taken."""


class WorkerFailed(AmbushPlannerError):
    """The worker process ended, or could not be started."""


class Unexpected(AmbushPlannerError):
    """An error that the planner does not know.

    ``frames`` says where in the code, as text of the traceback; never what the values were.
    """

    def __init__(self, message: str, frames: str) -> None:
        super().__init__(message, frames)
        self.frames = frames

    def __str__(self) -> str:
        return str(self.args[0])


def no_plan_in(seconds: float) -> TimeLimit:
    """Say what to do where nothing was reached in time."""
    return TimeLimit(
        f'no plan after max_planning_time, {seconds:g} s; allow more time, or choose a larger '
        'network.spacing'
    )


def unexpected(error: Exception) -> Unexpected:
    """Tell where an error came from, but not its own words: they may be about routes."""
    frames = ''.join(traceback.format_tb(error.__traceback__))
    return Unexpected(f'internal error ({type(error).__name__}); the log says where', frames)


def forget_frames(error: BaseException | None) -> None:
    """Let an error that is kept or has been told hold nothing but its words.

    The frames of its traceback hold maps and messages, and often the error itself: such a cycle
    stays until Python looks for it.
    """
    while error is not None:
        error.__traceback__ = None
        error = error.__cause__ or error.__context__


def for_the_log(error: Exception) -> str:
    """The message, and where it came from if that is not known otherwise."""
    return f'{error}, at\n{error.frames}' if isinstance(error, Unexpected) else str(error)
