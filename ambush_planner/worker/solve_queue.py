"""Solves one after the other: equal ones shared, the running one ended on request."""

from __future__ import annotations

from collections.abc import Hashable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Thread

from ..core.errors import AmbushPlannerError
from ..core.planner import Plan, PlanRequest
from .errors import SolveCancelled, WorkerFailed, forget_frames, unexpected
from .process import WorkerProcess

_CANCELLED = 'the solve was cancelled'
_CLOSING = 'the planner is shutting down'


@dataclass(eq=False)
class _Solve:
    """A solve that somebody waits for; ``cancelled`` says why, once it is."""

    key: Hashable
    request: PlanRequest
    plan: Future[Plan] = field(default_factory=Future)
    cancelled: str = ''


class SolveQueue:
    """Hands solves to one worker process, and replaces the process when it has died."""

    def __init__(self) -> None:
        self._condition = Condition()
        self._waiting: dict[Hashable, _Solve] = {}
        self._running: _Solve | None = None
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

    def submit(self, key: Hashable, request: PlanRequest) -> Future[Plan]:
        """Queue a solve; where one with the same key waits or runs, its outcome is this one's too.

        The future raises what ``WorkerProcess.solve`` raises, or SolveCancelled.

        Raises
        ------
        SolveCancelled
            The queue is closed.
        """
        with self._condition:
            if self._closed:
                raise SolveCancelled(_CLOSING)
            running = self._running
            if running is not None and running.key == key and not running.cancelled:
                return running.plan
            solve = self._waiting.setdefault(key, _Solve(key, request))
            self._condition.notify()
            return solve.plan

    def cancel(self) -> bool:
        """End the solve whose turn it is; return whether there was one. Those behind it go on."""
        with self._condition:
            if self._running is not None:
                self._end_running(_CANCELLED)
                return True
            # Nothing that was submitted is out of reach, also before it has begun.
            if not self._waiting:
                return False
            solve = self._waiting.pop(next(iter(self._waiting)))
        solve.plan.set_exception(SolveCancelled(_CANCELLED))
        return True

    def close(self) -> None:
        """End all solves, and the worker process with them."""
        with self._condition:
            self._closed = True
            self._end_running(_CLOSING)
            waiting, self._waiting = list(self._waiting.values()), {}
            self._condition.notify()
        for solve in waiting:
            solve.plan.set_exception(SolveCancelled(_CLOSING))
        self._thread.join()

    def _end_running(self, why: str) -> None:
        if self._running is not None:
            self._running.cancelled = why
            if self._worker is not None:
                self._worker.kill()

    def _work(self) -> None:
        # The process is started in this thread and no other: it dies with the one it is from.
        try:
            self._warm_up()
            while (solve := self._next()) is not None:
                self._answer(solve)
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

    def _next(self) -> _Solve | None:
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            self._running = self._waiting.pop(next(iter(self._waiting)))
            return self._running

    def _answer(self, solve: _Solve) -> None:
        try:
            outcome: Plan | AmbushPlannerError = self._solve(solve)
        except AmbushPlannerError as error:
            outcome = error
        except Exception as error:
            # Say, no memory for the plan here. Whatever it is: somebody waits for the outcome.
            outcome = unexpected(error)
            forget_frames(error)
            if self._worker is not None:
                self._worker.kill()
        with self._condition:
            self._running = None
        if isinstance(outcome, AmbushPlannerError):
            forget_frames(outcome)
        if solve.cancelled:
            solve.plan.set_exception(SolveCancelled(solve.cancelled))
        elif isinstance(outcome, AmbushPlannerError):
            solve.plan.set_exception(outcome)
        else:
            solve.plan.set_result(outcome)

    def _solve(self, solve: _Solve) -> Plan:
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
