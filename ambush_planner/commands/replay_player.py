"""Publishes recorded messages as the bytes that they are."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.validate_full_topic_name import validate_full_topic_name

from ..errors import AmbushPlannerError
from ..recordings import RecordedMessage, UnreadableRecording
from ..recordings.qos_text import fields_from_yaml
from ..recordings.recorded_case import TYPES

_STEP = 0.1  # s; how soon the end of a wait is noticed
# A listener that has been found finds the publisher a little later, and until then it misses what
# is not latched.
_SETTLING = 0.5  # s


class CannotPublish(AmbushPlannerError):
    """The middleware takes no publisher like the recorded one."""


@dataclass(frozen=True)
class Channel:
    """What is published under one name, with one type and one quality of service."""

    topic: str
    type: str
    qos: str

    @classmethod
    def of(cls, recorded: RecordedMessage) -> Channel:
        """Return the channel of a message."""
        return cls(recorded.topic, recorded.type, recorded.qos_text)


class Player:
    """Publishers for what was recorded; kept to the end, as latched topics need."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publishers: dict[Channel, Publisher] = {}

    def advertise(self, channel: Channel) -> None:
        """Make a publisher for a channel that ``check_channels`` took.

        Raises
        ------
        CannotPublish
            The middleware refuses it.
        """
        try:
            self._publishers[channel] = self._node.create_publisher(
                TYPES[channel.type], channel.topic, qos_from_yaml(channel.qos)
            )
        except (RuntimeError, TypeError, ValueError, ArithmeticError) as error:
            # RCLError, and what the binding to C++ raises on numbers that do not fit.
            reason = str(error).partition('\n')[0]
            raise CannotPublish(
                f'{channel.topic} cannot be published as {channel.type}: {reason}; name the '
                'others after --'
            ) from error

    def publish(self, channel: Channel, data: bytes) -> None:
        """Publish a serialised message."""
        self._publishers[channel].publish(data)

    def wait_for_listeners(self, seconds: float, patience: float) -> list[str]:
        """Wait until somebody listens to each topic; return those that nobody listens to.

        Parameters
        ----------
        seconds
            The longest wait [s].
        patience
            Where somebody listens to some topics, how long others are waited for [s].
        """
        end, before, changed = time.monotonic() + seconds, set(), time.monotonic()
        while (now := time.monotonic()) < end:
            unheard = self._unheard()
            if unheard != before:
                before, changed = unheard, now
            some = len(unheard) < len(self._publishers)
            if now - changed > (patience if unheard else _SETTLING) and some:
                break
            time.sleep(_STEP / 4)
        return sorted(self._unheard())

    def wait_until_received(self, seconds: float) -> list[str]:
        """Wait until all reliable listeners have all; return the topics where one has not."""
        end = time.monotonic() + seconds
        waiting = [
            publisher
            for publisher in self._publishers.values()
            if publisher.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT
        ]
        while waiting and time.monotonic() < end:
            waiting = [p for p in waiting if not p.wait_for_all_acked(Duration(seconds=_STEP))]
        return sorted({publisher.topic_name for publisher in waiting})

    def _unheard(self) -> set[str]:
        publishers = self._publishers.values()
        return {p.topic_name for p in publishers if not p.get_subscription_count()}


def qos_from_yaml(text: str) -> QoSProfile:
    """Return the first profile of a channel's ``offered_qos_profiles``.

    Raises
    ------
    ValueError
        The text does not list complete profiles, or no publisher can have the first.
    """
    fields = fields_from_yaml(text)
    kinds = {
        'history': HistoryPolicy, 'reliability': ReliabilityPolicy, 'durability': DurabilityPolicy,
        'liveliness': LivelinessPolicy,
    }
    try:
        policies = {
            name: kind.get_from_short_key(fields[name]) for name, kind in kinds.items()
        }
        profile = QoSProfile(
            **policies,
            depth=fields['depth'],
            **{name: Duration(seconds=fields[name]['sec'], nanoseconds=fields[name]['nsec'])
               for name in ('deadline', 'lifespan', 'liveliness_lease_duration')},
            avoid_ros_namespace_conventions=fields['avoid_ros_namespace_conventions'],
        )
    except (
        LookupError, TypeError, ValueError, ArithmeticError, AttributeError, AssertionError,
    ) as error:
        raise ValueError('it has no complete quality-of-service profile') from error
    unknown = any(getattr(profile, name).name == 'UNKNOWN' for name in kinds)
    if unknown or not 0 <= profile.depth < 2**31:
        raise ValueError('no publisher can have its quality-of-service profile')
    return profile


def check_channels(path: Path, channels: Iterable[Channel]) -> None:
    """Raise UnreadableRecording where a file has what this planner does not record."""
    for channel in channels:
        if channel.type not in TYPES:
            raise UnreadableRecording(
                path, f'{channel.topic[:60]!r} is of the type {channel.type[:60]!r}'
            )
        try:
            validate_full_topic_name(channel.topic)
            qos_from_yaml(channel.qos)
        except InvalidTopicNameException as error:
            # Its own words repeat the name as it is, control characters and all.
            reason = f'{channel.topic[:60]!r} is not the name of a topic'
            raise UnreadableRecording(path, reason) from error
        except ValueError as error:
            raise UnreadableRecording(path, f'{channel.topic[:60]!r}: {error}') from error
