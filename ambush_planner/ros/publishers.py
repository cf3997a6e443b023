# SPDX-License-Identifier: Apache-2.0
"""Everything that the node publishes, with its quality of service."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from visualization_msgs.msg import MarkerArray

from ..recordings import RecordedMessage, type_name
from .qos import DIAGNOSTICS, LATCHED

Topics = Mapping[str, tuple[type, QoSProfile]]
_MARKERS = ('network', 'edge_probabilities', 'mean_direction', 'ambush_sites', 'stops')
# Topics that exist while the node is configured.
PLAN_TOPICS: Topics = {'path': (PathMessage, LATCHED),
                       **{f'~/{each}': (MarkerArray, LATCHED) for each in _MARKERS}}
# Topics that exist in all states of the node.
STATUS_TOPICS: Topics = {'/diagnostics': (DiagnosticArray, DIAGNOSTICS)}


class Publishers:
    """Publishes on ``topics``, and returns each message as a recording keeps it."""

    def __init__(self, node: Node, topics: Topics) -> None:
        self._node, self._topics = node, topics
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
        stamp = self._node.get_clock().now().nanoseconds
        name = name or self._publishers[topic].topic_name
        return RecordedMessage(name, type_name(kind), data, qos, stamp)

    def close(self) -> None:
        """Destroy the publishers, so that late subscribers get no latched message."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
