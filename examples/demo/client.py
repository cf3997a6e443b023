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


class NodeClient:
    """A ROS node with its own context; ``check`` is called while waiting, and may raise.

    ``status`` holds the values of the planner's latest diagnostics.
    """

    def __init__(self, domain: int, check: Callable[[], None]) -> None:
        self._domain, self.check = domain, check
        self.status: dict[str, str] = {}

    def __enter__(self) -> NodeClient:
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=self._domain)
        self.node = rclpy.create_node('client', context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def listen(self) -> None:
        """Receive the diagnostics."""
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def wait(self, done: Callable[[], object], failure: str, timeout: float) -> None:
        """Process messages until ``done``; raises NoAnswer after the timeout [s]."""
        deadline = time.monotonic() + timeout
        while not done():
            self.check()
            if time.monotonic() > deadline:
                reason = self.status.get('message', '')
                raise NoAnswer(f'{failure} within {timeout:g} s' + (reason and f': {reason}'))
            self.executor.spin_once(timeout_sec=STEP)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.hardware_id.endswith('ambush_planner'):
                self.status = {value.key: value.value for value in status.values}


class DemoClient(NodeClient):
    """A client that publishes map, start and goal, and asks for departures."""

    def __enter__(self) -> DemoClient:
        super().__enter__()
        self._paths: list[PathMessage] = []
        create = self.node.create_publisher
        self._map = create(OccupancyGrid, 'alpha_map', LATCHED)
        self._start = create(PoseStamped, 'start_pose', LATCHED)
        self._goal = create(PoseStamped, 'goal_pose', LATCHED)
        self.node.create_subscription(PathMessage, 'path', self._paths.append, LATCHED)
        self._new_route = self.node.create_client(Trigger, '/ambush_planner/new_route')
        self.listen()
        return self

    def publish_inputs(self, values: np.ndarray, resolution: float, start: tuple[float, float],
                       goal: tuple[float, float]) -> None:
        """Publish map values, start and goal, and wait until the node plans; raises NoAnswer."""
        # The node's subscriptions of start and goal are volatile: earlier messages would be lost.
        inputs = self._map, self._start, self._goal
        self.wait(lambda: self._new_route.service_is_ready()
                  and all(each.get_subscription_count() for each in inputs),
                  'the node was not found', DISCOVERY_TIMEOUT)
        header = Header(frame_id='map', stamp=self.node.get_clock().now().to_msg())
        self._map.publish(occupancy_to_ros(values, resolution, (0.0, 0.0, 0.0), header))
        self._start.publish(PoseStamped(header=header, pose=pose_to_ros(*start)))
        self._goal.publish(PoseStamped(header=header, pose=pose_to_ros(*goal)))
        self.wait(lambda: self.status.get('state') in ('solving', 'ready'),
                  'the node did not accept map, start and goal', MESSAGE_TIMEOUT)

    def depart(self) -> PathMessage:
        """Request a route and return it; raises NoAnswer with the node's reason if it refuses."""
        known = len(self._paths)
        future = self._new_route.call_async(Trigger.Request())
        self.wait(future.done, 'the node did not answer new_route', PLANNING_TIMEOUT)
        response = future.result()
        if not response.success:
            raise NoAnswer(f'the node found no route: {response.message}')
        self.wait(lambda: len(self._paths) > known, 'no path was published', MESSAGE_TIMEOUT)
        return self._paths[-1]

    def wait_until_refined(self) -> None:
        """Wait until the node has refined the plan of the first departure; raises NoAnswer."""
        self.wait(lambda: self.status.get('departures') == '1'
                  and self.status['refining'] == 'no',
                  'the node did not refine its plan', PLANNING_TIMEOUT)
