"""The services of the node: each starts work and answers when its future is done."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..errors import InvalidOption
from ..planning.node_parameters import RobotOptions
from ..planning.plan import Plan
from ..recordings import type_name
from .current_map import ReceivedMessage
from .departure_record import Departure, ServiceCall
from .dispatcher import Dispatcher
from .error_boundary import ErrorBoundary
from .inputs import Inputs, TripRequest
from .qos import LATEST, REQUESTS
from .serial_executor import completed

_Result = TypeVar('_Result')


class Requests:
    """The services of ``node``, which answer in all of its lifecycle states.

    Parameters
    ----------
    error_boundary
        Logs and reports errors.
    dispatcher, inputs
        Return the parts of a configured node, or raise NotActive.
    robot
        Returns the options of the robot's frame.
    """

    def __init__(
        self,
        node: Node,
        error_boundary: ErrorBoundary,
        dispatcher: Callable[[], Dispatcher],
        inputs: Callable[[], Inputs],
        robot: Callable[[], RobotOptions],
    ) -> None:
        self._node, self._error_boundary, self.robot = node, error_boundary, robot
        self._dispatcher, self._inputs = dispatcher, inputs
        self._path, self._start, self._goal = (
            node.resolve_topic_name(name) for name in ('path', 'start_pose', 'goal_pose')
        )
        planning = MutuallyExclusiveCallbackGroup()
        self._serve(
            Trigger, '~/new_route', self._start_new_route, self._new_route_response, planning,
            self.answered,
        )
        self._serve(
            GetPlan, '~/get_plan', lambda request: self.start_plan(lambda: request),
            plan_response, planning, self.answered,
        )
        self._serve(
            Trigger, '~/replan',
            lambda _: _started(lambda: self._dispatcher().replan(self._latest_trip())),
            _replan_response, planning,
        )
        self._serve(
            Trigger, '~/cancel', lambda _: completed(lambda: self._dispatcher().cancel()),
            _cancel_response, MutuallyExclusiveCallbackGroup(),
        )

    def start_plan(self, make_request: Callable[[], GetPlan.Request]) -> Future[Departure]:
        """Start a departure between the poses of the request that ``make_request`` returns."""

        def work() -> Future[Departure]:
            request = make_request()
            name = self._node.resolve_service_name('~/get_plan')
            return self._dispatcher().depart(
                ServiceCall(GetPlan, name, request), self._trip_between(request)
            )

        return _started(work)

    def answered(self, departure: Departure, response: Any) -> None:
        """Log and record a departure that has been answered."""
        self._dispatcher().answered(departure, response)

    def _serve(
        self,
        kind: Any,
        name: str,
        start: Callable[[Any], Future[_Result]],
        to_response: Callable[[_Result], Any],
        group: CallbackGroup,
        answered: Callable[[_Result, Any], None] = lambda result, response: None,
    ) -> None:
        """Serve work that ``start`` starts; the thread that finishes it sends the answer.

        In rclpy a callback has to return the response: one that waits for it blocks a thread of
        the executor, and one that awaits it is polled, which takes a whole core.
        """
        what = name.removeprefix('~/')
        service: Any = self._node.create_service(
            kind, name, lambda request, _: start(request), qos_profile=REQUESTS,
            callback_group=group,
        )
        send = service.send_response

        def respond(header: Any, future: Future[_Result]) -> None:
            response, error = self._error_boundary.attempt(
                what, 'request', lambda: to_response(future.result())
            )
            if response is None:
                response = _failure(error) if kind is Trigger else kind.Response()
            # rclpy raises RuntimeError if the service or the client no longer exists.
            with suppress(RuntimeError):
                send(response, header)
            if future.exception() is None:
                answered(future.result(), response)

        def send_when_done(future: Future[_Result], header: Any) -> None:
            future.add_done_callback(partial(respond, header))

        # rclpy passes on what the callback returns: the future of the response.
        service.send_response = send_when_done

    def _start_new_route(self, request: Trigger.Request) -> Future[Departure]:
        call = ServiceCall(Trigger, self._node.resolve_service_name('~/new_route'), request)
        return _started(lambda: self._dispatcher().depart(call, self._latest_trip()))

    def _latest_trip(self) -> TripRequest:
        return self._inputs().latest(self.robot())

    def _trip_between(self, request: GetPlan.Request) -> TripRequest:
        if not 0.0 <= request.tolerance < math.inf:
            raise InvalidOption(f'tolerance must be finite and >= 0 [m], got {request.tolerance}')
        self._inputs().current_map()
        return TripRequest(
            _as_received(self._start, request.start),
            _as_received(self._goal, request.goal),
            request.tolerance,
        )

    def _new_route_response(self, departure: Departure) -> Trigger.Response:
        trouble = f'; {departure.trouble}' if departure.trouble else ''
        return _success(
            f'departure {departure.number} ({departure.id}) is published on {self._path}{trouble}'
        )


def plan_response(departure: Departure) -> GetPlan.Response:
    """Return the answer of ``~/get_plan``."""
    return GetPlan.Response(plan=departure.path.to_message())


def _started(work: Callable[[], Future[_Result]]) -> Future[_Result]:
    """Start work; an error becomes the exception of the future."""
    try:
        return work()
    except Exception as error:
        failed: Future[_Result] = Future()
        failed.set_exception(error)
        return failed


def _as_received(topic: str, pose: PoseStamped) -> ReceivedMessage:
    """Return a pose of a request as if it had arrived on the topic."""
    return ReceivedMessage(topic, type_name(pose), pose, LATEST)


def _replan_response(plan: Plan) -> Trigger.Response:
    return _success(
        f'solved in {plan.seconds:.3f} s: value {plan.strategy.value:.6g}, gap '
        f'{plan.strategy.gap:.3g}, {len(plan.network.points)} nodes'
    )


def _cancel_response(count: int) -> Trigger.Response:
    if not count:
        return _failure('no solve is running')
    return _success('the solve was cancelled' if count == 1 else f'{count} solves were cancelled')


def _success(message: str) -> Trigger.Response:
    return Trigger.Response(success=True, message=message)


def _failure(reason: object) -> Trigger.Response:
    return Trigger.Response(success=False, message=str(reason))
