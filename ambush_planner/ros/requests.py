# SPDX-License-Identifier: Apache-2.0
"""The services of the node: each starts work and answers when its future is done."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from geometry_msgs.msg import PoseArray
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..errors import InvalidOption
from ..planning.plan import Plan
from ..recordings.messages import type_name
from ..recordings.metadata import RecordedCall
from .conversions import fields_of
from .departure_record import Answer
from .dispatcher import Dispatcher
from .errors import ErrorBoundary, send_until_known
from .serial_executor import future_of
from .topics import REQUESTS
from .trip import TripRequest

_Result = TypeVar('_Result')


class Requests:
    """The services of ``node``, which answer in all of its lifecycle states.

    ``error_boundary`` logs and reports errors; ``dispatcher`` returns that of a configured node, or
    raises Refusal.
    """

    def __init__(self, node: Node, error_boundary: ErrorBoundary,
                 dispatcher: Callable[[], Dispatcher]) -> None:
        self._node, self._error_boundary, self._dispatcher = node, error_boundary, dispatcher
        planning = MutuallyExclusiveCallbackGroup()
        self._serve(Trigger, '~/new_route', lambda request: self._ask(
            Trigger, '~/new_route', request, self._dispatcher().inputs.latest_request(), 'topics'),
                    self._new_route_response, planning)
        self._serve(GetPlan, '~/get_plan', self.start_plan,
                    lambda answer: GetPlan.Response(plan=answer.path.message), planning)
        self._serve(Trigger, '~/replan', lambda _: self._dispatcher().replan(), _replan_response,
                    planning)
        self._serve(Trigger, '~/cancel', self._cancel, _cancel_response,
                    MutuallyExclusiveCallbackGroup())

    def start_plan(self, request: GetPlan.Request, stops: PoseArray | None = None,
                   client: str = '') -> Future[Answer]:
        """Ask for a path between the poses of a request, for a ``client`` with one goal."""
        if not 0.0 <= request.tolerance < math.inf:
            raise InvalidOption(f'tolerance must be finite and >= 0 [m], got {request.tolerance}')
        trip = self._dispatcher().inputs.request_between(
            request.start, request.goal, request.tolerance, stops or PoseArray())
        return self._ask(GetPlan, '~/get_plan', request, trip, client)

    def _serve(self, kind: Any, name: str, start: Callable[[Any], Future[_Result]],
               to_response: Callable[[_Result], Any], group: CallbackGroup) -> None:
        """Serve work that ``start`` starts; the thread that finishes it sends the answer.

        In rclpy a callback has to return the response: one that waits for it blocks a thread of
        the executor, and one that awaits it is polled, which takes a whole core.
        """
        service: Any = self._node.create_service(
            kind, name, lambda request, _: future_of(partial(start, request)), qos_profile=REQUESTS,
            callback_group=group,
        )
        send = partial(send_until_known, service.send_response)

        def respond(header: Any, future: Future[_Result]) -> None:
            response, error = self._error_boundary.attempt(
                name.removeprefix('~/'), 'request', lambda: to_response(future.result())
            )
            if response is None:
                response = _failure(error) if kind is Trigger else kind.Response()
            # rclpy raises RuntimeError if the service or the client no longer exists.
            with suppress(RuntimeError):
                send(response, header)

        # rclpy passes on what the callback returns: the future of the response.
        service.send_response = lambda future, header: future.add_done_callback(
            partial(respond, header)
        )

    def _cancel(self, _: Trigger.Request) -> Future[bool]:
        done: Future[bool] = Future()
        done.set_result(self._dispatcher().cancel())
        return done

    def _ask(self, kind: Any, service: str, request: Any, trip: TripRequest,
             client: str) -> Future[Answer]:
        now = self._node.get_clock().now().nanoseconds
        call = RecordedCall(self._node.resolve_service_name(service), type_name(kind), now, now,
                            fields_of(request))
        return self._dispatcher().path_for(call, trip, client, draws=kind is Trigger)

    def _new_route_response(self, answer: Answer) -> Trigger.Response:
        path = self._node.resolve_topic_name('path')
        left, remarks = answer.departure, f'; {answer.remarks}' if answer.remarks else ''
        assert left is not None  # new_route always draws
        return _success(f'departure {left.number} ({left.id}) is published on {path}{remarks}')


def _replan_response(plan: Plan) -> Trigger.Response:
    return _success(f'solved in {plan.seconds:.3f} s: value {plan.value:.6g}, gap '
                    f'{plan.trip.gap:.3g}, {len(plan.network.points)} nodes')


def _cancel_response(ended: bool) -> Trigger.Response:
    return (_success('cancelled: solves, and departures that wait for the disk') if ended else
            _failure('no solve is running'))


def _success(message: str) -> Trigger.Response:
    return Trigger.Response(success=True, message=message)


def _failure(reason: object) -> Trigger.Response:
    return Trigger.Response(success=False, message=str(reason))
