# SPDX-License-Identifier: Apache-2.0
"""The heartbeat by which Nav2's lifecycle manager knows that an active node lives."""

from __future__ import annotations

from functools import partial
from uuid import uuid4

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from .conversions import installed_type

# Time between two heartbeats, and without any until the manager takes action [s]; as in Nav2.
_PERIOD, _TIMEOUT = 0.1, 4.0


class Bond:
    """Sends bond/Status on ``bond`` while it is active, if the package bond is installed.

    Only the sending side; the lifecycle manager needs no more. The executor sends the heartbeat, so
    a node that hangs has none.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._instance = node, str(uuid4())
        self._status = installed_type('bond.msg', 'Status')
        if self._status:
            self._publisher = node.create_publisher(self._status, 'bond', 1)
            # A steady clock: heartbeats go on while simulated time is paused.
            self._timer = node.create_timer(_PERIOD, partial(self._beat, True), autostart=False,
                                            clock=Clock(clock_type=ClockType.STEADY_TIME))

    def set_active(self, active: bool) -> None:
        """Begin or end; the end is announced."""
        if self._status and self._timer.is_canceled() == active:
            (self._timer.reset if active else self._timer.cancel)()
            self._beat(active)

    def _beat(self, active: bool) -> None:
        status = self._status(id=self._node.get_name(), instance_id=self._instance, active=active,
                              heartbeat_timeout=_TIMEOUT, heartbeat_period=_PERIOD)
        status.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(status)
