"""What the node listens to, read and handed on to its inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from ..recordings import type_name
from .cdr import read_grid_update
from .current_map import CurrentMap, Received
from .error_boundary import ErrorBoundary
from .error_codes import UnreadableMessage
from .inputs import Inputs
from .qos import LATCHED, LATEST, UPDATES

try:
    from map_msgs.msg import OccupancyGridUpdate  # comes with ROS, not from PyPI
except ImportError:
    OccupancyGridUpdate = None

_SELDOM = 10.0  # s


class Subscriptions:
    """The subscriptions of ``node``.

    ``pose_accepted`` is called after each start, goal and array of stops, ``map_accepted`` after
    each map and each change of one. ``start_topic`` and ``goal_topic`` are full names.
    """

    def __init__(
        self,
        node: Node,
        inputs: Inputs,
        error_boundary: ErrorBoundary,
        pose_accepted: Callable[[], None],
        map_accepted: Callable[[], None],
    ) -> None:
        self._node, self._guard = node, error_boundary
        self._all: list[Subscription] = []
        self._map_topic = node.resolve_topic_name('alpha_map')
        self._map: CurrentMap | None = None  # the last one that was told

        def accept_map(got: Received) -> None:
            self._tell_map(inputs.accept_map(got))
            map_accepted()

        def update_map(got: Received) -> None:
            inputs.update_map(got.message)
            map_accepted()

        def set_start(got: Received) -> None:
            inputs.set_start(got)
            pose_accepted()

        def set_goal(got: Received) -> None:
            inputs.set_goal(got)
            pose_accepted()

        def set_via(got: Received) -> None:
            inputs.set_via(got)
            pose_accepted()

        self._subscribe(OccupancyGrid, 'alpha_map', LATCHED, accept_map)
        if OccupancyGridUpdate is not None:
            self._subscribe(
                OccupancyGridUpdate, 'alpha_map_updates', UPDATES, update_map, read_grid_update
            )
        self.start_topic = self._subscribe(PoseStamped, 'start_pose', LATEST, set_start)
        self.goal_topic = self._subscribe(PoseStamped, 'goal_pose', LATEST, set_goal)
        self._subscribe(PoseArray, 'via_poses', LATEST, set_via)
        self._subscribe(
            PoseWithCovarianceStamped, 'initialpose', LATEST,
            lambda got: set_start(_without_covariance(got)),
        )

    def unheard_maps(self) -> str:
        """Say so where maps are published without the durability that this node asks for."""
        volatile = sorted({
            f'{each.node_namespace.rstrip("/")}/{each.node_name}'
            for each in self._node.get_publishers_info_by_topic(self._map_topic)
            if each.qos_profile.durability == DurabilityPolicy.VOLATILE
        })
        if not volatile:
            return ''
        return (
            f'{", ".join(volatile)[:200]} publishes {self._map_topic} with volatile durability, '
            'so that nothing of it arrives here: publish it transient local'
        )

    def _tell_map(self, new: CurrentMap) -> None:
        before, self._map = self._map, new
        if new is before:
            return
        height, width = new.values.shape
        text = (
            f'map accepted: {width} x {height} cells of {new.resolution:.3g} m in the frame '
            f'{new.frame[:80]!r}'
        )
        if before is not None and new.same_ground(before):  # a costmap's comes every second
            self._node.get_logger().info(text, throttle_duration_sec=_SELDOM)
        else:
            self._node.get_logger().info(text)

    def _subscribe(
        self,
        kind: type,
        topic: str,
        qos: QoSProfile,
        use: Callable[[Received], None],
        read: Callable[[bytes], Any] | None = None,
    ) -> str:
        """Subscribe, and return the topic's full name."""
        name = self._node.resolve_topic_name(topic)
        concern = 'map' if topic.startswith('alpha_map') else 'request'

        def receive(data: bytes) -> None:
            self._guard.attempt(name, concern, lambda: use(_received(kind, name, data, qos, read)))

        # Raw: what cannot be read would end the executor, and recordings keep the bytes that came.
        self._all.append(self._node.create_subscription(kind, topic, receive, qos, raw=True))
        return name

    def close(self) -> None:
        """Listen to nothing any more."""
        for subscription in self._all:
            self._node.destroy_subscription(subscription)


def _received(
    kind: type, topic: str, data: bytes, qos: QoSProfile, read: Callable[[bytes], Any] | None
) -> Received:
    try:
        message = read(data) if read else deserialize_message(data, kind)
    except Exception as error:  # rclpy's own error type is not public
        raise UnreadableMessage(
            f'{len(data)} bytes on {topic} are not a message of type {kind.__name__}'
        ) from error
    return Received(topic, type_name(kind), message, data, qos)


def _without_covariance(got: Received) -> Received:
    """The pose of an estimate, with the bytes that came."""
    pose = PoseStamped(header=got.message.header, pose=got.message.pose.pose)
    return replace(got, message=pose)
