"""Somebody who asks the planner node for routes: publishes the inputs, calls, receives."""

from __future__ import annotations

import time
from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ..ros.conversions import occupancy_to_ros, pose_to_ros
from ..ros.qos import LATCHED

FRAME = 'map'
# Discovery alone can take more than 3 s.
DISCOVERY_TIMEOUT = 30.0
PLANNING_TIMEOUT = 90.0
MESSAGE_TIMEOUT = 15.0
STEP = 0.05


class NoAnswer(Exception):
    """The node did not answer in time, or said no."""


class DemoClient:
    """A ROS node with a context of its own, to be used in a ``with``.

    ``paths`` are the routes that were received, ``status`` the node's last diagnostics.
    ``check`` is called while waiting, and may raise.
    """

    def __init__(self, domain: int, check: Callable[[], None]) -> None:
        self._domain, self._check = domain, check
        self.paths: list[PathMessage] = []
        self.status: dict[str, str] = {}

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
        self._node.create_subscription(PathMessage, 'path', self.paths.append, LATCHED)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_status, 10)
        self._new_route = self._node.create_client(Trigger, '/ambush_planner/new_route')
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def wait_for_node(self) -> None:
        """Wait until the node listens to all inputs and serves routes; raises NoAnswer."""
        publishers = (self._map, self._start, self._goal)
        self._wait(
            lambda: self._new_route.service_is_ready()
            and all(publisher.get_subscription_count() > 0 for publisher in publishers),
            DISCOVERY_TIMEOUT,
            'the node was not found',
        )

    def publish_inputs(
        self,
        values: object,
        resolution: float,
        start: tuple[float, float],
        goal: tuple[float, float],
    ) -> None:
        """Publish map (cell values, row 0 lowest), start and goal.

        Waits until the node has them; raises NoAnswer.
        """
        header = Header(frame_id=FRAME, stamp=self._node.get_clock().now().to_msg())
        self._map.publish(occupancy_to_ros(values, resolution, (0.0, 0.0, 0.0), header))
        self._start.publish(PoseStamped(header=header, pose=pose_to_ros(*start)))
        self._goal.publish(PoseStamped(header=header, pose=pose_to_ros(*goal)))
        self._wait(
            lambda: self.status.get('state') in ('solving', 'ready'),
            MESSAGE_TIMEOUT,
            'the node did not take map, start and goal',
        )

    def depart(self) -> PathMessage:
        """Ask for a route and return it; raises NoAnswer with the node's reason if it says no."""
        known = len(self.paths)
        future = self._new_route.call_async(Trigger.Request())
        self._wait(future.done, PLANNING_TIMEOUT, 'the node did not answer new_route')
        response = future.result()
        if not response.success:
            raise NoAnswer(f'the node found no route: {response.message}')
        self._wait(
            lambda: len(self.paths) > known, MESSAGE_TIMEOUT, 'no path came after new_route'
        )
        return self.paths[-1]

    def _wait(self, done: Callable[[], bool], timeout: float, failure: str) -> None:
        deadline = time.monotonic() + timeout
        while not done():
            self._check()
            if time.monotonic() > deadline:
                message = self.status.get('message', '')
                raise NoAnswer(
                    f'{failure} within {timeout:g} s' + (f'; it says: {message}' if message else '')
                )
            self._executor.spin_once(timeout_sec=STEP)

    def _on_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith('ambush_planner'):
                self.status = {value.key: value.value for value in status.values}
