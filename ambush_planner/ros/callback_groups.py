"""How many callbacks may wait at the same time."""

from __future__ import annotations

from threading import Lock
from typing import Any

from rclpy.callback_groups import CallbackGroup


class AtMost(CallbackGroup):
    """Lets a number of callbacks run at the same time; the others stay in their queues.

    Callbacks that wait for a solve occupy a thread of the executor each. An executor with more
    threads than this always has one left for everything else.
    """

    def __init__(self, count: int) -> None:
        super().__init__()
        self._free = count
        self._lock = Lock()

    def can_execute(self, entity: Any) -> bool:
        """Tell whether one more may run."""
        return self._free > 0

    def beginning_execution(self, entity: Any) -> bool:
        """Take a place, if there is one."""
        with self._lock:
            if self._free == 0:
                return False
            self._free -= 1
            return True

    def ending_execution(self, entity: Any) -> None:
        """Give the place back."""
        with self._lock:
            self._free += 1
