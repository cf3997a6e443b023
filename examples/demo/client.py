# SPDX-License-Identifier: Apache-2.0
"""A ROS client of the planner node: publishes the inputs and requests departures."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ambush_planner.errors import AmbushPlannerError
from ambush_planner.ros.conversions import occupancy_to_ros, pose_to_ros
from ambush_planner.ros.topics import LATCHED

# Time limits [s]; discovery alone can take more than 3 s.
DISCOVERY_TIMEOUT, PLANNING_TIMEOUT, MESSAGE_TIMEOUT = 30.0, 90.0, 15.0
STEP = 0.05  # [s] between two checks while waiting


class NoAnswer(AmbushPlannerError):
    """The node did not answer in time, or refused."""


class DemoClient:
    """A ROS node with its own context; ``check`` is called while waiting, and may raise."""

    def __init__(self, domain: int, check: Callable[[], None]) -> None:
        self._domain, self._check = domain, check
        self._paths: list[PathMessage] = []
        self._status: dict[str, str] = {}

    def __enter__(self) -> DemoClient:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=self._domain)
        self._node = rclpy.create_node('ambush_demo', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        create = self._node.create_publisher
        self._map = create(OccupancyGrid, 'alpha_map', LATCHED)
        self._start = create(PoseStamped, 'start_pose', LATCHED)
        self._goal = create(PoseStamped, 'goal_pose', LATCHED)
        self._node.create_subscription(PathMessage, 'path', self._paths.append, LATCHED)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._new_route = self._node.create_client(Trigger, '/ambush_planner/new_route')
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def publish_inputs(self, values: np.ndarray, resolution: float, start: tuple[float, float],
                       goal: tuple[float, float]) -> None:
        """Publish map values, start and goal, and wait until the node plans; raises NoAnswer."""
        # The node's subscriptions of start and goal are volatile: earlier messages would be lost.
        inputs = self._map, self._start, self._goal
        self._wait(lambda: self._new_route.service_is_ready()
                   and all(each.get_subscription_count() for each in inputs),
                   DISCOVERY_TIMEOUT, 'the node was not found')
        header = Header(frame_id='map', stamp=self._node.get_clock().now().to_msg())
        self._map.publish(occupancy_to_ros(values, resolution, (0.0, 0.0, 0.0), header))
        self._start.publish(PoseStamped(header=header, pose=pose_to_ros(*start)))
        self._goal.publish(PoseStamped(header=header, pose=pose_to_ros(*goal)))
        self._wait(lambda: self._status.get('state') in ('solving', 'ready'),
                   MESSAGE_TIMEOUT, 'the node did not accept map, start and goal')

    def depart(self) -> PathMessage:
        """Request a route and return it; raises NoAnswer with the node's reason if it refuses."""
        known = len(self._paths)
        future = self._new_route.call_async(Trigger.Request())
        self._wait(future.done, PLANNING_TIMEOUT, 'the node did not answer new_route')
        response = future.result()
        if not response.success:
            raise NoAnswer(f'the node found no route: {response.message}')
        self._wait(lambda: len(self._paths) > known, MESSAGE_TIMEOUT, 'no path was published')
        return self._paths[-1]

    def wait_until_refined(self) -> None:
        """Wait until the node has refined the plan of the first departure; raises NoAnswer."""
        self._wait(lambda: self._status.get('departures') == '1'
                   and self._status['refining'] == 'no',
                   PLANNING_TIMEOUT, 'the node did not refine its plan')

    def _wait(self, done: Callable[[], bool], timeout: float, failure: str) -> None:
        deadline = time.monotonic() + timeout
        while not done():
            self._check()
            if time.monotonic() > deadline:
                reason = self._status.get('message', '')
                raise NoAnswer(f'{failure} within {timeout:g} s' + (reason and f': {reason}'))
            self._executor.spin_once(timeout_sec=STEP)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.hardware_id.endswith('ambush_planner'):
                self._status = {value.key: value.value for value in status.values}
