"""Everything that the node publishes, with the quality of service that DESIGN promises."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.serialization import serialize_message
from visualization_msgs.msg import MarkerArray

from ..recording import RecordedMessage, type_name
from .qos import DIAGNOSTICS, LATCHED

_TOPICS = {
    'path': (PathMessage, LATCHED),
    'edge_probabilities': (MarkerArray, LATCHED),
    'mean_direction': (MarkerArray, LATCHED),
    'ambush_sites': (MarkerArray, LATCHED),
    'network': (MarkerArray, LATCHED),
    'stops': (MarkerArray, LATCHED),
    '/diagnostics': (DiagnosticArray, DIAGNOSTICS),
}


class Outbox:
    """Publishes, and hands back what a recording keeps of it."""

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._publishers = {
            topic: node.create_publisher(kind, topic, qos)
            for topic, (kind, qos) in _TOPICS.items()
        }

    def publish(self, topic: str, message: Any) -> RecordedMessage:
        """Publish on one of the node's topics, by the name that it has in the code.

        ``message`` may be serialised already; it is serialised once in any case.
        """
        data = message if isinstance(message, bytes) else serialize_message(message)
        publisher = self._publishers[topic]
        publisher.publish(data)
        kind, qos = _TOPICS[topic]
        stamp = self._clock.now().nanoseconds
        return RecordedMessage(publisher.topic_name, type_name(kind), data, qos, stamp)

    def topic_name(self, topic: str) -> str:
        """Return the full name after namespaces and remapping."""
        return self._publishers[topic].topic_name
