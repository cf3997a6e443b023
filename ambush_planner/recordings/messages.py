"""What a recording is made of: messages as they travelled, and files that go with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .qos_text import qos_to_yaml

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

_LATEST_NS = 2**63 - 1


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
        The message serialised (CDR), with the four bytes of its header.
    qos
        What it was offered with: a profile, or its text as it is read back.
    stamp_ns
        When, in nanoseconds of the node's clock; players keep these distances.

    Raises
    ------
    ValueError
        The stamp is negative or does not fit in 63 bits, as ROS times do.
    """

    topic: str
    type: str
    data: bytes
    qos: QoSProfile | str
    stamp_ns: int

    def __post_init__(self) -> None:
        if not 0 <= self.stamp_ns <= _LATEST_NS:
            raise ValueError(f'{self.topic}: the stamp {self.stamp_ns} ns is not a ROS time')

    @property
    def qos_text(self) -> str:
        """The profile as ``offered_qos_profiles`` states it."""
        return self.qos if isinstance(self.qos, str) else qos_to_yaml(self.qos)


@dataclass(frozen=True)
class Attachment:
    """A file that lies in the recording beside the messages, like ``strategy.npz``."""

    name: str
    media_type: str
    data: bytes


def type_name(message: Any) -> str:
    """Return the ROS name of a message's type, like ``nav_msgs/msg/Path``.

    Takes a message or a message class; also ``std_srvs.srv.Trigger.Event``.
    """
    type_ = message if isinstance(message, type) else type(message)
    package, kind = type_.__module__.split('.')[:2]
    return f'{package}/{kind}/{type_.__name__}'
