# SPDX-License-Identifier: Apache-2.0
"""The planner's errors: each message says what is wrong, where, and what to do about it."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .game.strategy import Strategy


class AmbushPlannerError(Exception):
    """Base class of the planner's errors."""


class AmbushPlannerWarning(UserWarning):
    """Something was left out or converted on reading a file, or limits a plan's value."""


def warn(sentence: str) -> None:
    """Warn with a sentence without its full stop, at the line that called this package."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back and frame.f_globals.get('__name__', '').startswith('ambush_planner'):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, AmbushPlannerWarning, stacklevel=level)


@contextmanager
def telling_warnings(tell: Callable[[str], None]) -> Iterator[None]:
    """Give the sentences of this package's warnings to ``tell``, each once."""
    with warnings.catch_warnings():
        said: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *where: Any,
                 **more: Any) -> None:
            if not issubclass(category, AmbushPlannerWarning):
                default(message, category, *where, **more)
            elif (text := str(message)) not in said:
                said.add(text)
                tell(text)

        default, warnings.showwarning = warnings.showwarning, show
        warnings.simplefilter('always', AmbushPlannerWarning)
        yield


class InvalidRiskMap(AmbushPlannerError, ValueError):
    """The risk map is malformed: shape, resolution, origin or a cell's value."""


class InvalidNetwork(AmbushPlannerError, ValueError):
    """The network is malformed: points, alpha, edges, source or target."""


class InvalidCoordinates(AmbushPlannerError, ValueError):
    """A coordinate system or a position in it cannot be used."""


class InvalidPose(AmbushPlannerError, ValueError):
    """A pose is not finite or its orientation is not a unit quaternion."""


class InvalidOption(AmbushPlannerError, ValueError):
    """An option is out of range, contradicts another one or is not available."""


class StartBlocked(AmbushPlannerError):
    """The start is in an obstacle or within its clearance, or off the map."""


class GoalBlocked(AmbushPlannerError):
    """The goal is in an obstacle or within its clearance, or off the map."""


class StopBlocked(AmbushPlannerError):
    """A stop is in an obstacle or within its clearance, or off the map."""


class StartOutsideMap(StartBlocked):
    """The start is not on the map."""


class GoalOutsideMap(GoalBlocked):
    """The goal is not on the map."""


class StopOutsideMap(StopBlocked):
    """A stop is not on the map."""


class NoRoute(AmbushPlannerError):
    """No route leads from the source to the target."""


class BudgetInfeasible(AmbushPlannerError):
    """No strategy fits the length budget (``max_detour``)."""


class TimeLimit(AmbushPlannerError):
    """The time limit passed before the gap of the strategy was small enough.

    ``strategy`` is the best so far, with its own value, bound and gap; None if there was none.
    """

    def __init__(self, message: str, strategy: Strategy | None = None) -> None:
        super().__init__(message)
        self.strategy = strategy


class SolverFailed(AmbushPlannerError):
    """A solver failed, or its strategy has no valid certificate."""


def import_extra(module: str, what: str, extra: str, error: type[AmbushPlannerError]) -> Any:
    """Import a module that ``what`` need; else raise ``error``, which names the extra with it."""
    try:
        return import_module(module)
    except ModuleNotFoundError:
        raise error(f"{what} need {module}: in a checkout of ambush_planner, run pip install "
                    f"'.[{extra}]'") from None


def shown(name: Path | str) -> str:
    """Return a file name for a terminal, with control characters and invalid bytes escaped."""
    return ''.join(each if each.isprintable() else each.encode('unicode_escape').decode()
                   for each in str(name))
