"""Departures are recorded in a thread of their own: nobody waits for the disk."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from weakref import WeakKeyDictionary

from ..errors import AmbushPlannerError
from ..planning.node_parameters import RecordingOptions
from ..planning.plan import Plan
from ..recordings import Recorder, RecordingFailed
from ..recordings.repair import repair
from ..recordings.strategy_file import strategy_file
from ..worker.solve_errors import forget_frames, unexpected
from .departure_record import (
    Departure,
    attachments,
    map_changes,
    recorded_messages,
    recorded_metadata,
)

# Writing [s] that may wait for the disk: little enough that all of it is done when the node is
# told to end. The next departure waits until there is no more.
_MOST_BACKLOG = 0.25
# A write that takes longer [s] is of a disk that does not answer. Nobody waits for that one, but
# only so many departures are kept for it.
_PATIENCE, _MOST_KEPT = 2.0, 16
_LOOK_UP = 0.05  # s; how soon that is noticed


class Recordings:
    """Writes departures one after the other, each as its own parameters say.

    Parameters
    ----------
    options
        Those that the node starts with: what a crash has left in their folder is put right.
    done
        Called for each departure once it is written or given up: with its recording's options, and
        with what went wrong or None.
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
        # What the last write of a plan's departures took [s].
        self._costs: WeakKeyDictionary[Plan, float] = WeakKeyDictionary()
        # What is not written yet; the first one is being written since `_begin`.
        self._unwritten: deque[Departure] = deque()
        self._begin = 0.0
        self._condition = Condition()
        self._hurry = self._closing = False
        if options.enabled:
            Thread(target=self._repair, args=(options,), name='repair', daemon=True).start()
        self._thread = Thread(target=self._work, name='recordings', daemon=True)
        self._thread.start()

    def wait_for_room(self) -> None:
        """Wait while more writing waits than may: before somebody departs, never after."""
        with self._condition:
            while self._backlog() > _MOST_BACKLOG and not self._hurry and not self._stuck():
                self._condition.wait(_LOOK_UP)

    def record(self, departure: Departure) -> None:
        """Queue a departure, if it is to be recorded; never waits."""
        options = departure.parameters.recording
        if not options.enabled:
            return
        with self._condition:
            given_up = self._stuck() and len(self._unwritten) > _MOST_KEPT
            if not given_up:
                if not self._unwritten:
                    self._begin = time.monotonic()
                self._unwritten.append(departure)
                self._condition.notify_all()
        if given_up:
            self._done(options, RecordingFailed(
                Path(options.directory),
                f'{_MOST_KEPT} departures wait for the disk, which does not answer; departure '
                f'{departure.number} is not recorded',
            ))

    def hurry(self) -> None:
        """Let nobody wait any more, now and from now on: the node ends."""
        with self._condition:
            self._hurry = True
            self._condition.notify_all()

    def close(self, seconds: float) -> int:
        """Write what waits, but for no longer than this; return how many are not written."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        self._thread.join(max(0.0, seconds))
        return len(self._unwritten)

    def _backlog(self) -> float:
        # How long the first one of a plan takes nobody knows: it is waited for.
        return sum(self._costs.get(each.held.plan, math.inf) for each in self._unwritten)

    def _stuck(self) -> bool:
        return bool(self._unwritten) and time.monotonic() - self._begin > _PATIENCE

    def _work(self) -> None:
        while (departure := self._next()) is not None:
            self._write(departure)
            with self._condition:
                now = time.monotonic()
                self._costs[departure.held.plan], self._begin = now - self._begin, now
                self._unwritten.popleft()
                self._condition.notify_all()
            del departure  # with its plan, until the next one comes
        if self._recorder is not None:
            self._recorder.close()

    def _next(self) -> Departure | None:
        with self._condition:
            self._condition.wait_for(lambda: self._unwritten or self._closing)
            return self._unwritten[0] if self._unwritten else None

    def _write(self, departure: Departure) -> None:
        error: AmbushPlannerError | None = None
        try:
            self._record(departure)
        except AmbushPlannerError as known:
            error = known
        except Exception as unknown:  # nothing may end the thread that writes the next one
            error = unexpected(unknown)
        forget_frames(error)
        # A node that is shutting down may be unable to tell anybody.
        with suppress(Exception):
            self._done(departure.parameters.recording, error)

    def _record(self, departure: Departure) -> None:
        plan = departure.held.plan
        if plan not in self._strategies:
            self._strategies[plan] = strategy_file(plan.strategy)
        data, changes = self._strategies[plan], map_changes(departure)
        self._recorder_for(departure.parameters.recording).record_departure(
            recorded_messages(departure),
            recorded_metadata(departure, data, changes),
            attachments(data, changes),
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
