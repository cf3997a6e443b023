"""Everything that the node publishes, with the quality of service that DESIGN promises."""

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

# What is planned, and what is told of it.
PLANS = {
    'path': (PathMessage, LATCHED),
    'edge_probabilities': (MarkerArray, LATCHED),
    'mean_direction': (MarkerArray, LATCHED),
    'ambush_sites': (MarkerArray, LATCHED),
    'network': (MarkerArray, LATCHED),
    'stops': (MarkerArray, LATCHED),
}
STATUS = {
    '/diagnostics': (DiagnosticArray, DIAGNOSTICS),
}


class Publishers:
    """Publishes on ``topics``, and hands back what a recording keeps of it."""

    def __init__(self, node: Node, topics: Mapping[str, tuple[type, QoSProfile]]) -> None:
        self._node, self._topics = node, topics
        self._publishers = {
            topic: node.create_publisher(kind, topic, qos)
            for topic, (kind, qos) in topics.items()
        }

    def publish(self, topic: str, message: Any) -> RecordedMessage:
        """Publish on one of the node's topics, by the name that it has in the code.

        ``message`` may be serialised already; it is serialised once in any case.
        """
        publisher = self._publishers[topic]
        kept = self.as_recorded(topic, message, publisher.topic_name)
        publisher.publish(kept.data)
        return kept

    def as_recorded(self, topic: str, message: Any, name: str) -> RecordedMessage:
        """Return what a recording keeps of a message, under the full ``name``; publish nothing."""
        data = message if isinstance(message, bytes) else serialize_message(message)
        kind, qos = self._topics[topic]
        stamp = self._node.get_clock().now().nanoseconds
        return RecordedMessage(name, type_name(kind), data, qos, stamp)

    def close(self) -> None:
        """Destroy the publishers, so that late subscribers get nothing that was latched."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
