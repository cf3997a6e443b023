"""The node: wires topics, services, parameters and timer to a session."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
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
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from ..core.errors import AmbushPlannerError, InvalidOption
from .inputs import Received
from .outbox import LATCHED, LATEST, Outbox
from .parameters import declare_parameters
from .session import Session

NODE_NAME = 'ambush_planner'
_REPORT_PERIOD = 1.0  # s
_LOOK_UP = 0.25  # s; how soon the end is noticed when nothing else happens
# One for the planning services; the others keep subscriptions, parameters and timer running.
_THREADS = 4

_Result = TypeVar('_Result')


class InternalError(AmbushPlannerError):
    """Something failed that the planner does not know; the log says where."""


class PlannerNode(Node):
    """The ambush planner; keyword arguments go to ``rclpy.node.Node``.

    Raises
    ------
    InvalidOption, rclpy.exceptions.ParameterException
        The parameters that it was started with are not usable.
    """

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__(NODE_NAME, **node_arguments)
        parameters = declare_parameters(self, lambda new: self._session.reconfigure(new))
        if parameters.seed >= 0:
            self.get_logger().warning(
                'the parameter seed is fixed: the sequence of routes is always the same and can '
                'be foreseen; only for tests and replay'
            )
        self._session = Session(
            self.get_fully_qualified_name().lstrip('/'),
            parameters,
            Outbox(self),
            self.get_clock(),
            self.get_logger(),
        )
        self._listen()
        self._serve()
        # Steady: a simulation's clock that stands still must not silence the diagnostics.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_REPORT_PERIOD, self._on_timer, clock=steady)

    @property
    def solving(self) -> bool:
        """Whether a solve is running."""
        return self._session.solving

    def _listen(self) -> None:
        self._subscribe(OccupancyGrid, 'alpha_map', LATCHED, self._on_map)
        self._start_topic = self._subscribe(PoseStamped, 'start_pose', LATEST, self._on_start)
        self._goal_topic = self._subscribe(PoseStamped, 'goal_pose', LATEST, self._on_goal)
        self._subscribe(PoseWithCovarianceStamped, 'initialpose', LATEST, self._on_initial_pose)

    def _subscribe(
        self, kind: type, topic: str, qos: QoSProfile, callback: Callable[[Received], None]
    ) -> str:
        """Subscribe, and return the topic's full name."""
        name = self.resolve_topic_name(topic)
        self.create_subscription(
            kind, topic, lambda message: callback(Received(name, message, qos)), qos
        )
        return name

    def _serve(self) -> None:
        # A group of their own: a solve keeps other solves waiting, and nothing else.
        planning = MutuallyExclusiveCallbackGroup()
        for kind, name, callback in (
            (Trigger, '~/new_route', self._on_new_route),
            (Trigger, '~/replan', self._on_replan),
            (GetPlan, '~/get_plan', self._on_get_plan),
        ):
            self.create_service(kind, name, callback, callback_group=planning)

    def _on_map(self, received: Received) -> None:
        self._attempt(received.topic, 'map', lambda: self._session.accept_map(received))

    def _on_start(self, received: Received) -> None:
        self._attempt(
            received.topic, 'request', lambda: self._session.set_start(received, received.message)
        )

    def _on_initial_pose(self, received: Received) -> None:
        estimate = received.message
        pose = PoseStamped(header=estimate.header, pose=estimate.pose.pose)
        self._attempt(
            received.topic, 'request', lambda: self._session.set_start(received, pose)
        )

    def _on_goal(self, received: Received) -> None:
        self._attempt(
            received.topic, 'request', lambda: self._session.set_goal(received, received.message)
        )

    def _on_new_route(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._trigger('new_route', self._session.new_route, response)

    def _on_replan(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._trigger('replan', self._session.replan, response)

    def _on_get_plan(
        self, request: GetPlan.Request, response: GetPlan.Response
    ) -> GetPlan.Response:
        start = Received(self._start_topic, request.start, LATEST)
        goal = Received(self._goal_topic, request.goal, LATEST)
        path, _ = self._attempt(
            'get_plan', 'request', lambda: self._session.get_plan(start, goal, request.tolerance)
        )
        if path is not None:
            response.plan = path
        return response

    def _on_timer(self) -> None:
        self._attempt('diagnostics', 'request', self._session.report)

    def _trigger(
        self, name: str, action: Callable[[], str], response: Trigger.Response
    ) -> Trigger.Response:
        message, error = self._attempt(name, 'request', action)
        response.success = error is None
        response.message = str(error) if message is None else message
        return response

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
            known = self._internal_error(error)
        if self.context.ok():
            self.get_logger().error(f'{what}: {known}')
            self._session.fail(concern, known)
        return None, known

    def _internal_error(self, error: Exception) -> InternalError:
        # Where, but not the error's own words: they may hold what belongs into no log.
        frames = ''.join(traceback.format_tb(error.__traceback__))
        self.get_logger().error(f'{type(error).__name__} at\n{frames}')
        return InternalError(f'internal error ({type(error).__name__}); the log says where')


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    # Our own handlers, which only raise a flag: rclpy's end the context at once, wherever the
    # threads are, which crashes a node that is just starting. They stay to the end, so that a
    # second Ctrl-C does not cut the clean-up short.
    stop = Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    executor, node = None, None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = PlannerNode()
        executor = MultiThreadedExecutor(num_threads=_THREADS)
        executor.add_node(node)
        while rclpy.ok() and not stop.is_set():
            executor.spin_once(timeout_sec=_LOOK_UP)
    except ExternalShutdownException:
        pass
    except (InvalidOption, ParameterException) as error:
        print(f'{NODE_NAME}: cannot start: {error}', file=sys.stderr)
        return 1
    finally:
        if executor is not None:
            executor.shutdown(timeout_sec=2.0)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if node is not None and node.solving:
        # Python would wait for the thread of the solve. Nothing is lost: recordings are written
        # after a solve, and only finished files have their names.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    return 0


if __name__ == '__main__':
    sys.exit(main())
