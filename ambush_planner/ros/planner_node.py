"""The node: wires topics, services, parameters and timer to a session."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from threading import Event
from typing import Any, TypeVar

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from ..core.errors import AmbushPlannerError, InvalidOption
from ..worker.errors import for_the_log, forget_frames, unexpected
from .departures import ServiceCall, planner_version
from .errors import UnreadableMessage
from .heap import share_one_heap
from .inputs import Received
from .later import answers_later
from .outbox import LATCHED, LATEST, REQUESTS, Outbox
from .parameters import declare_parameters
from .session import Session
from .transforms import FrameTransforms

NODE_NAME = 'ambush_planner'
_REPORT_PERIOD = 1.0  # s
_LOOK_UP = 0.25  # s; how soon the end is noticed when nothing else happens
# For requests, `cancel`, and all else; none of them waits for anything.
THREADS = 3

_Result = TypeVar('_Result')


class PlannerNode(Node):
    """The ambush planner; keyword arguments go to ``rclpy.node.Node``.

    Callbacks never wait, so any executor will do; one of ``THREADS`` threads lets a large map pass
    beside the others.

    Raises
    ------
    InvalidOption, rclpy.exceptions.ParameterException
        The parameters that it was started with are not usable.
    """

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__(NODE_NAME, **node_arguments)
        self._guard_own_services()
        parameters = declare_parameters(self, lambda new: self._session.reconfigure(new))
        if parameters.seed >= 0:
            self.get_logger().warning(
                'the parameter seed is fixed: the sequence of routes is always the same and can '
                'be foreseen; only for tests and replay'
            )
        self._transforms = FrameTransforms(self)
        self._session = Session(
            self.get_fully_qualified_name().lstrip('/'),
            parameters,
            Outbox(self),
            self._transforms,
            self.get_clock(),
            self.get_logger(),
        )
        self._listen()
        self._serve()
        # Steady: a simulation's clock that stands still must not silence the diagnostics.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_REPORT_PERIOD, self._on_timer, clock=steady)

    def stop_solving(self) -> None:
        """End all solves, now and to come; requests that wait for one are answered."""
        self._session.stop_solving()

    def destroy_node(self) -> None:
        """Answer who waits, write the last recordings, and end all that belongs to the node."""
        self._session.close()
        self._transforms.close()
        super().destroy_node()

    def _guard_own_services(self) -> None:
        """Keep exceptions in rclpy's own services: one that leaves a callback ends the executor.

        They raise, for instance, at a parameter value of a type that there is not.
        """
        for service in list(self.services):
            service.callback = partial(self._answer_anyway, service.srv_name, service.callback)

    def _answer_anyway(self, name: str, callback: Callable, request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            # Not the error's own words: they hold what was sent.
            self.get_logger().error(f'{name}: refused, {type(error).__name__}')
            return response

    def _listen(self) -> None:
        session = self._session
        self._subscribe(OccupancyGrid, 'alpha_map', LATCHED, session.accept_map)
        self._start_topic = self._subscribe(
            PoseStamped, 'start_pose', LATEST, lambda got: session.set_start(got, got.message)
        )
        self._goal_topic = self._subscribe(
            PoseStamped, 'goal_pose', LATEST, lambda got: session.set_goal(got, got.message)
        )
        self._subscribe(
            PoseWithCovarianceStamped,
            'initialpose',
            LATEST,
            lambda got: session.set_start(
                got, PoseStamped(header=got.message.header, pose=got.message.pose.pose)
            ),
        )

    def _subscribe(
        self, kind: type, topic: str, qos: QoSProfile, use: Callable[[Received], None]
    ) -> str:
        """Subscribe, and return the topic's full name."""
        name = self.resolve_topic_name(topic)
        concern = 'map' if kind is OccupancyGrid else 'request'

        def receive(data: bytes) -> None:
            self._attempt(name, concern, lambda: use(_received(kind, name, data, qos)))

        # Raw: what cannot be read would end the executor, and recordings keep the bytes that came.
        self.create_subscription(kind, topic, receive, qos, raw=True)
        return name

    def _serve(self) -> None:
        planning = MutuallyExclusiveCallbackGroup()
        for kind, name, callback, group in (
            (Trigger, '~/new_route', self._on_new_route, planning),
            (Trigger, '~/replan', self._on_replan, planning),
            (GetPlan, '~/get_plan', self._on_get_plan, planning),
            (Trigger, '~/cancel', self._on_cancel, MutuallyExclusiveCallbackGroup()),
        ):
            answers_later(self.create_service(
                kind, name, callback, qos_profile=REQUESTS, callback_group=group
            ))

    def _on_new_route(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response | Future:
        call = ServiceCall(Trigger, self.resolve_service_name('~/new_route'), request)
        return self._outcome(
            'new_route', lambda: self._session.new_route(call, _success), _failure
        )

    def _on_get_plan(
        self, request: GetPlan.Request, response: GetPlan.Response
    ) -> GetPlan.Response | Future:
        call = ServiceCall(GetPlan, self.resolve_service_name('~/get_plan'), request)
        start = _as_received(self._start_topic, request.start)
        goal = _as_received(self._goal_topic, request.goal)
        return self._outcome(
            'get_plan', lambda: self._session.get_plan(call, start, goal), lambda _: response
        )

    def _on_replan(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response | Future:
        return self._outcome('replan', lambda: self._session.replan(_success), _failure)

    def _on_cancel(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        cancelled, error = self._attempt('cancel', 'request', self._session.cancel)
        if cancelled:
            return _success('the solve was cancelled')
        return _failure(error or 'no solve is running')

    def _on_timer(self) -> None:
        self._attempt('diagnostics', 'request', self._session.report)

    def _outcome(
        self,
        what: str,
        begin: Callable[[], Future[_Result]],
        failure: Callable[[Exception], _Result],
    ) -> _Result | Future[_Result]:
        """Return the response to a request, or a future of it; that to an error by ``failure``."""
        pending, error = self._attempt(what, 'request', begin)
        if pending is None:
            return failure(error)
        answer: Future[_Result] = Future()

        def settle(done: Future[_Result]) -> None:
            outcome, error = self._attempt(what, 'request', done.result)
            answer.set_result(failure(error) if outcome is None else outcome)

        pending.add_done_callback(settle)
        return answer

    def _attempt(
        self, what: str, concern: str, action: Callable[[], _Result]
    ) -> tuple[_Result | None, Exception | None]:
        """Return (result, None) or (None, error).

        No exception leaves a callback, where it would end the executor: it goes into the log
        once, and into the diagnostics.
        """
        try:
            return action(), None
        except AmbushPlannerError as error:
            known: AmbushPlannerError = error
        except Exception as error:
            known = unexpected(error)
            forget_frames(error)
        forget_frames(known)
        if self.context.ok():
            self.get_logger().error(f'{what}: {for_the_log(known)}')
            self._session.fail(concern, known)
        return None, known


def _received(kind: type, topic: str, data: bytes, qos: QoSProfile) -> Received:
    try:
        message = deserialize_message(data, kind)
    except Exception as error:  # rclpy's own error type is not public
        raise UnreadableMessage(
            f'a message of {len(data)} bytes on {topic} is no {kind.__name__}'
        ) from error
    return Received(topic, message, data, qos)


def _as_received(topic: str, pose: PoseStamped) -> Received:
    """A pose of a request, as if it had come on the topic."""
    return Received(topic, pose, serialize_message(pose), LATEST)


def _success(message: str) -> Trigger.Response:
    return Trigger.Response(success=True, message=message)


def _failure(reason: object) -> Trigger.Response:
    return Trigger.Response(success=False, message=str(reason))


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # say, a parameter file that is not there
        raise InvalidOption(str(error)) from error


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    # Our own handlers, which only raise a flag: rclpy's end the context at once, wherever the
    # threads are, which crashes a node that is just starting. They stay to the end, so that a
    # second Ctrl-C does not cut the clean-up short.
    stop = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    share_one_heap()
    executor, node = None, None
    try:
        _init(args)
        node = PlannerNode()
        node.get_logger().info(
            f'version {planner_version()}; it needs alpha_map, start_pose and goal_pose; '
            '~/new_route is a departure'
        )
        executor = MultiThreadedExecutor(num_threads=THREADS)
        executor.add_node(node)
        while rclpy.ok() and not stop.is_set():
            executor.spin_once(timeout_sec=_LOOK_UP)
    except ExternalShutdownException:
        pass
    except (InvalidOption, ParameterException) as error:
        print(f'{NODE_NAME}: cannot start: {error}', file=sys.stderr)
        return 1
    finally:
        # Those who wait are answered, and the last recordings written, as the node is destroyed.
        if node is not None:
            node.stop_solving()
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
