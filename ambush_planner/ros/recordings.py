# SPDX-License-Identifier: Apache-2.0
"""Records departures in a thread of their own: a bounded queue, so that no answer waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from weakref import WeakKeyDictionary

from ..errors import AmbushPlannerError
from ..planning.node_parameters import RecordingOptions
from ..planning.plan import Plan
from ..recordings import Recorder, RecordingFailed
from ..recordings.attachments import strategy_file
from ..recordings.recorder import remove_abandoned
from ..worker.solve_errors import forget_frames, unexpected
from .departure_record import Departure, attachments, metadata_entries, recorded_messages

# Maximum number of departures that wait for the disk: few enough to be written at shutdown.
_MAX_WAITING = 4
# Maximum time [s] that a departure waits for room in the queue.
_MAX_WAIT = 2.0


class Recordings:
    """Writes departures one after the other.

    At the start, temporary files in the folder of ``options`` are removed, and ``warn`` called for
    each. Once a departure is written or given up, ``done`` gets the error or None.
    """

    def __init__(self, options: RecordingOptions,
                 done: Callable[[AmbushPlannerError | None], None],
                 warn: Callable[[str], object]) -> None:
        self._options, self._done, self._warn = options, done, warn
        self._recorder = Recorder(Path(options.directory), options.compression, options.required)
        self._strategies: WeakKeyDictionary[Plan, bytes] = WeakKeyDictionary()
        # The first one is being written.
        self._unwritten: deque[tuple[Departure, Future[None]]] = deque()
        self._condition = Condition()
        # True after a departure timed out on the disk, until the next write.
        self._stuck = False
        self._hurry = self._closing = False
        self._thread = Thread(target=self._work, name='recordings', daemon=True)
        self._thread.start()

    def wait_for_room(self) -> None:
        """Wait for room in the queue, but not for a stuck disk; call before a departure."""
        with self._condition:
            room = self._condition.wait_for(lambda: not self._full or self._hurry or self._stuck,
                                            _MAX_WAIT)
            self._stuck = self._stuck or not room

    def record(self, departure: Departure) -> Future[None]:
        """Queue a departure; never waits. The future is done when it is on the disk."""
        written: Future[None] = Future()
        with self._condition:
            if not (self._full and self._stuck):
                self._unwritten.append((departure, written))
                self._condition.notify_all()
                return written
        self._finish(written, RecordingFailed(
            Path(self._options.directory),
            f'the disk does not respond, and {_MAX_WAITING} departures wait for it; departure '
            f'{departure.number} is not recorded',
        ))
        return written

    def hurry(self) -> None:
        """Stop all waiting for room, for good: the node shuts down."""
        with self._condition:
            self._hurry = True
            self._condition.notify_all()

    def close(self, seconds: float) -> int:
        """Write the waiting departures, but no longer than this; return how many are left."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        self._thread.join(max(0.0, seconds))
        return len(self._unwritten)

    @property
    def _full(self) -> bool:
        return len(self._unwritten) >= _MAX_WAITING

    def _work(self) -> None:
        if self._options.enabled:
            with suppress(RecordingFailed):  # the first departure will report it
                for path in remove_abandoned(Path(self._options.directory).expanduser()):
                    self._warn(f'recording: removed the unfinished file {path}')
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._unwritten or self._closing)
                if not self._unwritten:
                    return
            self._write(*self._unwritten[0])
            with self._condition:
                self._unwritten.popleft()
                self._stuck = False
                self._condition.notify_all()

    def _write(self, departure: Departure, written: Future[None]) -> None:
        error: AmbushPlannerError | None = None
        try:
            self._record(departure)
        except AmbushPlannerError as known:
            error = known
        except Exception as unknown:  # the thread must live to write the next one
            error = unexpected(unknown)
        forget_frames(error)
        self._finish(written, error)

    def _finish(self, written: Future[None], error: AmbushPlannerError | None) -> None:
        with suppress(Exception):  # during shutdown the node may be unable to report
            self._done(error)
        if error is None:
            written.set_result(None)
        else:
            written.set_exception(error)

    def _record(self, departure: Departure) -> None:
        plan = departure.held.plan
        if plan not in self._strategies:
            self._strategies[plan] = strategy_file(plan.strategy)
        self._recorder.record_departure(recorded_messages(departure), metadata_entries(departure),
                                        attachments(departure, self._strategies[plan]))
