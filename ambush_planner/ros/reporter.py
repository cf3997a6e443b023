# SPDX-License-Identifier: Apache-2.0
"""Keeps the node's status and publishes it on /diagnostics, on change and once a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from threading import RLock
from typing import Any

from rclpy.clock import Clock

from ..recordings import RecordedMessage
from .departure_record import Departure
from .diagnostics import Status, status_to_ros
from .topics import Publishers


class Reporter:
    """Publishes the status of the node called ``name``; thread-safe.

    ``activity`` returns whether a solve runs or waits, and whether a plan is being refined. A
    request's error is reported for ``error_hold()`` [s], everything else as long as it lasts.
    """

    def __init__(self, name: str, publishers: Publishers, clock: Clock,
                 activity: Callable[[], tuple[bool, bool]],
                 error_hold: Callable[[], float]) -> None:
        self._name, self._publishers, self._clock = name, publishers, clock
        self._activity, self._error_hold = activity, error_hold
        self._failed_at = 0.0
        self._status = Status(lifecycle='unconfigured')
        self._lock = RLock()

    def report(self) -> RecordedMessage:
        """Publish the present status."""
        # Publishing under the lock keeps the reports in order.
        with self._lock:
            if time.monotonic() - self._failed_at > self._error_hold():
                self._status = self._status.without_problem('request')
            self._status = self._active(self._status)
            message = status_to_ros(self._status, self._name, self._clock.now().to_msg())
            return self._publishers.publish('/diagnostics', message)

    def set(self, **fields: Any) -> None:
        """Set fields of the status; without any, publish it if a solve has begun or ended."""
        self._change(lambda status: replace(status, **fields))

    def unconfigured(self, lifecycle: str) -> None:
        """Clear everything except the warning about parameters."""
        def change(status: Status) -> Status:
            kept = {key: text for key, text in status.warnings.items() if key == 'parameters'}
            return Status(lifecycle=lifecycle, recording=status.recording, warnings=kept)

        self._change(change)

    def failed(self, concern: str, error: Exception) -> None:
        """Report an error of the last 'request', 'map' or 'recording'."""
        with self._lock:
            if concern == 'request':
                self._failed_at = time.monotonic()
            self._change(lambda status: status.with_problem(concern, error))

    def succeeded(self, concern: str) -> None:
        """Clear the error of the last 'request' or 'map'."""
        self._change(lambda status: status.without_problem(concern))

    def warn(self, concern: str, text: str) -> None:
        """Set the warning of 'parameters', 'alpha_map', 'costmap' or 'risk'; '' clears it."""
        def change(status: Status) -> Status:
            rest = {key: value for key, value in status.warnings.items() if key != concern}
            return replace(status, warnings=rest | ({concern: text} if text else {}))

        self._change(change)

    def departing(self, departure: Departure) -> Departure:
        """Return a departure that is about to leave, with its report and what this remarks.

        The report is not published. With ``recording.required`` it says that the recording is done.
        """
        with self._lock:
            status = self._left(departure)
            if departure.parameters.recording.required:
                status = replace(status.without_problem('recording'), recording='on')
            message = status_to_ros(status, self._name, self._clock.now().to_msg())
            report = self._publishers.as_recorded('/diagnostics', message)
        trouble = status.problems.get('recording')
        remarks = '; '.join(filter(None, (departure.remarks, trouble and trouble.message)))
        return replace(departure, report=report, remarks=remarks)

    def departed(self, departure: Departure) -> None:
        """Publish the report of a departure that leaves, made by ``departing``."""
        assert departure.report is not None
        with self._lock:
            self._status = self._left(departure)
            self._publishers.publish('/diagnostics', departure.report.data)

    def _left(self, departure: Departure) -> Status:
        return replace(self._status.without_problem('request'), last=departure,
                       last_answer='diverted' if departure.diversion else 'new')

    def recording(self, enabled: bool, error: Exception | None = None) -> None:
        """Report whether departures are recorded, and the error of the last recording."""
        state = 'failed' if error else 'on' if enabled else 'off'
        self._change(lambda status: replace(status.with_problem('recording', error) if error
                                            else status.without_problem('recording'),
                                            recording=state))

    def _change(self, change: Callable[[Status], Status]) -> None:
        """Change the status, and publish it if it differs."""
        with self._lock:
            before = self._status
            self._status = self._active(change(before))
            if self._status != before:
                self.report()

    def _active(self, status: Status) -> Status:
        solving, refining = self._activity()
        return replace(status, solving=solving, refining=refining)
