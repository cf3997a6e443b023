"""No exception leaves a callback, where it would end the executor."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rclpy.context import Context
from rclpy.impl.rcutils_logger import RcutilsLogger

from ..core.errors import AmbushPlannerError
from ..worker.errors import for_the_log, forget_frames, unexpected

_Result = TypeVar('_Result')


class Guard:
    """Logs what goes wrong, once, and tells ``failed`` what it concerns."""

    def __init__(
        self, context: Context, logger: RcutilsLogger, failed: Callable[[str, Exception], None]
    ) -> None:
        self._context, self._logger, self._failed = context, logger, failed

    def attempt(
        self, what: str, concern: str, action: Callable[[], _Result]
    ) -> tuple[_Result | None, Exception | None]:
        """Return (result, None) or (None, error)."""
        try:
            return action(), None
        except AmbushPlannerError as error:
            known: AmbushPlannerError = error
        except Exception as error:
            known = unexpected(error)
            forget_frames(error)
        forget_frames(known)
        if self._context.ok():
            self._logger.error(f'{what}: {for_the_log(known)}')
            self._failed(concern, known)
        return None, known
