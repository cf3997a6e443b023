"""A service that answers later: its callback begins the work and keeps no thread waiting."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, Generic, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from .qos import REQUESTS

_Result = TypeVar('_Result')


class DeferredService(Generic[_Result]):
    """A service of ``node`` whose answer is sent when its work is done, by whichever thread did it.

    In rclpy a callback has to return the response: one that waits for it keeps a thread of the
    executor, and one that awaits it is polled, which keeps a processor.

    Parameters
    ----------
    kind, name
        The service's type and name.
    begin
        Starts the work for a request; must not raise.
    answer
        Makes the response of the work's outcome; must not raise.
    answered
        Called with the result and the response once the response is sent; not after an error.
    group
        Requests of one group are taken one after the other.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        name: str,
        begin: Callable[[Any], Future[_Result]],
        answer: Callable[[Future[_Result]], Any],
        group: CallbackGroup,
        answered: Callable[[_Result, Any], None] = lambda result, response: None,
    ) -> None:
        self._answer, self._answered = answer, answered
        service: Any = node.create_service(
            kind, name, lambda request, _: begin(request), qos_profile=REQUESTS,
            callback_group=group,
        )
        self._send = service.send_response
        # What rclpy takes for the response is the future of it.
        service.send_response = self._send_when_done

    def _send_when_done(self, pending: Future[_Result], header: Any) -> None:
        pending.add_done_callback(partial(self._respond, header))

    def _respond(self, header: Any, done: Future[_Result]) -> None:
        response = self._answer(done)
        # The service, or the client that asked, may be gone by now, which rclpy's own errors say.
        with suppress(RuntimeError):
            self._send(response, header)
        if done.exception() is None:
            self._answered(done.result(), response)
