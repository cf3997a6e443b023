"""Run work in one thread, one piece after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, TypeVar

_Result = TypeVar('_Result')


def completed(work: Callable[[], _Result]) -> Future[_Result]:
    """Do ``work`` now and return a future that has its result or its error."""
    future: Future[_Result] = Future()
    try:
        future.set_result(work())
    except Exception as error:
        future.set_exception(error)
    return future


class SerialExecutor:
    """Runs pieces of work in order in a thread called ``name``.

    Parameters
    ----------
    before_each
        Called before each piece of work.
    on_error
        Called with an error of work that has no future.
    closed_error
        Makes the error that refuses work after ``close``.
    """

    def __init__(
        self, name: str, before_each: Callable[[], None], on_error: Callable[[Exception], None],
        closed_error: Callable[[], Exception],
    ) -> None:
        self._before_each, self._on_error = before_each, on_error
        self._closed_error = closed_error
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)

    def submit(self, work: Callable[[], None], future: Future[Any] | None = None) -> None:
        """Queue work that sets ``future``; an error becomes its exception, unless cancelled."""

        def attempt() -> None:
            try:
                self._before_each()
                work()
            except Exception as error:
                self._fail(future, error)

        try:
            self._thread.submit(attempt)
        except RuntimeError:  # the thread has ended
            if future is not None:
                self._fail(future, self._closed_error())

    def finish(self) -> None:
        """Wait until all work submitted so far is done."""
        self._thread.submit(lambda: None).result()

    def close(self) -> None:
        """Refuse further work, and wait until all submitted work is done."""
        self._thread.shutdown()

    def _fail(self, future: Future[Any] | None, error: Exception) -> None:
        if future is None:
            self._on_error(error)
            return
        with suppress(InvalidStateError):  # it has been cancelled
            future.set_exception(error)
