"""Nav2's action ComputePathToPose: a departure, by the interface of Nav2's planner server."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from importlib import import_module
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from std_msgs.msg import Header

from .conversions import pose_to_ros
from .departure_record import Departure
from .error_boundary import ErrorBoundary
from .error_codes import FrameMismatch, InvalidPlanner, NoStart, code_of
from .qos import REQUESTS
from .requests import Requests, planned

NAME = '~/compute_path_to_pose'
_KEPT = 10  # s, as Nav2's planner server keeps results
# What Nav2 calls it, where it has no name of its own for it.
_NAV2_CODES = {'NO_START': 'TF_ERROR'}


class ComputePath:
    """The action, where ``nav2_msgs`` is installed; ``server`` is None where it is not.

    A goal is a request of ``get_plan`` without tolerance: answered, recorded and, where it fails,
    logged as one. Goals are kept as accepted, not executed, while they wait, since rclpy would poll
    whatever awaits something; one that is cancelled is taken back alone.
    """

    def __init__(self, node: Node, error_boundary: ErrorBoundary, requests: Requests) -> None:
        self._node, self._guard, self._requests = node, error_boundary, requests
        self._waiting: dict[bytes, tuple[Any, Future[Departure]]] = {}
        # One group: no goal ends while a request to cancel it is half-way through.
        group = MutuallyExclusiveCallbackGroup()
        self._wake = node.create_guard_condition(self._finish, callback_group=group)
        self._action: Any = _installed()
        self.server = None if self._action is None else ActionServer(
            node, self._action, NAME, self._result, callback_group=group,
            handle_accepted_callback=self._accepted, cancel_callback=self._cancel,
            goal_service_qos_profile=REQUESTS, result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS, result_timeout=_KEPT,
        )

    def close(self) -> None:
        """End the action, before the node is destroyed."""
        if self.server is not None:
            self.server.destroy()

    def _accepted(self, handle: Any) -> None:
        departure = self._requests.begin_plan(lambda: self._plan_request(handle.request))
        self._waiting[bytes(handle.goal_id.uuid)] = handle, departure
        departure.add_done_callback(self._departed)

    def _departed(self, departure: Future[Departure]) -> None:
        self._wake.trigger()
        if not departure.cancelled() and departure.exception() is None:
            self._requests.answered(departure.result(), planned(departure.result()))

    def _cancel(self, handle: Any) -> CancelResponse:
        """Take a goal back, unless its route is drawn."""
        _, departure = self._waiting.get(bytes(handle.goal_id.uuid), (None, None))
        if departure is None or not departure.cancel():
            return CancelResponse.REJECT
        return CancelResponse.ACCEPT

    def _finish(self) -> None:
        """Answer the goals whose departures have come, failed, or been cancelled."""
        for key, (handle, departure) in list(self._waiting.items()):
            if departure.done():
                del self._waiting[key]
                self._guard.attempt(NAME, 'request', partial(
                    handle.execute, partial(self._result, departure=departure)
                ))

    def _result(self, handle: Any, departure: Future[Departure]) -> Any:
        result = self._action.Result()
        if departure.cancelled():
            handle.canceled()
            return result
        done, error = self._guard.attempt('compute_path_to_pose', 'request', departure.result)
        if done is None:
            code = code_of(error or RuntimeError())
            result.error_code = getattr(
                self._action.Result, _NAV2_CODES.get(code, code), self._action.Result.UNKNOWN
            )
            if hasattr(result, 'error_msg'):  # not yet in Nav2's first release for Jazzy
                result.error_msg = str(error)
            handle.abort()
            return result
        result.path = done.path.to_message()
        result.planning_time = Duration(nanoseconds=done.end_ns - done.begin_ns).to_msg()
        handle.succeed()
        return result

    def _plan_request(self, goal: Any) -> GetPlan.Request:
        """What is asked for, as a request of get_plan.

        Raises
        ------
        InvalidPlanner
            Another planner is meant.
        NoStart, FrameMismatch
            There is no start, or it has no frame.
        """
        name = self._node.get_name()
        if goal.planner_id not in ('', name):
            raise InvalidPlanner(
                f'planner_id is {goal.planner_id[:80]!r}; here there is {name!r} only (or leave it '
                'empty)'
            )
        if not goal.use_start:
            return GetPlan.Request(start=self._robot_here(), goal=goal.goal)
        if not goal.start.header.frame_id:
            raise FrameMismatch('use_start is true, and the header.frame_id of the start is empty')
        return GetPlan.Request(start=goal.start, goal=goal.goal)

    def _robot_here(self) -> PoseStamped:
        frame = self._requests.robot().frame
        if not frame:
            raise NoStart(
                'use_start is false, so the route begins at the robot: set robot_base_frame to its '
                'frame, or give a start'
            )
        return PoseStamped(header=Header(frame_id=frame), pose=pose_to_ros(0.0, 0.0))


def _installed() -> Any:
    """The type of the action; None without ``nav2_msgs``, which comes with Nav2, not from PyPI."""
    try:
        return import_module('nav2_msgs.action').ComputePathToPose
    except ImportError:
        return None
