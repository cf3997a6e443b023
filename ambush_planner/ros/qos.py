"""The quality of service of everything that the node subscribes, publishes and serves."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Late joiners get the last message.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
# Each update of a map counts, and costmaps send many.
UPDATES = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
# Many may ask at once while a solve runs: none of them is to go without an answer.
REQUESTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
DIAGNOSTICS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# As tf2_ros subscribes.
TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
TF_STATIC = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
