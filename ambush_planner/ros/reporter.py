"""Keeps the node's status and publishes it on /diagnostics, on change and once a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from threading import RLock

from rclpy.clock import Clock

from ..planning.changed_ground import Assessment
from ..planning.plan import Plan
from ..recordings import RecordedMessage
from .diagnostics import Status, status_to_ros
from .publishers import Publishers


class Reporter:
    """Publishes the status of the node called ``name``; thread-safe.

    ``is_solving`` returns whether a solve runs or waits. The error of a request disappears after
    ``error_hold`` [s]; all else is reported as long as it lasts.
    """

    def __init__(
        self, name: str, publishers: Publishers, clock: Clock, is_solving: Callable[[], bool],
        error_hold: float,
    ) -> None:
        self._name, self._publishers, self._clock = name, publishers, clock
        self._is_solving, self.error_hold = is_solving, error_hold
        self._failed_at = 0.0
        self._status = Status(lifecycle='unconfigured')
        self._lock = RLock()

    def report(self) -> RecordedMessage:
        """Publish the present status."""
        # Publishing under the lock keeps the reports in order.
        with self._lock:
            if time.monotonic() - self._failed_at > self.error_hold:
                self._status = self._status.without_problem('request')
            self._status = replace(self._status, solving=self._is_solving())
            message = status_to_ros(self._status, self._name, self._clock.now().to_msg())
            return self._publishers.publish('/diagnostics', message)

    def refresh(self) -> None:
        """Publish the status if a solve has begun or ended."""
        with self._lock:
            if self._status.solving != self._is_solving():
                self.report()

    def lifecycle(self, state: str) -> None:
        """Set the lifecycle state; 'unconfigured' clears all that does not concern parameters."""
        def change(status: Status) -> Status:
            if state != 'unconfigured':
                return replace(status, lifecycle=state)
            kept = {key: text for key, text in status.warnings.items() if key == 'parameters'}
            return Status(lifecycle=state, recording=status.recording, warnings=kept)

        self._change(change)

    def failed(self, concern: str, error: Exception) -> None:
        """Report an error of the last 'request', 'map' or 'recording'."""
        with self._lock:
            if concern == 'request':
                self._failed_at = time.monotonic()
            self._change(lambda status: status.with_problem(concern, error))

    def succeeded(self) -> None:
        """Clear the error of the last request."""
        self._change(lambda status: status.without_problem('request'))

    def warn(self, concern: str, text: str) -> None:
        """Set the warning of 'parameters' or 'alpha_map'; '' clears it."""
        def change(status: Status) -> Status:
            rest = {key: value for key, value in status.warnings.items() if key != concern}
            return replace(status, warnings=rest | ({concern: text} if text else {}))

        self._change(change)

    def inputs(self, missing: tuple[str, ...]) -> None:
        """Set which inputs are missing."""
        self._change(lambda status: replace(status, missing=missing))

    def map_accepted(self) -> None:
        """Clear the error of the last map."""
        self._change(lambda status: status.without_problem('map'))

    def plan_shown(self, plan: Plan, assessment: Assessment | None) -> None:
        """Set the displayed plan."""
        self._change(lambda status: replace(status, plan=plan, assessment=assessment, stale=''))

    def plan_assessed(self, assessment: Assessment | None, stale: str) -> None:
        """Set how good the displayed plan is on the newest map, and why it is stale, if it is."""
        self._change(lambda status: replace(status, assessment=assessment, stale=stale))

    def plan_stale(self, why: str) -> None:
        """Set why the displayed plan is stale and stays so."""
        self._change(lambda status: replace(status, stale=why))

    def departed(
        self, number: int, departure_id: str, tight_turns: int
    ) -> tuple[RecordedMessage, str]:
        """Report a departure; return the report, and what is wrong with the recording, if anything.

        Both come from one status, so the answer and the recorded diagnostics agree.
        """
        with self._lock:
            self._status = replace(
                self._status.without_problem('request'), departures=number,
                departure_id=departure_id, tight_turns=tight_turns,
            )
            problem = self._status.problems.get('recording')
            return self.report(), problem.message if problem else ''

    def recording(self, enabled: bool) -> None:
        """Set whether departures are recorded, and clear the error of the recording."""
        self._change(lambda status: replace(
            status.without_problem('recording'), recording='on' if enabled else 'off'
        ))

    def recording_failed(self, error: Exception) -> None:
        """Report that a departure could not be recorded."""
        self._change(lambda status: replace(
            status.with_problem('recording', error), recording='failed'
        ))

    def _change(self, change: Callable[[Status], Status]) -> None:
        """Change the status, and publish it if it differs."""
        with self._lock:
            before = self._status
            self._status = replace(change(before), solving=self._is_solving())
            if self._status != before:
                self.report()
