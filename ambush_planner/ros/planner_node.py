"""The node: wires topics, services, parameters and timer to the dispatcher."""

from __future__ import annotations

import ctypes
import gc
import signal
import sys
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from functools import partial
from threading import Event
from typing import Any, TypeVar

import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from ..core.errors import InvalidOption
from ..core.planner import Plan
from ..recording import type_name
from .departure_record import Departure, ServiceCall, planner_version
from .dispatcher import Dispatcher
from .futures import done
from .guard import Guard
from .inputs import Asked, Inputs, Received, RobotOptions
from .outbox import Outbox
from .parameters import NodeParameters, declare_parameters
from .qos import LATEST
from .reporter import Reporter
from .services import DeferredService
from .subscriptions import Subscriptions
from .transforms import FrameTransforms

NODE_NAME = 'ambush_planner'
_REPORT_PERIOD = 1.0  # s
_LOOK_UP = 0.25  # s; how soon the end is noticed when nothing else happens
# For requests, `cancel`, and all else; none of them waits for anything.
THREADS = 3

_M_MMAP_THRESHOLD, _LARGE = -3, 2**20  # malloc.h

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
        self._closing = ExitStack()
        self._closing.callback(super().destroy_node)
        with ExitStack() as unless_built:
            unless_built.enter_context(self._closing)
            self._build()
            unless_built.pop_all()

    def _build(self) -> None:
        self._guard_own_services()
        self._settings = declare_parameters(self, self._reconfigure, self._contradicted)
        if self._settings.seed >= 0:
            self.get_logger().warning(
                'the parameter seed is fixed: the sequence of routes is always the same and can '
                'be foreseen; only for tests and replay'
            )
        outbox = Outbox(self)
        self._path_topic = outbox.topic_name('path')
        self._reporter = Reporter(
            self.get_fully_qualified_name().lstrip('/'),
            outbox,
            self.get_clock(),
            lambda: self._dispatcher.solving,
            self._settings.error_hold,
        )
        self._guard = Guard(self.context, self.get_logger(), self._reporter.failed)
        self._transforms = FrameTransforms(self)
        self._closing.callback(self._transforms.close)
        self._inputs = Inputs(self._transforms)
        self._dispatcher = Dispatcher(
            self._settings,
            self._inputs,
            outbox,
            self._reporter,
            self.get_clock(),
            self.get_logger(),
            self.resolve_topic_name('start_pose'),
        )
        self._closing.callback(self._dispatcher.close)
        self._reporter.recording(self._settings.recording.enabled)
        self._tell_missing()
        self._listening = Subscriptions(
            self, self._inputs, self._guard, self._tell_missing, self._map_accepted
        )
        self._serve()
        # Steady: a simulation's clock that stands still must not silence the diagnostics.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_REPORT_PERIOD, self._on_timer, clock=steady)

    def stop_solving(self) -> None:
        """End all solves, now and to come; requests that wait for one are answered."""
        self._dispatcher.stop_solving()

    def destroy_node(self) -> None:
        """Answer all who wait, write the last recordings, and end all that belongs to the node."""
        self._closing.close()

    def _reconfigure(self, parameters: NodeParameters) -> None:
        before, self._settings = self._settings, parameters
        self._reporter.error_hold = parameters.error_hold
        self._reporter.warn('parameters', '')
        self._dispatcher.reconfigure(parameters)
        if parameters.recording != before.recording:
            self._reporter.recording(parameters.recording.enabled)
        self._tell_missing()

    def _contradicted(self, error: InvalidOption) -> None:
        self._dispatcher.refuse(error)
        self._reporter.warn(
            'parameters', f'parameters contradict each other, and requests are refused: {error}'
        )

    def _tell_missing(self) -> None:
        self._reporter.inputs(self._inputs.missing(self._robot()))

    def _map_accepted(self) -> None:
        self._reporter.map_accepted()
        self._tell_missing()
        self._dispatcher.ground_changed()

    def _robot(self) -> RobotOptions:
        return RobotOptions(self._settings.robot_base_frame)

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

    def _serve(self) -> None:
        planning = MutuallyExclusiveCallbackGroup()
        self._serve_departures(Trigger, '~/new_route', planning, self._latest, self._new_route)
        self._serve_departures(
            GetPlan, '~/get_plan', planning, self._between,
            lambda departure: GetPlan.Response(plan=departure.path.to_message()),
        )
        DeferredService(
            self, Trigger, '~/replan',
            lambda _: self._begin(lambda: self._dispatcher.replan(self._latest(None))),
            lambda outcome: self._response('replan', Trigger, outcome, _replanned), planning,
        )
        DeferredService(
            self, Trigger, '~/cancel',
            lambda _: done(self._dispatcher.cancel),
            lambda outcome: self._response('cancel', Trigger, outcome, _cancelled),
            MutuallyExclusiveCallbackGroup(),
        )

    def _serve_departures(
        self,
        kind: type,
        name: str,
        group: CallbackGroup,
        asked: Callable[[Any], Asked],
        success: Callable[[Departure], Any],
    ) -> None:
        """Serve departures; ``asked`` reads a request, ``success`` makes the response."""
        whole_name, what = self.resolve_service_name(name), name.removeprefix('~/')

        def begin(request: Any) -> Future[Departure]:
            call = ServiceCall(kind, whole_name, request)
            return self._begin(lambda: self._dispatcher.depart(call, asked(request)))

        DeferredService(
            self, kind, name, begin,
            lambda outcome: self._response(what, kind, outcome, success), group,
            self._dispatcher.record,
        )

    def _latest(self, _: object) -> Asked:
        return self._inputs.latest(self._robot())

    def _between(self, request: GetPlan.Request) -> Asked:
        """The poses of a request, whose goal may be moved where it is blocked."""
        if not request.tolerance >= 0.0:
            raise InvalidOption(f'tolerance must be >= 0 [m], got {request.tolerance}')
        self._inputs.map_in_force()
        return Asked(
            _as_received(self._listening.start_topic, request.start),
            _as_received(self._listening.goal_topic, request.goal),
            request.tolerance,
        )

    def _new_route(self, departure: Departure) -> Trigger.Response:
        trouble = f'; {departure.trouble}' if departure.trouble else ''
        return _success(
            f'departure {departure.number} ({departure.id}) is published on {self._path_topic}'
            f'{trouble}'
        )

    def _begin(self, work: Callable[[], Future[_Result]]) -> Future[_Result]:
        """Start the work for a request; an error is its outcome."""
        try:
            return work()
        except Exception as error:
            failed: Future[_Result] = Future()
            failed.set_exception(error)
            return failed

    def _response(
        self,
        what: str,
        kind: Any,
        outcome: Future[_Result],
        success: Callable[[_Result], Any],
    ) -> Any:
        """Make the response; where something has failed, the reason is told and logged."""
        response, error = self._guard.attempt(what, 'request', lambda: success(outcome.result()))
        if response is not None:
            return response
        return _failure(error) if kind is Trigger else kind.Response()

    def _on_timer(self) -> None:
        self._reporter.warn('alpha_map', self._listening.unheard_maps())
        self._guard.attempt('diagnostics', 'request', self._reporter.report)


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


def _init(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # say, a parameter file that is not there
        raise InvalidOption(str(error)) from error


def _give_back_large_blocks() -> None:
    """Have glibc return the memory of a map when it is freed, in this process of our own.

    By itself it keeps blocks of up to 32 MB once it has freed one, in a heap for each thread.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    # Our own handlers, which only raise a flag: rclpy's end the context at once, wherever the
    # threads are, which crashes a node that is just starting. They stay to the end, so that a
    # second Ctrl-C does not cut the clean-up short.
    stop = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    _give_back_large_blocks()
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
        # What is there by now stays: the collector need not look at it, which took 50 ms a time.
        gc.collect()
        gc.freeze()
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
