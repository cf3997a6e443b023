# SPDX-License-Identifier: Apache-2.0
"""What the node listens to, read and handed to its inputs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

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
from .error_boundary import ErrorBoundary
from .error_codes import FrameMismatch, UnreadableMessage
from .inputs import Inputs
from .listener import Listener
from .topics import LATCHED, LATEST, UPDATES

# Age from which a costmap counts as stopped, and how often its place is looked up again [s].
_STOPPED, _JOIN_PERIOD = 5.0, 1.0


class Subscriptions:
    """The subscriptions of ``node``.

    ``pose_accepted`` is called after each start, goal and array of stops; ``map_accepted`` after
    each map and each update of one, with whether the map that is used is another one, in the thread
    that receives maps: nothing else waits for them. ``warn`` sets a warning by what it concerns.
    """

    def __init__(self, node: Node, inputs: Inputs, error_boundary: ErrorBoundary,
                 pose_accepted: Callable[[], None], map_accepted: Callable[[bool], None],
                 warn: Callable[[str, str], None]) -> None:
        self._node, self._inputs, self._error_boundary = node, inputs, error_boundary
        self._warn = warn
        self._subscriptions: list[Subscription] = []
        self._maps = Listener(node, 'map')
        self._arrived: dict[str, float] = {}
        self._map_topic = node.resolve_topic_name('alpha_map')
        self._used_map: CurrentMap | None = None

        def accept_map(topic: str, received: ReceivedMessage) -> None:
            self._arrived[topic] = time.monotonic()
            inputs.accept_map(topic, received)
            use_maps()

        def use_maps() -> None:
            map_accepted(self._is_new(inputs.join_maps()))

        def join_again() -> None:
            with suppress(FrameMismatch):  # reported since the costmap came
                use_maps()

        def accept(role: str, received: ReceivedMessage | None) -> None:
            setattr(inputs, role, received)
            pose_accepted()

        update_type = installed_type('map_msgs.msg', 'OccupancyGridUpdate')
        for topic in ('alpha_map', *(('costmap',) if inputs.with_costmap else ())):
            use = partial(accept_map, topic)
            self._subscribe(OccupancyGrid, topic, LATCHED, use)
            if update_type is not None:
                self._subscribe(update_type, f'{topic}_updates', UPDATES, use)
        if inputs.with_costmap:  # its transform may come later, or change
            self._maps.every(_JOIN_PERIOD,
                             lambda: error_boundary.attempt('costmap', 'map', join_again))
        self._subscribe(PoseStamped, 'start_pose', LATEST, partial(accept, 'start'))
        self._subscribe(PoseStamped, 'goal_pose', LATEST, partial(accept, 'goal'))
        self._subscribe(
            PoseArray, 'via_poses', LATEST,
            lambda received: accept('via', received if received.message.poses else None),
        )
        self._subscribe(PoseWithCovarianceStamped, 'initialpose', LATEST,
                        lambda received: accept('start', _without_covariance(received)))
        self._maps.start()

    def volatile_map_warning(self) -> str:
        """Return a warning if a map is published without the durability asked for, else ''."""
        volatile = sorted({f'{each.node_namespace.rstrip("/")}/{each.node_name}'
                           for each in self._node.get_publishers_info_by_topic(self._map_topic)
                           if each.qos_profile.durability == DurabilityPolicy.VOLATILE})
        if not volatile:
            return ''
        return (
            f'{", ".join(volatile)[:200]} publishes {self._map_topic} with volatile durability, '
            'so no map arrives from there: publish it transient local'
        )

    def costmap_warning(self) -> str:
        """Return a warning if a costmap no longer comes, else ''."""
        age = time.monotonic() - self._arrived.get('costmap', math.inf)
        if age <= _STOPPED:
            return ''
        return (f'the costmap is {age:.0f} s old, so newer obstacles are missing; check that '
                f'{self._node.resolve_topic_name("costmap")} is still published')

    def close(self) -> None:
        """Destroy the subscriptions, and wait until no map is being read."""
        self._maps.close()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _is_new(self, new: CurrentMap | None) -> bool:
        """Whether a map is another one; log it, and warn of one without risk while it is used."""
        before, self._used_map = self._used_map, new
        if new is None or new is before:
            return False
        flat = not carries_risk(new.values, self._inputs.settings.current.occupancy)
        self._warn('risk', NO_RISK if flat else '')
        height, width = new.values.shape
        logger = self._node.get_logger()
        if before is None or not new.same_ground(before):  # else a costmap, every second
            logger.info(f'map accepted: {width} x {height} cells of {new.resolution:.3g} m in the '
                        f'frame {new.frame[:80]!r}')
        return True

    def _subscribe(self, kind: type, topic: str, qos: QoSProfile,
                   use: Callable[[ReceivedMessage], None]) -> None:
        name = self._node.resolve_topic_name(topic)
        is_map = topic.startswith(('alpha_map', 'costmap'))
        concern = 'map' if is_map else 'request'

        def receive(data: bytes) -> None:
            self._error_boundary.attempt(name, concern,
                                         lambda: use(_deserialised(kind, name, data, qos)))

        # Raw: unreadable bytes would end the executor, and recordings keep the bytes that arrived.
        if is_map:
            self._maps.subscribe(kind, topic, receive, qos, raw=True)
        else:
            self._subscriptions.append(
                self._node.create_subscription(kind, topic, receive, qos, raw=True)
            )


def _deserialised(kind: type, topic: str, data: bytes, qos: QoSProfile) -> ReceivedMessage:
    try:
        message = deserialize_message(data, kind)
    except Exception as error:  # rclpy's own error type is not public
        raise UnreadableMessage(
            f'{len(data)} bytes on {topic} are not a message of type {kind.__name__}'
        ) from error
    return ReceivedMessage(topic, type_name(kind), message, qos, data)


def _without_covariance(received: ReceivedMessage) -> ReceivedMessage:
    pose = PoseStamped(header=received.message.header, pose=received.message.pose.pose)
    return replace(received, message=pose)
