# SPDX-License-Identifier: Apache-2.0
"""Nav2's actions ComputePathToPose and ComputePathThroughPoses: departures for Nav2."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from geometry_msgs.msg import PoseArray
from nav_msgs.srv import GetPlan
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node

from .departure_record import Answer
from .errors import ErrorBoundary, FrameMismatch, Refusal, code_of
from .inputs import robot_pose
from .parameter_changes import NodeSettings
from .requests import Requests
from .serial_executor import future_of
from .topics import REQUESTS

# The actions and their types.
ACTIONS = {'~/compute_path_to_pose': 'ComputePathToPose',
           '~/compute_path_through_poses': 'ComputePathThroughPoses'}
# Time for which results are kept [s], as by Nav2's planner server.
_RESULT_TIMEOUT = 10
# Nav2's names of codes that it lacks. Its trees try recoveries after UNKNOWN and TIMEOUT.
_NAV2_CODES = {'NO_START': 'TF_ERROR', 'NO_GOAL': 'NO_VIAPOINTS_GIVEN', 'OUT_OF_DATE': 'TIMEOUT',
               'STOP_OCCUPIED': 'GOAL_OCCUPIED', 'STOP_OUTSIDE_MAP': 'GOAL_OUTSIDE_MAP'}


class ComputePath:
    """The action called ``name``, of the type ``action``.

    A goal is treated like a request of ``get_plan`` without tolerance, through all poses but the
    last. As in Nav2, a new goal replaces a robot's waiting one that leads elsewhere; goals from
    fixed places, of any sender, replace none. Waiting goals are accepted but not executing,
    because rclpy polls coroutines that await. Cancelling a goal leaves the solves of other requests
    alone. Destroy ``server`` before the node.
    """

    def __init__(self, node: Node, error_boundary: ErrorBoundary, requests: Requests,
                 settings: NodeSettings, name: str, action: Any) -> None:
        self._node: Any = node
        self._error_boundary, self._requests = error_boundary, requests
        self._settings, self._name, self._action = settings, name, action
        # Resolved here: rcl does not remap the names of actions.
        self.server = ActionServer(
            node, action, node.resolve_topic_name(name), self._result,
            callback_group=MutuallyExclusiveCallbackGroup(),
            handle_accepted_callback=self._accepted, cancel_callback=self._cancel,
            goal_service_qos_profile=REQUESTS, result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS, result_timeout=_RESULT_TIMEOUT,
        )

    def _accepted(self, handle: Any) -> None:
        handle.departure = future_of(
            lambda: self._requests.start_plan(*self._plan_request(handle.request)))
        # By the executor: it may be handling a request to cancel the goal.
        handle.departure.add_done_callback(
            lambda _: self._node.executor.create_task(handle.execute))

    def _cancel(self, handle: Any) -> CancelResponse:
        """Cancel a goal, unless its route has been drawn."""
        waits = handle.departure is not None and handle.departure.cancel()
        return CancelResponse.ACCEPT if waits else CancelResponse.REJECT

    def _result(self, handle: Any) -> Any:
        """Answer a goal whose departure has left, failed or been cancelled."""
        departure: Future[Answer] = handle.departure
        handle.departure = None  # which refers to the handle
        result = self._action.Result()
        if departure.cancelled():
            handle.canceled()
            return result
        done, error = self._error_boundary.attempt(self._name.removeprefix('~/'), 'request',
                                                   departure.result)
        if hasattr(result, 'error_msg'):  # Nav2's first release for Jazzy lacks it
            result.error_msg = done.remarks if done else str(error)
        if done:
            result.path = done.path.message
            result.planning_time = Duration(nanoseconds=done.took_ns).to_msg()
            handle.succeed()
        else:
            code, codes = code_of(error or RuntimeError()), self._action.Result
            result.error_code = getattr(codes, _NAV2_CODES.get(code, code), codes.UNKNOWN)
            handle.abort()
        return result

    def _plan_request(self, goal: Any) -> tuple[GetPlan.Request, PoseArray, str]:
        """Return the goal as a request of get_plan, its stops, and who asks.

        Raises Refusal if the goal is for another planner or has no poses, the start is missing or
        has no frame, or the stops have several.
        """
        names = {self._node.get_name(), *self._settings.current.values['planner_ids']}
        if goal.planner_id not in names:
            raise Refusal('INVALID_PLANNER', f'planner_id is {goal.planner_id[:80]!r}, but must be '
                          f'one of {sorted(names)} (planner_ids)')
        robot = self._settings.current.values['robot_base_frame']
        start = goal.start if goal.use_start else robot_pose(robot)
        if start is None:
            raise Refusal('NO_START', 'use_start is false, so the route begins at the robot: set '
                          'robot_base_frame, or give a start')
        if not start.header.frame_id:
            raise FrameMismatch('use_start is true, but the header.frame_id of the start is empty')
        *stops, last = [goal.goal] if hasattr(goal, 'goal') else goal.goals or [None]
        if last is None:
            raise Refusal('NO_GOAL', 'goals is empty: give at least one pose')
        frames = sorted({stop.header.frame_id for stop in stops})
        if len(frames) > 1:
            raise FrameMismatch(f'the stops are in different frames, {", ".join(frames)[:200]}; '
                                'give all of them in one frame')
        via = PoseArray(poses=[stop.pose for stop in stops])
        if stops:
            via.header = stops[0].header
        return GetPlan.Request(start=start, goal=last), via, self._name
