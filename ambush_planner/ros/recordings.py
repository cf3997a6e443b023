# SPDX-License-Identifier: Apache-2.0
"""Publishes departures, and records them in a thread of their own with a bounded queue."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from typing import NamedTuple
from weakref import WeakKeyDictionary

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..errors import AmbushPlannerError
from ..parameters.values import RecordingOptions
from ..planning.plan import Plan
from ..recordings import Recorder, RecordingFailed
from ..recordings.plan_file import attachments_of
from ..recordings.recorder import prepare
from ..worker.solve_errors import for_the_log, known
from .departure_record import Departure, map_changes, metadata_of, recorded_messages
from .diagnostics import Reporter

# Maximum number of departures that wait for the disk: few enough to be written at shutdown.
_MAX_WAITING = 4
# Maximum time [s] that a departure waits for room in the queue.
_MAX_WAIT = 2.0


class _Queued(NamedTuple):
    """A departure that waits for the disk, how it leaves, and the future of its leaving."""

    departure: Departure
    leave: Callable[[], None]
    left: Future[None]


class Recordings:
    """Publishes departures, and writes them one after the other, as ``options`` say.

    At the start, temporary files in the folder are removed.
    """

    def __init__(self, options: RecordingOptions, reporter: Reporter,
                 logger: RcutilsLogger) -> None:
        self._options, self._reporter, self._logger = options, reporter, logger
        self._recorder = Recorder(Path(options.directory), options.compression)
        self._plan_files: WeakKeyDictionary[Plan, dict[str, bytes]] = WeakKeyDictionary()
        self._unwritten: deque[_Queued] = deque()  # the first one is being written
        self._condition = Condition()
        # True after a departure timed out on the disk, until the next write.
        self._stuck = False
        self._hurry = self._closing = False
        self._previous = ''  # the recording_id of the last one
        self._thread = Thread(target=self._work, name='recordings', daemon=True)
        self._thread.start()

    def wait_for_room(self) -> None:
        """Wait for room in the queue, but not for a stuck disk; call before a route is drawn."""
        with self._condition:
            room = self._condition.wait_for(lambda: not self._full or self._hurry or self._stuck,
                                            _MAX_WAIT)
            self._stuck = self._stuck or not room

    def publish(self, departure: Departure, leave: Callable[[], None],
                record: bool = True) -> Future[None]:
        """Have a departure ``leave`` and queue its recording; never waits for the disk.

        If recordings are required, it leaves once it is on the disk, in the recordings' thread. The
        future is done when it has left; it has an exception if ``leave`` raised it or if a required
        recording failed. What has not left has no file. Without ``record`` only a required one is
        recorded.
        """
        queued = _Queued(departure, leave, Future())
        if not self._options.required:
            _leave(queued)
            if not (self._options.enabled and record) or queued.left.exception():
                return queued.left
        with self._condition:
            if not (self._full and self._stuck):
                self._unwritten.append(queued)
                self._condition.notify_all()
                return queued.left
        self._failed(queued, RecordingFailed(
            Path(self._options.directory),
            f'the disk does not respond, and {_MAX_WAITING} departures wait for it; departure '
            f'{departure.number} is not recorded',
        ))
        return queued.left

    def hurry(self, hurry: bool) -> None:
        """Begin or end not to wait for room: the node is being deactivated."""
        with self._condition:
            self._hurry = hurry
            self._condition.notify_all()

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
        """Whether departures may still be written."""
        return self._thread.is_alive()

    @property
    def _full(self) -> bool:
        return len(self._unwritten) >= _MAX_WAITING

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
                self._stuck = False
                self._condition.notify_all()

    def _write(self, queued: _Queued) -> None:
        """Record a departure; a required recording stays only if the departure then leaves."""
        held = queued.departure.held
        try:
            if held.plan not in self._plan_files:
                crs = held.task.parameters.occupancy.crs
                self._plan_files[held.plan] = attachments_of(held.plan, crs)
            metadata = metadata_of(queued.departure, self._previous)
            path = self._recorder.record_departure(
                recorded_messages(queued.departure), metadata.entries(),
                {**self._plan_files[held.plan], **map_changes(queued.departure)})
        except Exception as error:  # the thread must live to write the next one
            self._failed(queued, known(error))
            return
        self._report(None)
        if self._options.required:
            _leave(queued)
            if queued.left.exception():
                with suppress(RecordingFailed):  # a file more than departures, at worst
                    self._recorder.remove(path)
                return
        self._previous = metadata.recording_id

    def _failed(self, queued: _Queued, error: AmbushPlannerError) -> None:
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
