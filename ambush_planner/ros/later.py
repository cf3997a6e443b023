"""Answers of services that come later, without a thread that waits for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from rclpy.service import Service

_First, _Second = TypeVar('_First'), TypeVar('_Second')


def then(
    first: Future[_First],
    work: Callable[[Future[_First]], _Second],
    submit: Callable[[Callable[[], None]], object],
) -> Future[_Second]:
    """Submit ``work`` with ``first`` once it is done; return the work's outcome.

    That is an error of ``submit``, too.
    """
    outcome: Future[_Second] = Future()

    # `first` keeps its callbacks: none of them may hold it, or it and all that hangs on it would
    # stay until Python looks for cycles.
    def settle(done: Future[_First]) -> None:
        try:
            outcome.set_result(work(done))
        except Exception as error:
            outcome.set_exception(error)

    def begin(done: Future[_First]) -> None:
        try:
            submit(partial(settle, done))
        except Exception as error:
            outcome.set_exception(error)

    first.add_done_callback(begin)
    return outcome


def answers_later(service: Service) -> None:
    """Let the callback of a service return a future of its response instead of the response.

    In rclpy a callback has to return the response: one that waits for it keeps a thread of the
    executor, and one that awaits it is polled, which keeps a processor.
    """
    service.send_response = partial(_send, service.send_response)


def _send(send: Callable[[Any, Any], None], response: Any, header: Any) -> None:
    if not isinstance(response, Future):
        send(response, header)
        return

    def deliver(done: Future) -> None:
        # The service or who asked may be gone by now, which rclpy's own errors say.
        with suppress(RuntimeError):
            send(done.result(), header)

    response.add_done_callback(deliver)
