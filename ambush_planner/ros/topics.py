# SPDX-License-Identifier: Apache-2.0
"""Quality of service of all topics and services, and everything that the node publishes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from visualization_msgs.msg import MarkerArray

from ..recordings.messages import RecordedMessage, qos_text, type_name
from .markers import MARKERS

_RELIABLE, _LATCHING = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
# Late subscribers get the last message.
LATCHED = QoSProfile(depth=1, reliability=_RELIABLE, durability=_LATCHING)
LATEST = QoSProfile(depth=1, reliability=_RELIABLE)
# Every update of a map matters, and costmaps send many.
UPDATES = QoSProfile(depth=1000, reliability=_RELIABLE)
# Requests that arrive while a solve runs are all answered.
REQUESTS = QoSProfile(depth=1000, reliability=_RELIABLE)
DIAGNOSTICS = QoSProfile(depth=10, reliability=_RELIABLE)
# As in tf2_ros.
TF = QoSProfile(depth=100, reliability=_RELIABLE)
TF_STATIC = QoSProfile(depth=100, reliability=_RELIABLE, durability=_LATCHING)

Topics = Mapping[str, tuple[type, QoSProfile]]
# Topics that exist while the node is configured.
PLAN_TOPICS: Topics = {'path': (PathMessage, LATCHED), 'plan': (PathMessage, LATCHED),
                       **{f'~/{each}': (MarkerArray, LATCHED) for each in MARKERS}}
# Topics that exist in all states of the node.
STATUS_TOPICS: Topics = {'/diagnostics': (DiagnosticArray, DIAGNOSTICS)}


def offered(qos: QoSProfile) -> str:
    """Return a profile as a recording has it."""
    return qos_text(qos.depth, qos.durability == _LATCHING)


class Publishers:
    """Publishes on ``topics``, and returns each message as a recording keeps it.

    ``clock`` is the node's.
    """

    def __init__(self, node: Node, topics: Topics) -> None:
        self._node, self._topics, self.clock = node, topics, node.get_clock()
        self._publishers = {topic: node.create_publisher(kind, topic, qos)
                            for topic, (kind, qos) in topics.items()}

    def publish(self, topic: str, message: Any) -> RecordedMessage:
        """Publish a message, or its serialised bytes, on one of ``topics``."""
        recorded = self.as_recorded(topic, message)
        self._publishers[topic].publish(recorded.data)
        return recorded

    def as_recorded(self, topic: str, message: Any, name: str = '') -> RecordedMessage:
        """Return a message as a recording keeps it (by default under its topic), unpublished."""
        data = message if isinstance(message, bytes) else serialize_message(message)
        kind, qos = self._topics[topic]
        name = name or self._publishers[topic].topic_name
        return RecordedMessage(name, type_name(kind), data, offered(qos),
                               self.clock.now().nanoseconds)

    def close(self) -> None:
        """Destroy the publishers, so that late subscribers get no latched message."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
