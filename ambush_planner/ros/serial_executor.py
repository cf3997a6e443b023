# SPDX-License-Identifier: Apache-2.0
"""Run work in one thread, one piece after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, TypeVar

from ..worker.solve_errors import shutting_down

_Result = TypeVar('_Result')


def future_of(work: Callable[[], Future[_Result]]) -> Future[_Result]:
    """Start work; an error becomes the exception of the future."""
    try:
        return work()
    except Exception as error:
        failed: Future[_Result] = Future()
        failed.set_exception(error)
        return failed


class SerialExecutor:
    """Runs pieces of work in order in a thread called ``name``.

    ``on_error`` gets errors of work that has no future. Each piece is preceded by a call of
    ``before_each``. Work after ``close`` is refused with SolveCancelled.
    """

    def __init__(self, name: str, on_error: Callable[[Exception], None],
                 before_each: Callable[[], None] = lambda: None) -> None:
        self._on_error, self._before_each = on_error, before_each
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)

    def submit(self, work: Callable[[], None], future: Future[Any] | None = None) -> None:
        """Queue work that sets ``future``; an error becomes its exception, unless cancelled."""

        def fail(error: Exception) -> None:
            if future is None:
                self._on_error(error)
                return
            with suppress(InvalidStateError):  # it has been cancelled
                future.set_exception(error)

        def attempt() -> None:
            try:
                self._before_each()
                work()
            except Exception as error:
                fail(error)

        try:
            self._thread.submit(attempt)
        except RuntimeError:  # the thread has ended
            if future is not None:
                fail(shutting_down())

    def submit_after(self, awaited: Future[_Result], work: Callable[[Future[_Result]], None],
                     future: Future[Any] | None = None) -> None:
        """Queue work, as ``submit`` does, once another future is done, which it is given."""
        awaited.add_done_callback(lambda done: self.submit(lambda: work(done), future))

    def finish(self) -> None:
        """Wait until all work submitted so far is done."""
        self._thread.submit(lambda: None).result()

    def close(self) -> None:
        """Refuse further work, and wait until all submitted work is done."""
        self._thread.shutdown()
