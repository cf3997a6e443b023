"""Solves one after the other: equal ones shared, as many as may wait, ended on request."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Thread
from typing import Generic, TypeVar

from ..errors import AmbushPlannerError
from ..planning.plan import Plan, PlanRequest
from .process import WorkerProcess
from .solve_errors import QueueFull, SolveCancelled, WorkerFailed, forget_frames, unexpected

_CANCELLED = 'the solve was cancelled'
_CLOSING = 'the planner is shutting down'
_SUPERSEDED = 'a later map has taken the place of this one'
_WITHDRAWN = 'nobody waits for this solve any more'

_Result = TypeVar('_Result')


@dataclass(eq=False)
class _Solve(Generic[_Result]):
    """A solve that waits or runs; ``cancelled`` says why, once it is.

    So many ``waiters`` wait for it; where there are none, it is one in the background. ``lasting``
    says that it is wanted without them, too.
    """

    key: Hashable
    request: PlanRequest
    finish: Callable[[Plan], _Result]
    lasting: bool
    waiters: int
    outcome: Future[_Result] = field(default_factory=Future)
    begin: float = 0.0
    cancelled: str = ''

    @property
    def background(self) -> bool:
        return not self.waiters


class SolveQueue(Generic[_Result]):
    """Hands solves to one worker process, and replaces the process when it has died."""

    def __init__(self) -> None:
        self._condition = Condition()
        self._waiting: dict[Hashable, _Solve[_Result]] = {}
        self._running: _Solve[_Result] | None = None
        # Its outcome is being told: it can still be shared, but no longer be ended.
        self._finished: _Solve[_Result] | None = None
        self._worker: WorkerProcess | None = None
        self._closed = False
        # A daemon only in case nobody calls close.
        self._thread = Thread(target=self._work, name='solves', daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether a solve runs or waits."""
        with self._condition:
            return self._running is not None or bool(self._waiting)

    def submit(
        self,
        key: Hashable,
        request: PlanRequest,
        finish: Callable[[Plan], _Result],
        size: int,
        background: bool = False,
    ) -> Future[_Result]:
        """Queue a solve; where one with the same key waits or runs, its outcome is this one's too.

        The future raises what ``WorkerProcess.solve`` raises, or SolveCancelled.

        Parameters
        ----------
        finish
            Makes the outcome of the plan, in the thread of the queue.
        size
            How many solves may wait, beside the one that runs and the one in the background.
        background
            Nobody waits for it: it is put behind those that somebody waits for, and takes the
            place of others in the background that have not begun.

        Raises
        ------
        SolveCancelled
            The queue is closed.
        QueueFull
            As many solves wait as may.
        """
        with self._condition:
            if self._closed:
                raise SolveCancelled(_CLOSING)
            solve = self._same(key)
            if solve is not None:
                solve.lasting = solve.lasting or background
                solve.waiters += not background
                return solve.outcome
            superseded = self._drop_background() if background else []
            waiting = sum(not each.background for each in self._waiting.values())
            # Where none runs yet, the first of those that wait is about to.
            if not background and waiting - (self._running is None) >= size:
                raise QueueFull(self._what_is_busy(size))
            solve = _Solve(key, request, finish, background, int(not background))
            self._waiting[key] = solve
            self._condition.notify()
        _end(superseded, _SUPERSEDED)
        return solve.outcome

    def withdraw(self, outcome: Future[_Result]) -> None:
        """Tell that one who asked no longer waits: a solve that nobody wants any more is ended."""
        with self._condition:
            here = [each for each in (self._running, *self._waiting.values())
                    if each is not None and each.outcome is outcome]
            for solve in here:
                solve.waiters -= 1
            ended = [solve for solve in here if not solve.waiters and not solve.lasting]
            if self._running in ended:
                self._end_running(_WITHDRAWN)
            waited = [self._waiting.pop(each.key) for each in ended if each is not self._running]
        _end(waited, _WITHDRAWN)

    def withdraw_background(self) -> None:
        """Withdraw the solves in the background that have not begun."""
        with self._condition:
            withdrawn = self._drop_background()
        _end(withdrawn, _SUPERSEDED)

    def cancel(self) -> int:
        """End the solve that runs and all that wait; return how many there were."""
        with self._condition:
            waiting, self._waiting = list(self._waiting.values()), {}
            running = self._running is not None and not self._running.cancelled
            self._end_running(_CANCELLED)
        _end(waiting, _CANCELLED)
        return len(waiting) + running

    def close(self) -> None:
        """End all solves, and the worker process with them."""
        with self._condition:
            self._closed = True
            self._end_running(_CLOSING)
            waiting, self._waiting = list(self._waiting.values()), {}
            self._condition.notify()
        _end(waiting, _CLOSING)
        self._thread.join()

    def _same(self, key: Hashable) -> _Solve[_Result] | None:
        for solve in (self._running, self._finished, self._waiting.get(key)):
            if solve is not None and solve.key == key and not solve.cancelled:
                return solve
        return None

    def _drop_background(self) -> list[_Solve[_Result]]:
        dropped = [solve for solve in self._waiting.values() if solve.background]
        for solve in dropped:
            del self._waiting[solve.key]
        return dropped

    def _what_is_busy(self, size: int) -> str:
        running = self._running
        since = f' (for {time.monotonic() - running.begin:.1f} s)' if running else ''
        return (
            f'a solve runs{since} and {size} others wait, the most that may (queue.size); ask '
            'again later, or call cancel'
        )

    def _end_running(self, why: str) -> None:
        if self._running is not None:
            self._running.cancelled = self._running.cancelled or why
            if self._worker is not None:
                self._worker.kill()

    def _work(self) -> None:
        # The process is started in this thread and no other: it dies with the one it is from.
        try:
            self._warm_up()
            while (solve := self._next()) is not None:
                self._answer(solve)
                del solve  # with its map, until the next one comes
                self._warm_up()
        finally:
            if self._worker is not None:
                self._worker.close()

    def _warm_up(self) -> None:
        """Have a worker ready before it is needed."""
        if not self._closed:
            # What keeps it from starting is told to whoever needs it.
            with suppress(WorkerFailed):
                self._living_worker()

    def _next(self) -> _Solve[_Result] | None:
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            key = min(self._waiting, key=lambda key: self._waiting[key].background)
            self._running = self._waiting.pop(key)
            self._running.begin = time.monotonic()
            return self._running

    def _answer(self, solve: _Solve[_Result]) -> None:
        result: _Result | None = None
        error: AmbushPlannerError | None = None
        try:
            result = solve.finish(self._solve(solve))
        except AmbushPlannerError as known:
            error = known
        except Exception as unknown:
            # Say, no memory for the plan here. Whatever it is: somebody waits for the outcome.
            error = unexpected(unknown)
            forget_frames(unknown)
            if self._worker is not None:
                self._worker.kill()
        forget_frames(error)
        with self._condition:
            self._running, self._finished = None, solve
        if solve.cancelled:
            solve.outcome.set_exception(SolveCancelled(solve.cancelled))
        elif error is not None:
            solve.outcome.set_exception(error)
        else:
            solve.outcome.set_result(result)  # type: ignore[arg-type]
        with self._condition:
            self._finished = None

    def _solve(self, solve: _Solve[_Result]) -> Plan:
        worker = self._living_worker()
        # Cancelled before the worker was there to be killed.
        if solve.cancelled:
            raise SolveCancelled(solve.cancelled)
        return worker.solve(solve.request)

    def _living_worker(self) -> WorkerProcess:
        if self._worker is None or not self._worker.alive:
            if self._worker is not None:
                self._worker.close()
            try:
                worker = WorkerProcess()
            except OSError as error:
                raise WorkerFailed(f'the worker process cannot be started: {error}') from error
            with self._condition:
                self._worker = worker
        return self._worker


def _end(solves: list[_Solve[_Result]], why: str) -> None:
    for solve in solves:
        solve.outcome.set_exception(SolveCancelled(why))
