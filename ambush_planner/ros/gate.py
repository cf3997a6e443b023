# SPDX-License-Identifier: Apache-2.0
"""The gate that every request passes: open while the node is active."""

from __future__ import annotations

from threading import RLock

from ..errors import AmbushPlannerError
from ..worker.solve_errors import shutting_down
from .errors import Refusal

ACTIVE = 'active'
# Why requests are refused in the other states.
_REASONS = {
    'unconfigured': 'the node is not configured: configure and activate it first (ros2 lifecycle '
                    'set); after a cleanup, publish start and goal again (a latched map arrives by '
                    'itself)',
    'inactive': 'the node is inactive: activate it first (ros2 lifecycle set NODE activate)',
}


class Gate:
    """The lifecycle ``state`` of the node, which all parts ask; thread-safe.

    A departure leaves while it holds ``leaving``, so nothing leaves once ``move`` has closed the
    gate.
    """

    def __init__(self) -> None:
        self.state = 'unconfigured'
        self.leaving = RLock()

    @property
    def is_open(self) -> bool:
        """Return whether requests are answered."""
        return self.state == ACTIVE

    @property
    def refusal(self) -> AmbushPlannerError:
        """The error of a request that the closed gate refuses."""
        reason = _REASONS.get(self.state)
        return Refusal('INACTIVE', reason) if reason else shutting_down()

    def check(self) -> None:
        """Raise the refusal unless the gate is open."""
        if not self.is_open:
            raise self.refusal

    def move(self, state: str) -> None:
        """Change the state."""
        with self.leaving:
            self.state = state
