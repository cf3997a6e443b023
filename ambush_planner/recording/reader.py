"""Reads recordings back, and says clearly what is wrong with those that are broken."""

from __future__ import annotations

import re
from pathlib import Path
from types import MappingProxyType

from mcap import records
from rclpy.qos import QoSProfile

from .bag_metadata import FILE_NAME, MOST_METADATA_BYTES, listed_files
from .departure import RecordedDeparture
from .encoding import FORMAT, METADATA_RECORD
from .errors import UnreadableRecording, reading_from
from .mcap_content import Content, read_content
from .mcap_records import MOST_BYTES, DamagedRecord
from .messages import RecordedMessage
from .qos import qos_from_yaml
from .yaml_text import BadYaml

_CDR_HEADER_SIZE = 4
# What reading the channels' quality-of-service takes is bounded by these.
_MOST_CHANNELS = 256
_MOST_QOS_CHARACTERS = 4096
# What ambush_recover made of a folder: the same departures again.
_RECOVERED = '.recovered'


def read_departure(path: Path | str) -> RecordedDeparture:
    """Read one recorded departure, with a check of every checksum in the file.

    Raises:
        UnreadableRecording: The file is missing, damaged, or no departure of this format.
    """
    path = Path(path)
    try:
        content = read_content(read_bytes(path))
    except DamagedRecord as error:
        advice = 'run ambush_recover on it to save what is whole'
        raise UnreadableRecording(path, f'{error}; {advice}') from error
    try:
        metadata = _metadata(content)
        profiles = _profiles(content)
        messages = [_recorded(content, message, profiles) for message in content.messages]
    except (_NotADeparture, BadYaml, ValueError, ArithmeticError) as error:
        raise UnreadableRecording(path, f'{error}; it is not from this planner') from error
    messages.sort(key=lambda message: message.stamp_ns)
    attachments = {file.name: file.data for file in content.attachments}
    return RecordedDeparture(
        path, tuple(messages), MappingProxyType(metadata), MappingProxyType(attachments)
    )


def recordings_in(path: Path | str) -> list[Path]:
    """List the recordings that a file, a session folder or a recording.directory stands for.

    Returns:
        The file itself; the files of a folder in the order of its metadata.yaml, or else by
        their numbers; behind them those of all session folders in it, in the order of time.
        Folders ``*.recovered`` are left out, for they hold copies that ambush_recover made; to
        read one, name it.

    Raises:
        UnreadableRecording: There is nothing there, or no recording in the folder.
    """
    path = Path(path)
    with reading_from(path):
        if not path.is_dir():
            path.stat()
            return [path]
        # The names of session folders hold the times at which the sessions began.
        folders = sorted((p for p in path.iterdir() if is_session(p)), key=natural_order)
        found = [file for folder in (path, *folders) for file in _files_of(folder)]
    if not found:
        raise UnreadableRecording(path, 'there is no .mcap file in this folder; name another one')
    return found


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file of at most ``most`` bytes.

    Raises:
        UnreadableRecording: It cannot be read, is not a file (a FIFO would never end), or larger.
    """
    with reading_from(path):
        size = path.stat().st_size
        if not path.is_file():
            raise UnreadableRecording(path, 'it is not a file')
        if size > most:
            raise UnreadableRecording(path, f'its {size} bytes are more than a departure has')
        return path.read_bytes()


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort names with their numbers as numbers: ``run_2`` before ``run_10``."""
    parts = re.split(r'(\d+)', path.stem)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]


class _NotADeparture(Exception):
    """A whole MCAP file that is no departure of this format; the text says why."""


def is_session(path: Path) -> bool:
    """Whether it may be a session folder: one that no recovery has made."""
    return path.is_dir() and path.suffix != _RECOVERED


def _files_of(folder: Path) -> list[Path]:
    """The recordings right in a folder, also such as its metadata.yaml does not know."""
    present = sorted(folder.glob('*.mcap'), key=natural_order)
    try:
        listed = listed_files(read_bytes(folder / FILE_NAME, MOST_METADATA_BYTES))
    except (UnreadableRecording, BadYaml):
        return present
    place = {name: number for number, name in enumerate(listed)}
    return sorted(present, key=lambda path: place.get(path.name, len(place)))


def _metadata(content: Content) -> dict[str, str]:
    found = [each.metadata for each in content.metadata if each.name == METADATA_RECORD]
    if len(found) != 1:
        raise _NotADeparture(f'it has {len(found)} metadata records {METADATA_RECORD!r}, not one')
    if found[0].get('format') != FORMAT:
        raise _NotADeparture(
            f"its metadata states the format {found[0].get('format')!r}, this planner reads "
            f'{FORMAT!r}'
        )
    return found[0]


def _profiles(content: Content) -> dict[int, QoSProfile]:
    """The quality of service of each channel that has messages."""
    used = {message.channel_id for message in content.messages} & content.channels.keys()
    if len(used) > _MOST_CHANNELS:
        raise _NotADeparture(f'it has {len(used)} channels where at most {_MOST_CHANNELS} are read')
    texts = {
        key: content.channels[key].metadata.get('offered_qos_profiles', '') for key in sorted(used)
    }
    if any(len(text) > _MOST_QOS_CHARACTERS for text in texts.values()):
        raise _NotADeparture(
            f"a channel's quality of service has more than {_MOST_QOS_CHARACTERS} characters"
        )
    return {key: qos_from_yaml(text) for key, text in texts.items()}


def _recorded(
    content: Content, message: records.Message, profiles: dict[int, QoSProfile]
) -> RecordedMessage:
    channel = content.channels.get(message.channel_id)
    schema = content.schemas.get(channel.schema_id) if channel else None
    if channel is None or schema is None:
        raise _NotADeparture(f'a message is of channel {message.channel_id}, which is not defined')
    if channel.message_encoding != 'cdr' or len(message.data) < _CDR_HEADER_SIZE:
        raise _NotADeparture(f'a message on {channel.topic} is not serialised as CDR')
    qos = profiles[channel.id]
    return RecordedMessage(channel.topic, schema.name, message.data, qos, message.log_time)
