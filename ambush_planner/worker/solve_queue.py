# SPDX-License-Identifier: Apache-2.0
"""A queue of solves for one worker process: equal solves are shared and can be cancelled."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Thread
from typing import Generic, TypeVar

from ..errors import AmbushPlannerError
from ..planning.plan import Plan, PlanRequest
from .process import WorkerParent, WorkerProcess
from .solve_errors import QueueFull, SolveCancelled, WorkerFailed, known, shutting_down

# Maximum number of solves that wait, besides the running and the background ones.
_MAX_WAITING = 8
_SUPERSEDED = 'a newer solve replaced this background solve'
_WITHDRAWN = 'all callers have withdrawn'

_Key = TypeVar('_Key', bound=Hashable)
_Result = TypeVar('_Result')


@dataclass(eq=False)
class _Solve(Generic[_Key, _Result]):
    """A waiting or running solve; ``cancelled`` is the reason if it was cancelled.

    ``waiters`` callers wait for its outcome. Without any it is a background solve, as is what
    ``refines`` a plan that callers have.
    """

    key: _Key
    request: PlanRequest
    finish: Callable[[Plan], _Result]
    waiters: int = 0
    outcome: Future[_Result] = field(default_factory=Future)
    cancelled: str = ''

    @property
    def refines(self) -> bool:
        return self.outcome.done()

    @property
    def background(self) -> bool:
        return self.refines or not self.waiters


class SolveQueue(Generic[_Key, _Result]):
    """Passes solves to one worker process, which it replaces if it died.

    ``check`` raises what solves are refused with, if they are; ``report`` gets the error of a
    refinement that failed, whose callers have the first plan.
    """

    def __init__(self, check: Callable[[], None],
                 report: Callable[[AmbushPlannerError], None] = lambda _: None) -> None:
        self._check, self._report = check, report
        self._condition = Condition()
        self._waiting: dict[_Key, _Solve[_Key, _Result]] = {}
        self._running: _Solve[_Key, _Result] | None = None
        self._parent = WorkerParent()
        self._worker: WorkerProcess | None = None
        self._closed = False
        self._thread = Thread(target=self._work, name='solves', daemon=True)
        self._thread.start()

    @property
    def activity(self) -> tuple[bool, bool]:
        """Return whether solves run or wait, and whether a plan is refined or is to be."""
        with self._condition:
            refines = {each.refines for each in self._unfinished}
            return False in refines, True in refines

    @property
    def keys(self) -> list[_Key]:
        """The keys of the solves that can be shared, the running one first."""
        with self._condition:
            return [each.key for each in self._unfinished
                    if not (each.cancelled or each.refines)]

    @property
    def _unfinished(self) -> list[_Solve[_Key, _Result]]:
        running = [self._running] if self._running else []
        return [*running, *self._waiting.values()]

    def submit(self, key: _Key, request: PlanRequest, finish: Callable[[Plan], _Result],
               background: bool = False) -> Future[_Result]:
        """Queue a solve, or share the outcome of one with the same key.

        If the request wants a ``first`` plan, that is the outcome, and refined in the background.
        The future raises the errors of ``WorkerProcess.solve``, or SolveCancelled.

        Parameters
        ----------
        finish
            Makes the outcome from a plan, in the queue's thread; it is called with each plan.
        background
            No caller waits for it: it runs after all others, and the next solve of any kind
            replaces it, unless it is for the same key.

        Raises what the queue refuses solves with, and QueueFull if too many wait.
        """
        with self._condition:
            self._check()
            if self._closed:
                raise shutting_down()
            solve = next((each for each in self._unfinished
                          if each.key == key and not each.cancelled
                          and (background or not each.refines)), None)
            superseded: list[_Solve[_Key, _Result]] = []
            if solve is None:
                if not background:
                    self._check_room()
                superseded = self._end_background(running=not background)
                solve = _Solve(key, request, finish)
                self._waiting[key] = solve
                self._condition.notify()
            solve.waiters += not background
        _end(superseded, _SUPERSEDED)
        return solve.outcome

    def withdraw(self, outcome: Future[_Result]) -> None:
        """A caller no longer waits for ``outcome``: end its solve if nobody else does."""
        with self._condition:
            here = [each for each in self._unfinished
                    if each.outcome is outcome and not each.refines]
            for solve in here:
                solve.waiters -= 1
            ended = [solve for solve in here if not solve.waiters]
            if self._running in ended:
                self._end_running(_WITHDRAWN)
            waited = [self._waiting.pop(each.key) for each in ended if each is not self._running]
        _end(waited, _WITHDRAWN)

    def cancel(self, why: str) -> bool:
        """Cancel all solves; False: there are none."""
        with self._condition:
            waiting, self._waiting = list(self._waiting.values()), {}
            running = self._running is not None and not self._running.cancelled
            self._end_running(why)
        _end(waiting, why)
        return running or bool(waiting)

    def close(self) -> None:
        """Cancel all solves and end the worker process."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        self.cancel(str(shutting_down()))
        self._thread.join()

    def _end_background(self, running: bool) -> list[_Solve[_Key, _Result]]:
        """Take background solves off the queue and return them; end the one that is ``running``."""
        waiting = [each for each in self._waiting.values() if each.background]
        for each in waiting:
            del self._waiting[each.key]
        if running and self._running is not None and self._running.background:
            self._end_running(_SUPERSEDED)
        return waiting

    def _check_room(self) -> None:
        running = self._running
        waiting = sum(not each.background for each in self._waiting.values())
        # If none is running, the first waiting solve is about to begin.
        if waiting - (running is None) < _MAX_WAITING:
            return
        raise QueueFull(f'a solve is running and {_MAX_WAITING} others are waiting; try again '
                        'later, or call cancel')

    def _end_running(self, why: str) -> None:
        if self._running is not None:
            self._running.cancelled = self._running.cancelled or why
            if self._worker is not None:
                self._worker.kill()

    def _work(self) -> None:
        # Only this thread starts workers, which die with it.
        try:
            with suppress(WorkerFailed):  # the first solve reports it
                self._living_worker()
            while (solve := self._next()) is not None:
                self._answer(solve)
                del solve  # frees its map
        finally:
            if self._worker is not None:
                self._worker.close()
            self._parent.close()

    def _next(self) -> _Solve[_Key, _Result] | None:
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            key = min(self._waiting, key=lambda key: self._waiting[key].background)
            self._running = self._waiting.pop(key)
            return self._running

    def _answer(self, solve: _Solve[_Key, _Result]) -> None:
        result: _Result | None = None
        error: AmbushPlannerError | None = None
        try:
            worker = self._living_worker()
            if solve.cancelled:  # before there was a worker to kill
                raise SolveCancelled(solve.cancelled)
            result = solve.finish(worker.solve(solve.request))
            if solve.request.first:
                with self._condition:
                    if not solve.cancelled:
                        solve.outcome.set_result(result)
                solve.finish(worker.next_plan(solve.request))
        except Exception as raised:  # also MemoryError: callers wait for an outcome
            error = known(raised)
            if error is not raised and self._worker is not None:
                self._worker.kill()
        with self._condition:
            self._running = None
        if solve.outcome.done():
            if error is not None and not solve.cancelled:
                self._report(error)
        elif solve.cancelled:
            solve.outcome.set_exception(SolveCancelled(solve.cancelled))
        elif error is not None:
            solve.outcome.set_exception(error)
        else:
            solve.outcome.set_result(result)  # type: ignore[arg-type]

    def _living_worker(self) -> WorkerProcess:
        if self._worker is not None and not self._worker.alive:
            self._worker.close()
            with self._condition:
                self._worker = None  # also if no other one can be started
        if self._worker is None:
            try:
                worker = WorkerProcess(self._parent)
            except OSError as error:
                raise WorkerFailed(f'the worker process cannot be started: {error}') from error
            with self._condition:
                self._worker = worker
        return self._worker


def _end(solves: list[_Solve[_Key, _Result]], why: str) -> None:
    for solve in solves:
        solve.outcome.set_exception(SolveCancelled(why))
