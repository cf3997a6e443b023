"""Departures are recorded in a thread of their own: nobody waits for the disk."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Thread
from weakref import WeakKeyDictionary

from ..core.errors import AmbushPlannerError
from ..core.planner import Plan
from ..recording import Recorder, RecordingFailed
from ..recording.repair import repair
from ..worker.errors import unexpected
from .departures import (
    Departure,
    recorded_messages,
    recorded_metadata,
    strategy_attachment,
    strategy_file,
)
from .parameters import RecordingOptions

# Departures that may wait for the disk. Few enough that all of them are written when the node is
# told to end.
_LONGEST_QUEUE = 16
# How long the next one waits for a place [s]: a disk that is that slow does not answer at all, and
# until it does, no other one waits.
_PATIENCE = 0.5
_LOOK_UP = 0.05  # s; how soon the end is noticed


class Recordings:
    """Writes departures one after the other, each as its own parameters say.

    Parameters
    ----------
    options
        Those that the node starts with: what a crash has left in their folder is put right.
    done
        Called from the thread after each departure: with its recording's options, and with what
        went wrong or None.
    repaired
        Called with what an earlier crash had left behind, a line each.
    """

    def __init__(
        self,
        options: RecordingOptions,
        done: Callable[[RecordingOptions, AmbushPlannerError | None], None],
        repaired: Callable[[str], None],
    ) -> None:
        self._done, self._repaired = done, repaired
        self._options: RecordingOptions | None = None
        self._recorder: Recorder | None = None
        self._strategies: WeakKeyDictionary[Plan, bytes] = WeakKeyDictionary()
        self._queue: Queue[Departure] = Queue(_LONGEST_QUEUE)
        self._closing = self._stuck = False
        if options.enabled:
            Thread(target=self._repair, args=(options,), name='repair', daemon=True).start()
        self._thread = Thread(target=self._work, name='recordings', daemon=True)
        self._thread.start()

    def record(self, departure: Departure) -> None:
        """Queue a departure.

        Raises
        ------
        RecordingFailed
            The disk does not answer, and too many departures wait for it already.
        """
        try:
            self._queue.put(departure, block=not self._stuck, timeout=_PATIENCE)
        except Full as error:
            self._stuck = True
            raise RecordingFailed(
                Path(departure.parameters.recording.directory),
                f'{_LONGEST_QUEUE} departures wait for the disk, which does not answer; departure '
                f'{departure.number} is not recorded',
            ) from error

    def close(self, seconds: float) -> int:
        """Write what waits, but for no longer than this; return how many are not written."""
        deadline, self._closing = time.monotonic() + seconds, True
        self._thread.join(max(0.0, deadline - time.monotonic()))
        return self._queue.unfinished_tasks

    def _work(self) -> None:
        while True:
            try:
                departure = self._queue.get(timeout=_LOOK_UP)
            except Empty:
                if self._closing:
                    break
                continue
            self._write(departure)
            del departure  # with its plan, until the next one comes
            self._queue.task_done()
            self._stuck = False
        if self._recorder is not None:
            self._recorder.close()

    def _write(self, departure: Departure) -> None:
        error: AmbushPlannerError | None = None
        try:
            self._record(departure)
        except AmbushPlannerError as known:
            error = known
        except Exception as unknown:  # nothing may end the thread that writes the next one
            error = unexpected(unknown)
        # A node that is shutting down may be unable to tell anybody.
        with suppress(Exception):
            self._done(departure.parameters.recording, error)

    def _record(self, departure: Departure) -> None:
        if departure.plan not in self._strategies:
            self._strategies[departure.plan] = strategy_file(departure.plan.strategy)
        data = self._strategies[departure.plan]
        self._recorder_for(departure.parameters.recording).record_departure(
            recorded_messages(departure),
            recorded_metadata(departure, data),
            [strategy_attachment(data)],
        )

    def _recorder_for(self, options: RecordingOptions) -> Recorder:
        if self._recorder is None or options != self._options:
            if self._recorder is not None:
                self._recorder.close()
            self._recorder = Recorder(Path(options.directory).expanduser(), options.compression)
            self._options = options
        return self._recorder

    def _repair(self, options: RecordingOptions) -> None:
        for found in repair(Path(options.directory).expanduser()):
            self._repaired(str(found))
