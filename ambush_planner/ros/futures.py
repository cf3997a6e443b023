"""Outcomes that come later, without a thread that waits for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

_Result = TypeVar('_Result')


def settle(outcome: Future[_Result], work: Callable[[], _Result]) -> None:
    """Give ``outcome`` what ``work`` returns or raises."""
    try:
        result = work()
    except Exception as error:
        outcome.set_exception(error)
    else:
        outcome.set_result(result)


def done(work: Callable[[], _Result]) -> Future[_Result]:
    """Return a future that has the outcome of ``work`` already."""
    outcome: Future[_Result] = Future()
    settle(outcome, work)
    return outcome
