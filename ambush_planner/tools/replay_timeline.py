"""Recordings one after the other in one timeline, read one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name

from ..recording import RecordedMessage, UnreadableRecording, read_departure
from ..recording.bag_metadata import BagFile, RecordedTopic, describe_file
from ..recording.errors import reading_from
from ..recording.mcap_records import DamagedRecord
from ..recording.qos import qos_from_yaml, qos_to_yaml
from ..recording.types import TYPES
from ..recording.yaml_text import BadYaml

Unreadable = Callable[[UnreadableRecording], None]


@dataclass(frozen=True)
class Channel:
    """What is published under one name, with one type and one quality of service."""

    topic: str
    type: str
    qos_yaml: str

    @classmethod
    def of(cls, recorded: RecordedMessage) -> Channel:
        """Return the channel of a message."""
        return cls(recorded.topic, recorded.type, qos_to_yaml(recorded.qos))

    @property
    def qos(self) -> QoSProfile:
        """The quality of service."""
        return qos_from_yaml(self.qos_yaml)


@dataclass(frozen=True)
class Part:
    """One file: from ``begin_ns`` to ``end_ns`` on the timeline, recorded from ``stamp_ns``."""

    path: Path
    channels: frozenset[Channel]
    stamp_ns: int
    begin_ns: int
    end_ns: int

    def place(self, stamp_ns: int) -> int:
        """Return where on the timeline a message of this file is."""
        return min(max(self.begin_ns + stamp_ns - self.stamp_ns, self.begin_ns), self.end_ns)


def timeline(paths: Iterable[Path], unreadable: Unreadable) -> list[Part]:
    """Put files one after the other, from 0, as far apart as their clocks say.

    A clock that stood earlier in a later file (another machine's, a simulation's) makes no pause.
    """
    parts: list[Part] = []
    last_stamp, last_end = None, 0
    for path in paths:
        try:
            described, channels = _described(path)
        except UnreadableRecording as error:
            unreadable(error)
            continue
        first, last = described.start_ns, max(described.start_ns, described.end_ns)
        begin = last_end + (0 if last_stamp is None else max(0, first - last_stamp))
        parts.append(Part(path, channels, first, begin, begin + last - first))
        last_stamp, last_end = last, parts[-1].end_ns
    return parts


def messages(
    parts: Iterable[Part], start_ns: int, unreadable: Unreadable
) -> Iterator[tuple[Part, list[tuple[int, RecordedMessage]]]]:
    """Yield each part that reaches beyond ``start_ns`` with its messages and their places."""
    for part in parts:
        if part.end_ns < start_ns:
            continue
        try:
            recorded = read_departure(part.path)
            if not part.channels.issuperset(map(Channel.of, recorded.messages)):
                raise UnreadableRecording(part.path, "its summary does not list all topics")
        except UnreadableRecording as error:
            unreadable(error)
            continue
        placed = [(part.place(message.stamp_ns), message) for message in recorded.messages]
        yield part, [(place, message) for place, message in placed if place >= start_ns]


def _described(path: Path) -> tuple[BagFile, frozenset[Channel]]:
    """Read what stands at the end of a file: its times, and what it has messages of.

    Raises
    ------
    UnreadableRecording
        There is no such file, it is not whole, or it is not from this planner.
    """
    with reading_from(path):
        if not path.is_file() or not path.stat().st_size:
            raise UnreadableRecording(path, "it is not a file, or empty")
        with path.open("rb") as file:
            # Only its end is read. The map is closed when nothing refers to it.
            data = mmap(file.fileno(), 0, access=ACCESS_READ)
    try:
        described = describe_file(path.name, data)
        if not sum(described.message_counts.values()):
            raise ValueError("it has no messages")
        return described, frozenset(map(_channel, described.message_counts))
    except DamagedRecord as error:
        reason = f"{error}; run ambush_recover on it to save what is whole"
    except (BadYaml, ValueError) as error:
        reason = f"{error}; it is not from this planner"
    # Not from the error, which refers to the map as long as it is kept itself.
    del data
    raise UnreadableRecording(path, reason)


def _channel(recorded: RecordedTopic) -> Channel:
    if recorded.type not in TYPES:
        raise ValueError(f"{recorded.name[:60]!r} is of the type {recorded.type[:60]!r}")
    try:
        validate_full_topic_name(recorded.name)
    except InvalidTopicNameException as error:
        # Its own words repeat the name as it is, control characters and all.
        raise ValueError(f"{recorded.name[:60]!r} is no name of a topic") from error
    # Read and written anew: the same profile has the same text then.
    return Channel(recorded.name, recorded.type, qos_to_yaml(qos_from_yaml(recorded.qos)))
