# SPDX-License-Identifier: Apache-2.0
"""Publishes departures, and records them in a thread of their own with a bounded queue."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Thread
from weakref import WeakKeyDictionary

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..errors import AmbushPlannerError
from ..parameters.values import RecordingOptions
from ..planning.plan import Plan
from ..recordings.plan_file import attachments_of
from ..recordings.recorder import Recorder, prepare
from ..recordings.recording_errors import RecordingFailed
from ..worker.solve_errors import for_the_log, known
from .departure_record import Departure, map_changes, metadata_of, recorded_messages
from .diagnostics import Reporter

# Maximum number of departures that wait for the disk: few enough to be written at shutdown.
_MAX_WAITING = 4
# Time after which a disk that has not written a departure counts as hung, and a departure that need
# not be recorded waits no longer for room in the queue [s].
_MAX_WAIT = 3.0


@dataclass(eq=False)
class _Queued:
    """A departure that waits for the disk, how it leaves, and the future of its leaving.

    ``settled``: it leaves, or has been refused.
    """

    departure: Departure
    leave: Callable[[], None]
    left: Future[None] = field(default_factory=Future)
    settled: bool = False


class Recordings:
    """Publishes departures, and writes them one after the other, as ``options`` say.

    ``full_name`` is that of a topic; ``on_room`` is called when there is room for another one. At
    the start, temporary files in the folder are removed. No method but ``wait`` waits.
    """

    def __init__(self, options: RecordingOptions, reporter: Reporter, logger: RcutilsLogger,
                 full_name: Callable[[str], str]) -> None:
        self._options, self._reporter, self._logger = options, reporter, logger
        self._full_name = full_name
        self.on_room: Callable[[], None] = lambda: None
        self._recorder = Recorder(Path(options.directory), options.compression)
        self._plan_files: WeakKeyDictionary[Plan, dict[str, bytes]] = WeakKeyDictionary()
        self._unwritten: deque[_Queued] = deque()  # the first one is being written
        self._condition = Condition()
        self._begun = time.monotonic()  # when the disk got what it is writing
        self._closing = False
        self._thread = Thread(target=self._work, name='recordings', daemon=True)
        self._thread.start()

    @property
    def hung_for(self) -> float:
        """Return for how long the disk has written nothing that waits for it [s]; 0: it writes."""
        silent = time.monotonic() - self._begun
        return silent if self._unwritten and silent > _MAX_WAIT else 0.0

    def has_room(self, waited: float) -> bool:
        """Return whether a departure may be drawn now that has ``waited`` for room [s].

        So that there is no wait between a draw and the departure, ask before. A hung disk has
        room: it makes no difference to wait longer.
        """
        return bool(len(self._unwritten) < _MAX_WAITING or self.hung_for
                    or (waited > _MAX_WAIT and not self._options.required))

    def publish(self, departure: Departure, leave: Callable[[], None]) -> Future[None]:
        """Have a departure ``leave`` and queue its recording.

        If recordings are required, it leaves once it is on the disk, in the recordings' thread. The
        future is done when it has left; it has an exception if ``leave`` raised it or if a required
        recording failed. What has not left has no file.
        """
        queued, required = _Queued(departure, leave), self._options.required
        if not required:
            _leave(queued)
            if not self._options.enabled or queued.left.exception():
                return queued.left
        with self._condition:
            if len(self._unwritten) < _MAX_WAITING and not (required and self.hung_for):
                if not self._unwritten:
                    self._begun = time.monotonic()
                self._unwritten.append(queued)
                self._condition.notify_all()
                return queued.left
        self._failed(queued, self._hung(f'departure {departure.number} is not recorded'))
        return queued.left

    def refuse(self, error: AmbushPlannerError | None = None) -> bool:
        """Refuse the departures that must be recorded first and are not yet; False: there are none.

        Without an ``error``, only if the disk hangs.
        """
        if not self._options.required or not (error or self.hung_for):
            return False
        refused = [each for each in list(self._unwritten) if self._settle(each)]
        for each in refused:
            self._failed(each, error or self._hung(f'departure {each.departure.number} is refused'),
                         report=error is None)
        return bool(refused)

    def finish(self) -> None:
        """Write the waiting departures, then end."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()

    def wait(self, seconds: float) -> None:
        """Wait for the end after ``finish``, but no longer than this."""
        self._thread.join(seconds)
        if self._unwritten:
            self._logger.error(f'recording: {len(self._unwritten)} departures were not written '
                               'before the shutdown')

    @property
    def alive(self) -> bool:
        """Return whether departures may still be written."""
        return self._thread.is_alive()

    def _work(self) -> None:
        if self._options.enabled:
            try:
                for path in prepare(Path(self._options.directory).expanduser()):
                    self._logger.warning(f'recording: removed the unfinished file {path}')
            except RecordingFailed as error:
                self._report(error)
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._unwritten or self._closing)
                if not self._unwritten:
                    return
            self._write(self._unwritten[0])
            with self._condition:
                self._unwritten.popleft()
                self._begun = time.monotonic()
            self.on_room()

    def _write(self, queued: _Queued) -> None:
        """Record a departure; a required recording stays only if the departure then leaves."""
        if self._options.required and queued.settled:
            return
        held = queued.departure.held
        try:
            if held.plan not in self._plan_files:
                crs = held.parameters.occupancy.crs
                self._plan_files[held.plan] = attachments_of(held.plan, crs)
            path = self._recorder.record_departure(
                recorded_messages(queued.departure, self._full_name),
                metadata_of(queued.departure, self._full_name).entries(),
                {**self._plan_files[held.plan], **map_changes(queued.departure)})
        except Exception as error:  # the thread must live to write the next one
            if not self._options.required or self._settle(queued):
                self._failed(queued, known(error))
            return
        self._report(None)
        if self._options.required:
            if self._settle(queued):
                _leave(queued)
            if queued.left.exception():
                with suppress(RecordingFailed):  # a file more than departures, at worst
                    self._recorder.remove(path)

    def _settle(self, queued: _Queued) -> bool:
        """Return whether this is the first to decide if a departure leaves."""
        with self._condition:
            first, queued.settled = not queued.settled, True
            return first

    def _hung(self, outcome: str) -> RecordingFailed:
        return RecordingFailed(Path(self._options.directory),
                               f'the disk does not respond, and {len(self._unwritten)} departures '
                               f'wait for it; {outcome}')

    def _failed(self, queued: _Queued, error: AmbushPlannerError, report: bool = True) -> None:
        if report:
            self._report(error)
        if self._options.required:
            queued.left.set_exception(error)

    def _report(self, error: AmbushPlannerError | None) -> None:
        with suppress(Exception):  # during shutdown the node may be unable to report
            if error is not None:
                self._logger.error(f'recording: {for_the_log(error)}')
            if not self._closing:  # else it would be about the next configuration
                self._reporter.note('recording', error)


def _leave(queued: _Queued) -> None:
    try:
        queued.leave()
    except Exception as error:
        queued.left.set_exception(error)
    else:
        queued.left.set_result(None)
