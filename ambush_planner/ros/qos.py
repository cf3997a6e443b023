"""Quality of service of all topics and services."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Late subscribers get the last message.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
# Every update of a map matters, and costmaps send many.
UPDATES = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
# Requests that arrive while a solve runs are all answered.
REQUESTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
DIAGNOSTICS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# As in tf2_ros.
TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
TF_STATIC = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
