"""Reads recordings back, and says clearly what is wrong with those that are broken."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from .map_changes import MAP_CHANGES_FILE
from .mcap_file import METADATA_RECORD, MOST_BYTES, MOST_MESSAGES, BadFile, Content, decode
from .messages import RecordedMessage
from .metadata import BadMetadata, Metadata, broken_hashes, parse_metadata
from .qos_text import fields_from_yaml
from .recording_errors import UnreadableRecording, reading_from
from .strategy_file import STRATEGY_FILE, arrays_of

_CDR_HEADER_SIZE = 4
# Reading their quality of service takes time.
_MOST_CHANNELS = 256
# What ambush_recover made of a folder: the same departures again.
_RECOVERED = '.recovered'


@dataclass(frozen=True, eq=False)
class RecordedDeparture:
    """What one file holds; every checksum and stated hash in it held.

    Attributes
    ----------
    path
        The file.
    sha256
        Of the whole file.
    messages
        In the order of their times.
    metadata
        What the metadata record says.
    attachments
        The contents of the attached files by their names.
    content, data
        The records and bytes that these were read from.
    """

    path: Path
    sha256: str
    messages: tuple[RecordedMessage, ...]
    metadata: Metadata
    attachments: Mapping[str, bytes]
    content: Content
    data: bytes

    @property
    def strategy(self) -> bytes:
        """The strategy's file."""
        return self.attachments[STRATEGY_FILE]

    @property
    def map_changes(self) -> bytes:
        """How the ground had changed since it was planned on; empty where it had not."""
        return self.attachments.get(MAP_CHANGES_FILE, b'')

    @property
    def stamp_ns(self) -> int:
        """When the path was published."""
        return self.recorded('path').stamp_ns

    def recorded(self, role: str) -> RecordedMessage:
        """Return the recorded message in one of the roles of ``Metadata.inputs``."""
        topic = self.metadata.inputs[role]
        return next(each for each in self.messages if each.topic == topic)


def read_departure(path: Path | str) -> RecordedDeparture:
    """Read one recorded departure, with a check of all checksums and hashes in the file.

    Raises
    ------
    UnreadableRecording
        The file is missing, damaged, or no departure of this format.
    """
    path = Path(path)
    data = read_bytes(path)
    try:
        content = decode(data)
    except BadFile as error:
        advice = 'run ambush_recover on it to save what is whole'
        raise UnreadableRecording(path, f'{error}; {advice}') from error
    try:
        return _departure(path, data, content)
    except (ValueError, ArithmeticError) as error:
        raise UnreadableRecording(path, f'{error}; it is not from this planner') from error


def recordings_in(path: Path | str) -> list[Path]:
    """List the recordings that a file, a session folder or a recording.directory stands for.

    Returns
    -------
    list of Path
        The file itself; the files of a folder by their numbers; behind them those of all session
        folders in it, in the order of time. Folders ``*.recovered`` are left out, for they hold
        copies that ambush_recover made; to read one, name it.

    Raises
    ------
    UnreadableRecording
        There is nothing there, or no recording in the folder.
    """
    path = Path(path)
    with reading_from(path):
        if not path.is_dir():
            path.stat()
            return [path]
        # The names of session folders hold the times at which the sessions began.
        folders = sorted((p for p in path.iterdir() if is_session(p)), key=natural_order)
        found = [
            file for folder in (path, *folders)
            for file in sorted(folder.glob('*.mcap'), key=natural_order)
        ]
    if not found:
        raise UnreadableRecording(path, 'there is no .mcap file in this folder; name another one')
    return found


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file.

    Raises
    ------
    UnreadableRecording
        It cannot be read, is not a file (a FIFO would never end), or larger than any departure.
    """
    with reading_from(path):
        size = path.stat().st_size
        if not path.is_file():
            raise UnreadableRecording(path, 'it is not a file')
        if size > MOST_BYTES:
            raise UnreadableRecording(path, f'its {size} bytes are more than a departure has')
        return path.read_bytes()


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort names with their numbers as numbers: ``run_2`` before ``run_10``."""
    parts = re.split(r'(\d+)', path.stem)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]


def is_session(path: Path) -> bool:
    """Whether it may be a session folder: one that no recovery has made."""
    return path.is_dir() and path.suffix != _RECOVERED


def _departure(path: Path, data: bytes, content: Content) -> RecordedDeparture:
    metadata = parse_metadata(_entries(content))
    channels = _channels(content)
    messages = sorted(
        (
            RecordedMessage(*channels[each.channel_id][:2], each.data,
                            channels[each.channel_id][2], each.log_time)
            for each in content.messages
        ),
        key=lambda each: each.stamp_ns,
    )
    if short := [each for each in messages if len(each.data) < _CDR_HEADER_SIZE]:
        raise ValueError(f'a message on {short[0].topic[:60]!r} is not serialised as CDR')
    attachments = {each.name: each.data for each in content.attachments}
    contents = _contents(messages, metadata, attachments)
    if broken := broken_hashes(metadata, contents):
        raise ValueError(f'the stated sha256 of {broken[0]} does not hold')
    return RecordedDeparture(
        path, hashlib.sha256(data).hexdigest(), tuple(messages), metadata,
        MappingProxyType(attachments), content, data,
    )


def _entries(content: Content) -> dict[str, str]:
    found = [each.metadata for each in content.metadata if each.name == METADATA_RECORD]
    if len(found) != 1:
        raise BadMetadata(f'it has {len(found)} metadata records {METADATA_RECORD!r}, not one')
    return found[0]


def _contents(
    messages: list[RecordedMessage], metadata: Metadata, attachments: Mapping[str, bytes]
) -> dict[str, bytes]:
    """What the stated hashes are of, messages and strategy; there must be one of each."""
    contents = {}
    for role in metadata.inputs:
        found = [each.data for each in messages if each.topic == metadata.inputs[role]]
        if len(found) != 1:
            raise BadMetadata(f'it has {len(found)} messages in the role {role!r}, not one')
        contents[role] = found[0]
    if unknown := sorted(set(attachments) - {STRATEGY_FILE, MAP_CHANGES_FILE}):
        raise BadMetadata(f'an attachment {unknown[0][:60]!r} is not known')
    if STRATEGY_FILE not in attachments:
        raise BadMetadata(f'there is no attachment {STRATEGY_FILE!r}')
    files = attachments[STRATEGY_FILE], attachments.get(MAP_CHANGES_FILE, b'')
    return {**contents, 'strategy': files[0], 'map_changes': files[1]}


def _channels(content: Content) -> dict[int, tuple[str, str, str]]:
    """Topic, type and quality of service of each channel that has messages."""
    used = {each.channel_id for each in content.messages}
    if len(used) > _MOST_CHANNELS:
        raise BadMetadata(f'it has {len(used)} channels where at most {_MOST_CHANNELS} are read')
    found = {}
    for number in used:
        channel = content.channels.get(number)
        schema = content.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            raise BadMetadata('a message is of a channel that is not defined')
        if channel.message_encoding != 'cdr':
            raise BadMetadata(f'messages on {channel.topic[:60]!r} are not serialised as CDR')
        qos = channel.metadata.get('offered_qos_profiles', '')
        fields_from_yaml(qos)
        found[number] = channel.topic, schema.name, qos
    return found


def check_readable(path: Path, content: Content, size: int, known: bytes = b'') -> bytes:
    """Check that the readers would take what is about to be written, a file of ``size`` bytes.

    ``known`` is a strategy's file that they would take; the content's is returned.

    Raises
    ------
    UnreadableRecording
        They would refuse it.
    """
    try:
        unpacked = sum(len(each.data) for each in content.messages)
        if max(size, unpacked) > MOST_BYTES // 2 or len(content.messages) > MOST_MESSAGES // 2:
            raise ValueError(f'{unpacked} bytes are more than a departure has')
        strategy = _departure(path, b'', content).strategy
        if strategy is not known:
            arrays_of(strategy)
    except (ValueError, ArithmeticError) as error:
        raise UnreadableRecording(path, str(error)) from error
    return strategy
