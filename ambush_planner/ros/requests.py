"""What others ask of the node: its services, and what each is answered with."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from ..errors import InvalidOption
from ..planning.node_parameters import RobotOptions
from ..planning.plan import Plan
from ..recordings import type_name
from .current_map import Received
from .departure_record import Departure, ServiceCall
from .dispatcher import Dispatcher
from .error_boundary import ErrorBoundary
from .inputs import Inputs, TripRequest
from .qos import LATEST
from .serial_executor import done
from .services import DeferredService

_Result = TypeVar('_Result')


class Requests:
    """The services of ``node``, which answer in all of its states.

    Parameters
    ----------
    guard
        Takes note of what goes wrong.
    dispatcher, inputs
        Return what is there while the node is configured, or raise NotActive.
    robot
        Returns where the robot is found.
    """

    def __init__(
        self,
        node: Node,
        error_boundary: ErrorBoundary,
        dispatcher: Callable[[], Dispatcher],
        inputs: Callable[[], Inputs],
        robot: Callable[[], RobotOptions],
    ) -> None:
        self._node, self._guard, self.robot = node, error_boundary, robot
        self._dispatcher, self._inputs = dispatcher, inputs
        self._path, self._start, self._goal = (
            node.resolve_topic_name(name) for name in ('path', 'start_pose', 'goal_pose')
        )
        self._route_service, self._plan_service = (
            node.resolve_service_name(name) for name in ('~/new_route', '~/get_plan')
        )
        planning = MutuallyExclusiveCallbackGroup()
        self._serve(
            Trigger, '~/new_route', lambda request: self._begin(lambda: self._depart(request)),
            self._routed, planning, self.answered,
        )
        self._serve(
            GetPlan, '~/get_plan', lambda request: self.begin_plan(lambda: request), planned,
            planning, self.answered,
        )
        self._serve(
            Trigger, '~/replan',
            lambda _: self._begin(lambda: self._dispatcher().replan(self._latest())),
            _replanned, planning,
        )
        self._serve(
            Trigger, '~/cancel', lambda _: done(lambda: self._dispatcher().cancel()),
            _cancelled, MutuallyExclusiveCallbackGroup(),
        )

    def begin_plan(self, make_request: Callable[[], GetPlan.Request]) -> Future[Departure]:
        """Depart between the poses of a request, whose goal may be moved where it is blocked."""

        def work() -> Future[Departure]:
            request = make_request()
            call = ServiceCall(GetPlan, self._plan_service, request)
            return self._dispatcher().depart(call, self._between(request))

        return self._begin(work)

    def answered(self, departure: Departure, response: Any) -> None:
        """Have a departure that is answered logged and recorded."""
        self._dispatcher().answered(departure, response)

    def _serve(
        self,
        kind: Any,
        name: str,
        begin: Callable[[Any], Future[_Result]],
        success: Callable[[_Result], Any],
        group: CallbackGroup,
        answered: Callable[[_Result, Any], None] = lambda result, response: None,
    ) -> None:
        """Serve what ``begin`` begins; ``success`` makes the response."""
        what = name.removeprefix('~/')

        def answer(outcome: Future[_Result]) -> Any:
            response, error = self._guard.attempt(
                what, 'request', lambda: success(outcome.result())
            )
            if response is not None:
                return response
            return _failure(error) if kind is Trigger else kind.Response()

        DeferredService(self._node, kind, name, begin, answer, group, answered)

    def _depart(self, request: Trigger.Request) -> Future[Departure]:
        call = ServiceCall(Trigger, self._route_service, request)
        return self._dispatcher().depart(call, self._latest())

    def _begin(self, work: Callable[[], Future[_Result]]) -> Future[_Result]:
        """Start the work for a request; an error is its outcome."""
        try:
            return work()
        except Exception as error:
            failed: Future[_Result] = Future()
            failed.set_exception(error)
            return failed

    def _latest(self) -> TripRequest:
        return self._inputs().latest(self.robot())

    def _between(self, request: GetPlan.Request) -> TripRequest:
        if not 0.0 <= request.tolerance < math.inf:
            raise InvalidOption(f'tolerance must be finite and >= 0 [m], got {request.tolerance}')
        self._inputs().current_map()
        return TripRequest(
            _as_received(self._start, request.start),
            _as_received(self._goal, request.goal),
            request.tolerance,
        )

    def _routed(self, departure: Departure) -> Trigger.Response:
        trouble = f'; {departure.trouble}' if departure.trouble else ''
        return _success(
            f'departure {departure.number} ({departure.id}) is published on {self._path}{trouble}'
        )


def planned(departure: Departure) -> GetPlan.Response:
    """Return the answer to a request for a plan."""
    return GetPlan.Response(plan=departure.path.to_message())


def _as_received(topic: str, pose: PoseStamped) -> Received:
    """A pose of a request, as if it had come on the topic."""
    return Received(topic, type_name(pose), pose, serialize_message(pose), LATEST)


def _replanned(plan: Plan) -> Trigger.Response:
    return _success(
        f'solved in {plan.seconds:.3f} s: value {plan.strategy.value:.6g}, gap '
        f'{plan.strategy.gap:.3g}, {len(plan.network.points)} nodes'
    )


def _cancelled(count: int) -> Trigger.Response:
    if not count:
        return _failure('no solve is running')
    return _success('the solve was cancelled' if count == 1 else f'{count} solves were cancelled')


def _success(message: str) -> Trigger.Response:
    return Trigger.Response(success=True, message=message)


def _failure(reason: object) -> Trigger.Response:
    return Trigger.Response(success=False, message=str(reason))
