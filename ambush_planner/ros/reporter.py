"""The node's diagnostics: what has happened to it, told when it changes and once a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from threading import RLock

from rclpy.clock import Clock

from ..planning.changed_ground import Standing
from ..planning.plan import Plan
from ..recordings import RecordedMessage
from .diagnostics import Status, status_to_ros
from .publishers import Publishers


class Reporter:
    """Publishes the status of the node called ``name``; safe to be used from several threads.

    ``solving`` tells whether a solve runs or waits. What is wrong with a request fades after
    ``error_hold`` [s]; all else stays as long as it lasts.
    """

    def __init__(
        self, name: str, outbox: Publishers, clock: Clock, solving: Callable[[], bool],
        error_hold: float,
    ) -> None:
        self._name, self._outbox, self._clock, self._solving = name, outbox, clock, solving
        self.error_hold = error_hold
        self._failed_at = 0.0
        self._status = Status(lifecycle='unconfigured')
        self._lock = RLock()

    def report(self) -> RecordedMessage:
        """Publish the diagnostics as they are."""
        # Under the lock, or an older status could go out after a newer one.
        with self._lock:
            if time.monotonic() - self._failed_at > self.error_hold:
                self._status = self._status.without_problem('request')
            self._status = replace(self._status, solving=self._solving())
            stamp = self._clock.now().to_msg()
            return self._outbox.publish(
                '/diagnostics', status_to_ros(self._status, self._name, stamp)
            )

    def lifecycle(self, state: str) -> None:
        """Tell the node's state; in 'unconfigured' only what concerns its parameters is kept."""
        def change(status: Status) -> Status:
            if state != 'unconfigured':
                return replace(status, lifecycle=state)
            kept = {key: text for key, text in status.warnings.items() if key == 'parameters'}
            return Status(lifecycle=state, recording=status.recording, warnings=kept)

        self._change(change)

    def refresh(self) -> None:
        """Publish the diagnostics if a solve has begun or ended."""
        with self._lock:
            if self._status.solving != self._solving():
                self.report()

    def failed(self, concern: str, error: Exception) -> None:
        """Tell what is wrong with a request, the map that just came, or the recording."""
        with self._lock:
            if concern == 'request':
                self._failed_at = time.monotonic()
            self._change(lambda status: status.with_problem(concern, error))

    def succeeded(self) -> None:
        """Forget what was wrong with a request."""
        self._change(lambda status: status.without_problem('request'))

    def warn(self, concern: str, text: str) -> None:
        """Warn of something as long as it lasts; '' when it is over."""
        def change(status: Status) -> Status:
            rest = {key: value for key, value in status.warnings.items() if key != concern}
            return replace(status, warnings=rest | ({concern: text} if text else {}))

        self._change(change)

    def inputs(self, missing: tuple[str, ...]) -> None:
        """Tell which inputs are missing."""
        self._change(lambda status: replace(status, missing=missing))

    def map_accepted(self) -> None:
        """Forget what was wrong with a map."""
        self._change(lambda status: status.without_problem('map'))

    def plan_shown(self, plan: Plan, standing: Standing | None) -> None:
        """Tell the numbers of the plan that is in force."""
        self._change(lambda status: replace(status, plan=plan, standing=standing, stale=''))

    def stands(self, standing: Standing | None, stale: str) -> None:
        """Tell how the plan in force stands on the newest map, and why it is stale, if it is."""
        self._change(lambda status: replace(status, standing=standing, stale=stale))

    def stale(self, why: str) -> None:
        """Tell that the plan in force is stale, and stays it."""
        self._change(lambda status: replace(status, stale=why))

    def departed(
        self, number: int, departure_id: str, tight_turns: int
    ) -> tuple[RecordedMessage, str]:
        """Tell of a departure; return what was published, and what is wrong with the recording.

        Both at once: the recording's diagnostics must bear out what the answer says of trouble.
        """
        with self._lock:
            self._status = replace(
                self._status.without_problem('request'), departures=number,
                departure_id=departure_id, tight_turns=tight_turns,
            )
            failed = self._status.problems.get('recording')
            return self.report(), failed.message if failed else ''

    def recording(self, enabled: bool) -> None:
        """Tell that recording was switched on or off."""
        self._change(lambda status: replace(
            status.without_problem('recording'), recording='on' if enabled else 'off'
        ))

    def recorded(self, error: Exception | None) -> None:
        """Tell how the recording of a departure went."""
        if error is None:
            self.recording(True)
        else:
            failed = error
            self._change(lambda status: replace(
                status.with_problem('recording', failed), recording='failed'
            ))

    def _change(self, change: Callable[[Status], Status]) -> None:
        """Change the status, and publish it if it is another one then."""
        with self._lock:
            before = self._status
            self._status = replace(change(before), solving=self._solving())
            if self._status != before:
                self.report()
