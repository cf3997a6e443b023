"""Outcomes that come later, without a thread that waits for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, TypeVar

_Result = TypeVar('_Result')


def done(work: Callable[[], _Result]) -> Future[_Result]:
    """Return a future that has the outcome of ``work`` already."""
    outcome: Future[_Result] = Future()
    try:
        outcome.set_result(work())
    except Exception as error:
        outcome.set_exception(error)
    return outcome


class SerialExecutor:
    """Work is done one piece after the other, in a thread called ``name``.

    Parameters
    ----------
    first
        Called before each piece.
    failed
        Called with an error of work that nobody waits for.
    ended
        Makes the error that work is refused with once this is closed.
    """

    def __init__(
        self, name: str, first: Callable[[], None], failed: Callable[[Exception], None],
        ended: Callable[[], Exception],
    ) -> None:
        self._first, self._failed, self._ended = first, failed, ended
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)

    def do(self, work: Callable[[], None], outcome: Future[Any] | None = None) -> None:
        """Have work done in its turn; an error is the outcome, unless that has been cancelled."""

        def attempt() -> None:
            try:
                self._first()
                work()
            except Exception as error:
                self._fail(outcome, error)

        try:
            self._thread.submit(attempt)
        except RuntimeError:  # the thread has ended
            if outcome is not None:
                self._fail(outcome, self._ended())

    def finish(self) -> None:
        """Wait until all is done that was to be done before this call."""
        self._thread.submit(lambda: None).result()

    def close(self) -> None:
        """Do what is still to be done, and refuse work from now on."""
        self._thread.shutdown()

    def _fail(self, outcome: Future[Any] | None, error: Exception) -> None:
        if outcome is None:
            self._failed(error)
            return
        with suppress(InvalidStateError):  # it has been cancelled
            outcome.set_exception(error)
