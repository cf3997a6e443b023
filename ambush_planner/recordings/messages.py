# SPDX-License-Identifier: Apache-2.0
"""Messages as they were sent, with quality of service in the text format of rosbag2 (Jazzy)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import yaml

# rosbag2 refuses a bag that lacks one of these.
_QOS_FIELDS = (
    'history', 'depth', 'reliability', 'durability', 'deadline', 'lifespan', 'liveliness',
    'liveliness_lease_duration', 'avoid_ros_namespace_conventions',
)
DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')
INFINITE_NS = 2**63 - 1


class Channel(NamedTuple):
    """A topic with one type and one quality of service, as the text of ``offered_qos_profiles``."""

    topic: str
    type: str
    qos: str


@dataclass(frozen=True)
class RecordedMessage:
    """A message as it was received or published at ``stamp_ns`` by the node's clock.

    ``topic`` is its full name, ``type`` the ROS name of its type, ``data`` the serialised message
    (CDR), and ``qos`` the publisher's profile (rclpy), or its text as read back from a file. Copies
    of it at other times share ``packed``: the data, and its compressed form.
    """

    topic: str
    type: str
    data: bytes
    qos: Any
    stamp_ns: int
    packed: list[bytes] = field(default_factory=list, compare=False, repr=False)

    @property
    def channel(self) -> Channel:
        """The channel on which the message is recorded."""
        qos = self.qos if isinstance(self.qos, str) else _qos_to_yaml(self.qos)
        return Channel(self.topic, self.type, qos)


def type_name(message: Any) -> str:
    """Return the ROS name of the type of a message or message class."""
    type_ = message if isinstance(message, type) else type(message)
    package, kind = type_.__module__.split('.')[:2]
    return f'{package}/{kind}/{type_.__name__}'


@lru_cache(maxsize=256)
def fields_from_yaml(text: str) -> dict[str, Any]:
    """Return the fields of the first profile in a channel's ``offered_qos_profiles``."""
    fields: dict[str, Any] = yaml.safe_load(text)[0]
    return fields


def _qos_to_yaml(profile: Any) -> str:
    """Return the YAML list with one rclpy profile that a channel's ``offered_qos_profiles`` holds.

    Durations and liveliness that the profile leaves to the middleware are written as the DDS
    defaults, which are what the publisher offered.
    """
    values = (getattr(profile, name) for name in _QOS_FIELDS)
    return _yaml_of(*(getattr(value, 'nanoseconds', value) for value in values))


@lru_cache(maxsize=256)
def _yaml_of(*values: Any) -> str:
    fields = dict(zip(_QOS_FIELDS, values, strict=True))
    for name in DURATIONS:
        # rmw reads a duration of 0 as "unspecified", for which DDS has infinity.
        seconds, rest = divmod(fields[name] or INFINITE_NS, 1_000_000_000)
        fields[name] = {'sec': seconds, 'nsec': rest}
    for name in ('history', 'reliability', 'durability', 'liveliness'):
        fields[name] = fields[name].short_key
    if fields['liveliness'] == 'system_default':
        fields['liveliness'] = 'automatic'
    fields['avoid_ros_namespace_conventions'] = bool(fields['avoid_ros_namespace_conventions'])
    return yaml.safe_dump([fields], sort_keys=False)
