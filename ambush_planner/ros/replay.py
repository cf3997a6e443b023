"""Publishes recorded messages as the bytes that they are."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ..core.errors import AmbushPlannerError
from ..recording.types import TYPES

_STEP = 0.1  # s; how soon the end of a wait is noticed
# A listener that has been found finds the publisher a little later, and until then it misses what
# is not latched.
_SETTLING = 0.5  # s


class CannotPublish(AmbushPlannerError):
    """The middleware takes no publisher like the recorded one."""


class Player:
    """Publishers for what was recorded, by any key; kept to the end, as latched topics need."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publishers: dict[object, Publisher] = {}

    def advertise(self, key: object, topic: str, type_: str, qos: QoSProfile) -> None:
        """Make a publisher; ``type_`` is one of ``TYPES``, ``topic`` a valid name.

        Raises
        ------
        CannotPublish
            The middleware refuses it.
        """
        try:
            self._publishers[key] = self._node.create_publisher(TYPES[type_], topic, qos)
        except (RuntimeError, TypeError, ValueError, ArithmeticError) as error:
            # RCLError, and what the binding to C++ raises on numbers that do not fit.
            reason = str(error).partition("\n")[0]
            raise CannotPublish(
                f"{topic} cannot be published as {type_}: {reason}; leave it out with --topics"
            ) from error

    def publish(self, key: object, data: bytes) -> None:
        """Publish a serialised message."""
        self._publishers[key].publish(data)

    def wait_for_listeners(
        self, seconds: float, patience: float, going_on: Callable[[], bool]
    ) -> list[str]:
        """Wait until somebody listens to each topic; return those that nobody listens to.

        Parameters
        ----------
        seconds
            The longest wait [s].
        patience
            Where somebody listens to some topics, how long others are waited for [s].
        going_on
            Ends the wait when it is false.
        """
        end, changed = time.monotonic() + seconds, time.monotonic()
        before: set[str] = set()
        while going_on() and (now := time.monotonic()) < end:
            unheard = self._unheard()
            if unheard != before:
                before, changed = unheard, now
            some = len(unheard) < len(self._publishers)
            if now - changed > (patience if unheard else _SETTLING) and some:
                break
            time.sleep(_STEP / 4)
        return sorted(self._unheard())

    def wait_until_received(self, seconds: float, going_on: Callable[[], bool]) -> list[str]:
        """Wait until all reliable listeners have all; return the topics where one has not."""
        end = time.monotonic() + seconds
        waiting = [
            publisher
            for publisher in self._publishers.values()
            if publisher.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT
        ]
        while waiting and going_on() and time.monotonic() < end:
            waiting = [p for p in waiting if not p.wait_for_all_acked(Duration(seconds=_STEP))]
        return sorted({publisher.topic_name for publisher in waiting})

    def _unheard(self) -> set[str]:
        publishers = self._publishers.values()
        return {p.topic_name for p in publishers if not p.get_subscription_count()}


def sleep_until(end: float, going_on: Callable[[], bool]) -> bool:
    """Sleep until ``time.monotonic()`` is ``end``; return False if it was cut short."""
    while going_on():
        left = end - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, _STEP))
    return False
