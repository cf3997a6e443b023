# SPDX-License-Identifier: Apache-2.0
"""The heartbeat by which Nav2's lifecycle manager knows that an active node lives."""

from __future__ import annotations

from uuid import uuid4

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from .conversions import installed_type
from .gate import Gate

# Time between two heartbeats, and without any until the manager takes action [s]; as in Nav2.
_PERIOD, _TIMEOUT = 0.1, 4.0


class Bond:
    """Sends bond/Status on ``bond`` while the ``gate`` is open, if the package bond is installed.

    Only the sending side; the lifecycle manager needs no more. The executor sends the heartbeat, so
    a node that hangs has none. The end is announced.
    """

    def __init__(self, node: Node, gate: Gate) -> None:
        self._node, self._gate, self._instance = node, gate, str(uuid4())
        self._active = False
        self._status = installed_type('bond.msg', 'Status')
        if self._status:
            self._publisher = node.create_publisher(self._status, 'bond', 1)
            # A steady clock: heartbeats go on while simulated time is paused.
            node.create_timer(_PERIOD, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _beat(self) -> None:
        before, self._active = self._active, self._gate.is_open
        if not (before or self._active):
            return
        status = self._status(
            id=self._node.get_name(), instance_id=self._instance, active=self._active,
            heartbeat_timeout=_TIMEOUT, heartbeat_period=_PERIOD)
        status.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(status)
