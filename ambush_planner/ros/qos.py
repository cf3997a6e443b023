# SPDX-License-Identifier: Apache-2.0
"""Quality of service of all topics and services."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_RELIABLE, _LATCHING = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
# Late subscribers get the last message.
LATCHED = QoSProfile(depth=1, reliability=_RELIABLE, durability=_LATCHING)
LATEST = QoSProfile(depth=1, reliability=_RELIABLE)
# Every update of a map matters, and costmaps send many.
UPDATES = QoSProfile(depth=100, reliability=_RELIABLE)
# Requests that arrive while a solve runs are all answered.
REQUESTS = QoSProfile(depth=1000, reliability=_RELIABLE)
DIAGNOSTICS = QoSProfile(depth=10, reliability=_RELIABLE)
# As in tf2_ros.
TF = QoSProfile(depth=100, reliability=_RELIABLE)
TF_STATIC = QoSProfile(depth=100, reliability=_RELIABLE, durability=_LATCHING)
