# SPDX-License-Identifier: Apache-2.0
"""The node's subscriptions, read and handed to its inputs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Lock
from typing import Any

from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from ..maps.occupancy import NO_RISK, carries_risk
from .conversions import installed_type, message_from
from .diagnostics import Reporter
from .dispatcher import Dispatcher
from .errors import ErrorBoundary, FrameMismatch, Refusal
from .inputs import MAX_STOPS, Arrived, Inputs
from .listener import Listener
from .parameter_changes import NodeSettings
from .serial_executor import SerialExecutor
from .topics import LATCHED, LATEST, UPDATES

# Age from which a costmap counts as stopped [s].
_STOPPED = 5.0
# Maximum size of a serialised message with poses: many times that of MAX_STOPS [bytes].
_MAX_POSES_SIZE = 1000 * MAX_STOPS


class Subscriptions:
    """The subscriptions of ``node``: its own for poses, those of a ``listener`` for maps.

    Maps are read in a thread of their own: nothing else waits for them, and what has come in the
    meantime is read together.
    """

    def __init__(self, node: Node, listener: Listener, inputs: Inputs, settings: NodeSettings,
                 error_boundary: ErrorBoundary, reporter: Reporter,
                 dispatcher: Dispatcher) -> None:
        self._node, self._inputs, self._settings = node, inputs, settings
        self._error_boundary, self._reporter = error_boundary, reporter
        self._dispatcher = dispatcher
        self._subscriptions: list[Subscription] = []
        self._topics: dict[str, QoSProfile] = {}  # full names
        self._unread: dict[str, list[Arrived]] = {name: [] for name in inputs.map_names}
        self._last_update: dict[str, int] = {}  # its number, of each map
        self._lost: dict[str, int] = {}  # since the last whole map
        self._lock = Lock()
        self._judged: tuple[object, ...] = ()  # map and parameters that the risk was looked for in
        self._costmap_at: float | None = None  # when the last one came [s]
        self._reading = SerialExecutor('maps', lambda error: reporter.note('join', error))
        update_type = installed_type('map_msgs.msg', 'OccupancyGridUpdate')
        for name in inputs.map_names:
            for kind, topic, qos in ((OccupancyGrid, name, LATCHED),
                                     (update_type, f'{name}_updates', UPDATES)):
                if kind is not None:
                    self._topics[node.resolve_topic_name(topic)] = qos
                    listener.subscribe(kind, topic, qos, partial(self._receive_map, name, kind))
        self._listen_for_pose('start', PoseStamped, 'start_pose')
        self._listen_for_pose('start', PoseWithCovarianceStamped, 'initialpose', lambda message:
                              PoseStamped(header=message.header, pose=message.pose.pose))
        self._listen_for_pose('goal', PoseStamped, 'goal_pose')
        self._listen_for_pose('via', PoseArray, 'via_poses',
                              lambda message: message if message.poses else None)

    def check(self) -> None:
        """Look for maps that do not arrive or have moved; to be called about once a second."""
        deaf = sorted({
            f'{each.node_namespace.rstrip("/")}/{each.node_name} publishes {topic}'
            for topic, qos in self._topics.items()
            for each in self._node.get_publishers_info_by_topic(topic)
            if qos_check_compatible(each.qos_profile, qos)[0] == QoSCompatibility.ERROR})
        self._reporter.note('qos', '' if not deaf else (
            f'{", ".join(deaf)[:200]}, from where nothing arrives: publish it reliable, and maps '
            'transient local'))
        age = 0.0 if self._costmap_at is None else time.monotonic() - self._costmap_at
        self._reporter.note('stopped', '' if age <= _STOPPED else (
            f'the costmap is {age:.0f} s old, so newer obstacles are missing; check that '
            f'{self._node.resolve_topic_name("costmap")} is still published'))
        self._reading.submit(self._join_again)

    def close(self) -> None:
        """Destroy the subscriptions, and wait until no map is being read."""
        self._reading.close()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _receive_map(self, name: str, kind: type, data: bytes, info: dict[str, int]) -> None:
        """Keep a map or an update until it is read."""
        if name == 'costmap':
            self._costmap_at = time.monotonic()
        with self._lock:
            if kind is not OccupancyGrid:
                number = info['publication_sequence_number']
                before, self._last_update[name] = self._last_update.get(name, number), number
                self._lost[name] = self._lost.get(name, 0) + max(number - before - 1, 0)
            unread = self._unread[name]
            unread.append(Arrived(kind, data, info['source_timestamp']))
            first = len(unread) == 1
        if first:
            self._reading.submit(partial(self._read_maps, name))

    def _read_maps(self, name: str) -> None:
        with self._lock:
            unread, self._unread[name] = self._unread[name], []
            if any(each.kind is OccupancyGrid for each in unread):
                self._lost[name] = 0
            lost = self._lost.get(name)
        topic = self._node.resolve_topic_name(name)
        _, error = self._error_boundary.attempt(topic, name,
                                                lambda: self._inputs.accept_map(name, unread))
        if not error:
            self._reporter.note(name, None)
        self._reporter.note(f'{name}_updates', '' if not lost else (
            f'{lost} messages on {topic}_updates were lost, so cells may be wrong until the whole '
            f'map is published: send fewer or larger updates'))
        self._error_boundary.attempt('costmap', 'join', self._use_maps)

    def _listen_for_pose(self, role: str, kind: type, topic: str,
                         read: Callable[[Any], Any] = lambda message: message) -> None:
        """Subscribe to serialised poses: unreadable bytes would end the executor."""
        name = self._node.resolve_topic_name(topic)
        self._topics[name] = LATEST

        def accept(data: Any) -> None:
            if len(data) > _MAX_POSES_SIZE:  # rclpy would take seconds for each megabyte
                raise Refusal('INVALID_MESSAGE', f'{len(data)} bytes on {name}: at most '
                              f'{MAX_STOPS} poses are allowed')
            setattr(self._inputs, role, read(message_from(data, kind, name)))

        def receive(data: Any) -> None:
            self._error_boundary.attempt(name, 'request', lambda: accept(data))

        self._subscriptions.append(
            self._node.create_subscription(kind, topic, receive, LATEST, raw=True))

    def _join_again(self) -> None:
        """Use the maps as transforms and parameters are now."""
        with suppress(FrameMismatch):  # reported since the costmap came
            self._use_maps()

    def _use_maps(self) -> None:
        """Join the maps, and warn while they carry no risk."""
        before, new = self._inputs.map, self._inputs.join_maps()
        self._reporter.note('join', None)
        if new is None:
            return
        judged = new, self._settings.current.occupancy
        if judged != self._judged:
            self._judged = judged
            self._reporter.note('risk', '' if carries_risk(new.values, judged[1]) else NO_RISK)
        if new is before:
            return
        if before is None or not new.same_ground(before):  # costmaps come every second
            height, width = new.values.shape
            self._node.get_logger().info(
                f'map accepted: {width} x {height} cells of {new.resolution:.3g} m in the frame '
                f'{new.frame[:80]!r}')
        self._dispatcher.map_changed()
