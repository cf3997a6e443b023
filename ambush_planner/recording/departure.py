"""A recorded departure as it is read back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from .errors import UnreadableRecording
from .messages import RecordedMessage
from .types import TYPES
from .yaml_text import BadYaml, load_yaml

# A message from the network may have up to three bytes of padding at its end.
_MOST_PADDING = 3
_TYPE = re.compile(
    r'(?P<package>[a-z]\w*)/(?P<kind>msg|srv)/(?P<name>[A-Z][A-Za-z0-9]*)(?P<event>_Event)?'
)


@dataclass(frozen=True)
class RecordedDeparture:
    """What one file holds; every checksum in it held.

    Attributes:
        path: The file.
        messages: In the order of their times.
        metadata: The metadata record ``ambush_planner``.
        attachments: The contents of the attached files by their names.
    """

    path: Path
    messages: tuple[RecordedMessage, ...]
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]

    def yaml(self, key: str) -> Any:
        """Return the metadata's entry ``key``, read as YAML.

        Raises:
            UnreadableRecording: There is no such entry, or it is not YAML.
        """
        if key not in self.metadata:
            raise self._unreadable(f'the metadata has no entry {key!r}')
        try:
            return load_yaml(self.metadata[key])
        except BadYaml as error:
            raise self._unreadable(f"the metadata's entry {key!r} is {error}") from error

    def attachment(self, name: str) -> bytes:
        """Return the attached file ``name``.

        Raises:
            UnreadableRecording: There is none of this name.
        """
        if name not in self.attachments:
            raise self._unreadable(f'there is no attachment {name!r}')
        return self.attachments[name]

    def recorded(self, role: str) -> RecordedMessage:
        """Return the recorded message of a role that the metadata's ``inputs`` names.

        Args:
            role: ``map``, ``start``, ``goal`` or ``path``.

        Raises:
            UnreadableRecording: There is not exactly one message on the role's topic.
        """
        topics = self.yaml('inputs')
        if not isinstance(topics, dict) or role not in topics:
            raise self._unreadable(f"the metadata's entry 'inputs' names no topic for {role!r}")
        found = [message for message in self.messages if message.topic == topics[role]]
        if len(found) != 1:
            raise self._unreadable(f'it has {len(found)} messages in the role {role!r}, not one')
        return found[0]

    def message(self, role: str) -> Any:
        """Return the ROS message of a role, deserialised.

        Args:
            role: ``map``, ``start``, ``goal`` or ``path``.

        Raises:
            UnreadableRecording: There is not exactly one, its type is none that the planner
                records, or its data is not a message of that type.
        """
        return self.decode(self.recorded(role))

    def decode(self, recorded: RecordedMessage) -> Any:
        """Return a recorded message, deserialised.

        Raises:
            UnreadableRecording: Its type is none that the planner records, or its data is not a
                message of it.
        """
        try:
            return _deserialize(recorded.data, _message_class(recorded.type))
        except _NotDecoded as error:
            raise self._unreadable(f'the message on {recorded.topic[:60]!r}: {error}') from error

    def _unreadable(self, reason: str) -> UnreadableRecording:
        return UnreadableRecording(self.path, reason)


class _NotDecoded(Exception):
    """Why a message could not be deserialised."""


def _message_class(type_: str) -> type:
    if type_ not in TYPES:
        raise _NotDecoded(f'the planner records nothing of type {type_[:60]!r}')
    return TYPES[type_]


def _deserialize(data: bytes, class_: type) -> Any:
    try:
        message = deserialize_message(data, class_)
        size = len(serialize_message(message))
    except Exception as error:
        # The middleware chooses what it raises: RMWError, RuntimeError, UnicodeDecodeError, ...
        raise _NotDecoded(f'not a {class_.__name__} ({type(error).__name__})') from error
    if not 0 <= len(data) - size <= _MOST_PADDING:
        raise _NotDecoded(f'{len(data)} bytes where a {class_.__name__} of its fields has {size}')
    return message
