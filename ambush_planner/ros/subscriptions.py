# SPDX-License-Identifier: Apache-2.0
"""What the node listens to, read and handed to its inputs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from ..maps.occupancy import NO_RISK, carries_risk
from ..recordings import type_name
from .conversions import installed_type
from .current_map import CurrentMap, ReceivedMessage
from .diagnostics import Reporter
from .dispatcher import Dispatcher
from .error_boundary import ErrorBoundary
from .error_codes import FrameMismatch, Refusal
from .inputs import Inputs
from .listener import Listener
from .parameter_changes import NodeSettings
from .topics import LATCHED, LATEST, UPDATES

# Age from which a costmap counts as stopped, and how often its place is looked up again [s].
_STOPPED, _JOIN_PERIOD = 5.0, 1.0


class Subscriptions:
    """The subscriptions of ``node``.

    Maps are received in a thread of their own: nothing else waits for them.
    """

    def __init__(self, node: Node, inputs: Inputs, settings: NodeSettings,
                 error_boundary: ErrorBoundary, reporter: Reporter,
                 dispatcher: Dispatcher) -> None:
        self._node, self._inputs, self._settings = node, inputs, settings
        self._error_boundary, self._reporter = error_boundary, reporter
        self._dispatcher = dispatcher
        self._subscriptions: list[Subscription] = []
        self._maps = Listener(node, 'map')
        self._costmap_at: float | None = None  # when the last one came [s]
        update_type = installed_type('map_msgs.msg', 'OccupancyGridUpdate')
        for name in inputs.map_names:
            self._listen_for_map(name, OccupancyGrid, name, LATCHED)
            if update_type is not None:
                self._listen_for_map(name, update_type, f'{name}_updates', UPDATES)
        if 'costmap' in inputs.map_names:  # its transform may come later, or change
            self._maps.node.create_timer(
                _JOIN_PERIOD, lambda: error_boundary.attempt('costmap', 'join', self._join_again))
        self._listen_for_pose('start', PoseStamped, 'start_pose')
        self._listen_for_pose('start', PoseWithCovarianceStamped, 'initialpose',
                              _without_covariance)
        self._listen_for_pose('goal', PoseStamped, 'goal_pose')
        self._listen_for_pose('via', PoseArray, 'via_poses',
                              lambda received: received if received.message.poses else None)
        self._maps.start()

    def check(self) -> None:
        """Warn of maps that do not arrive; to be called about once a second."""
        volatile = sorted({f'{each.node_namespace.rstrip("/")}/{each.node_name} publishes {topic}'
                           for topic in map(self._node.resolve_topic_name, self._inputs.map_names)
                           for each in self._node.get_publishers_info_by_topic(topic)
                           if each.qos_profile.durability == DurabilityPolicy.VOLATILE})
        self._reporter.note('volatile', '' if not volatile else (
            f'{", ".join(volatile)[:200]} with volatile durability, so no map arrives from there: '
            'publish it transient local'))
        age = 0.0 if self._costmap_at is None else time.monotonic() - self._costmap_at
        self._reporter.note('stopped', '' if age <= _STOPPED else (
            f'the costmap is {age:.0f} s old, so newer obstacles are missing; check that '
            f'{self._node.resolve_topic_name("costmap")} is still published'))

    def close(self) -> None:
        """Destroy the subscriptions, and wait until no map is being read."""
        self._maps.close()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _listen_for_map(self, name: str, kind: type, topic: str, qos: QoSProfile) -> None:
        def accept(received: ReceivedMessage) -> None:
            if name == 'costmap':
                self._costmap_at = time.monotonic()
            self._inputs.accept_map(name, received)
            self._reporter.note(name, None)
            self._error_boundary.attempt('costmap', 'join', self._use_maps)

        self._listen(self._maps.node, kind, topic, qos, name, accept)

    def _listen_for_pose(self, role: str, kind: type, topic: str,
                         read: Callable[[ReceivedMessage], ReceivedMessage | None] | None = None,
                         ) -> None:
        def accept(received: ReceivedMessage) -> None:
            setattr(self._inputs, role, read(received) if read else received)
            self._dispatcher.prepare()

        self._subscriptions.append(
            self._listen(self._node, kind, topic, LATEST, 'request', accept))

    def _listen(self, node: Node, kind: type, topic: str, qos: QoSProfile, concern: str,
                accept: Callable[[ReceivedMessage], None]) -> Subscription:
        """Subscribe by a node to raw messages; errors are reported with what they concern.

        Raw: unreadable bytes would end the executor, and recordings keep the bytes that arrived.
        """
        name = self._node.resolve_topic_name(topic)

        def receive(data: bytes) -> None:
            self._error_boundary.attempt(name, concern,
                                         lambda: accept(_deserialised(kind, name, data, qos)))

        own = node is self._node  # which resolves names itself
        return node.create_subscription(kind, topic if own else name, receive, qos, raw=True)

    def _join_again(self) -> None:
        with suppress(FrameMismatch):  # reported since the costmap came
            self._use_maps()

    def _use_maps(self) -> None:
        before, new = self._inputs.map, self._inputs.join_maps()
        self._reporter.note('join', None)
        if new is not None and new is not before:
            self._announce(new, before)
            self._dispatcher.map_changed()

    def _announce(self, new: CurrentMap, before: CurrentMap | None) -> None:
        """Warn of a map without risk while it is used; log one of another size, place or frame."""
        flat = not carries_risk(new.values, self._settings.current.occupancy)
        self._reporter.note('risk', NO_RISK if flat else '')
        if before is None or not new.same_ground(before):  # else a costmap, every second
            height, width = new.values.shape
            self._node.get_logger().info(
                f'map accepted: {width} x {height} cells of {new.resolution:.3g} m in the frame '
                f'{new.frame[:80]!r}')


def _deserialised(kind: type, topic: str, data: bytes, qos: QoSProfile) -> ReceivedMessage:
    try:
        message = deserialize_message(data, kind)
    except Exception as error:  # rclpy's own error type is not public
        raise Refusal('INVALID_MESSAGE', f'{len(data)} bytes on {topic} are not a message of type '
                      f'{kind.__name__}') from error
    return ReceivedMessage(topic, type_name(kind), message, qos, data)


def _without_covariance(received: ReceivedMessage) -> ReceivedMessage:
    pose = PoseStamped(header=received.message.header, pose=received.message.pose.pose)
    return replace(received, message=pose)
