"""Messages as they travelled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from .qos_text import qos_to_yaml


class Channel(NamedTuple):
    """A topic with one type and one quality of service, as the text of ``offered_qos_profiles``."""

    topic: str
    type: str
    qos: str


@dataclass(frozen=True)
class RecordedMessage:
    """A message as it was received or published.

    Attributes
    ----------
    topic
        Its full name, with a leading slash.
    type
        The ROS name of its type, like ``nav_msgs/msg/Path``.
    data
        The serialised message (CDR), with its four-byte header.
    qos
        The publisher's profile (rclpy), or its text as read back from a file.
    stamp_ns
        Time in nanoseconds of the node's clock.
    """

    topic: str
    type: str
    data: bytes
    qos: Any
    stamp_ns: int

    @property
    def channel(self) -> Channel:
        """The channel on which the message is recorded."""
        qos = self.qos if isinstance(self.qos, str) else qos_to_yaml(self.qos)
        return Channel(self.topic, self.type, qos)


def type_name(message: Any) -> str:
    """Return the ROS name of a message's type, like ``nav_msgs/msg/Path``.

    Takes a message or a message class, including ``std_srvs.srv.Trigger.Event``.
    """
    type_ = message if isinstance(message, type) else type(message)
    package, kind = type_.__module__.split('.')[:2]
    return f'{package}/{kind}/{type_.__name__}'
