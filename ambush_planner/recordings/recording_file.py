# SPDX-License-Identifier: Apache-2.0
"""Read the MCAP file of a departure, or of a plan, and decode its messages."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile, is_zipfile

from ..parameters.table import PARAMETERS
from .encoding import FORMAT, METADATA_RECORD
from .messages import RecordedMessage
from .metadata import Metadata, typed
from .recording_errors import UnreadableRecording, bytes_in, check_size
from .schemas import definitions

if TYPE_CHECKING:
    from mcap.records import McapRecord

# Size of the CRC of the summary, and of what ends a file [bytes].
_END = 4 + 8
# The attachment of few routes (ambush plan --routes), from which earlier versions drew.
_FEW = 'few.npz'
# The format before, in which a trip was one network, and a route one list of its nodes.
_BEFORE = '10'
# Parameters that it did not have; the defaults are what it did.
_ADDED = ('network.all_lines_are_roads', 'network.road_column', 'network.two_way', 'trip.max_idle')


@dataclass(frozen=True, eq=False)
class RecordingFile:
    """The contents of one file, its messages in the order of time.

    ``entries`` are those of the metadata record, with their JSON read.
    """

    path: Path
    messages: tuple[RecordedMessage, ...]
    entries: Mapping[str, Any]
    attachments: Mapping[str, bytes]

    @cached_property
    def metadata(self) -> Metadata:
        """The entries with their types; raises InvalidEntry."""
        found: Metadata = typed(self.entries, Metadata, 'metadata')
        return found

    def in_role(self, role: str) -> RecordedMessage:
        """Return the message in a role of the entry ``topics``, like ``map`` or ``path``."""
        topic = self.metadata.topics[role]
        return next(each for each in self.messages if each.topic == topic)


def read_recording(path: Path | str, with_messages: bool = True) -> RecordingFile:
    """Read a file and check its CRCs, by default also its messages; raises UnreadableRecording."""
    from mcap.records import Attachment, Chunk, DataEnd, Message, Metadata
    from mcap.stream_reader import StreamReader

    path = Path(path)
    data = bytes_in(path)
    try:
        stream = BytesIO(data)
        packed = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
        footer: Any = packed[-1]
        # Other readers begin with the summary, whose CRC the library does not check.
        if stream.read(1) or footer.summary_crc != zlib.crc32(data[footer.summary_start:-_END]):
            raise ValueError('the end differs')
        # The summary repeats schemas and channels.
        packed = list(takewhile(lambda each: not isinstance(each, DataEnd), packed))
        if not with_messages:
            packed = [each for each in packed if not isinstance(each, Chunk)]
        check_size(path, sum(map(_unpacked_size, packed)))
        found: list[McapRecord] = [each for record in packed for each in _unpacked(record)]
    except UnreadableRecording:
        raise
    except Exception as error:  # mcap, struct, zstd and lz4 raise a dozen kinds of errors
        raise UnreadableRecording(
            path,
            'it is damaged or not an MCAP file: use your copy of it, or try `mcap recover` to '
            'salvage intact messages',
        ) from error
    texts: Mapping[str, str] | None = next(
        (each.metadata for each in found
         if isinstance(each, Metadata) and each.name == METADATA_RECORD), None,
    )
    if texts is None:
        count = sum(isinstance(each, Message) for each in found)
        raise UnreadableRecording(
            path, f'it has no record {METADATA_RECORD!r}: it is not a recording of this planner, '
            f'or a tool such as `mcap recover` has removed the record. Its {count} messages can '
            'be seen with ros2 bag, RViz or Foxglove, but not verified'
        )
    if texts.get('format') not in (FORMAT, _BEFORE):
        raise UnreadableRecording(
            path, f'its format is {texts.get("format")!r}, this version reads {FORMAT!r}: use the '
            'version of ambush_planner that recorded it'
        )
    if any(isinstance(each, Attachment) and each.name == _FEW for each in found):
        raise UnreadableRecording(
            path, 'it is of a plan of few routes, which are now drawn by hand: use the version of '
            'ambush_planner that recorded it')
    try:
        entries = {name: json.loads(text) for name, text in texts.items()}
        if texts['format'] == _BEFORE:
            entries = _by_leg(path, entries)
        return _contents(path, found, entries)
    except (ValueError, LookupError, RecursionError) as error:
        raise UnreadableRecording(
            path, f'its records are inconsistent ({type(error).__name__})'
        ) from error


def _by_leg(path: Path, entries: dict[str, Any]) -> dict[str, Any]:
    """The entries of a recording of one leg in the format before, as they are now."""
    if entries['trip']['stops']:
        raise UnreadableRecording(
            path, 'it was made by an earlier version, whose trips with stops were drawn as a whole '
            'instead of leg by leg; plan again'
        )
    added = {name: PARAMETERS[name].default for name in _ADDED}
    entries['parameters'] = {**added, **entries['parameters']}
    if 'route' in entries:
        entries['route'] = [entries['route']]
    if entries.get('diversion'):
        entries['diversion']['left'] = [entries['diversion']['left']]
    return entries


def _unpacked_size(record: McapRecord) -> int:
    """Return what a record takes, with the arrays that are attached to it [bytes]."""
    from mcap.records import Attachment, Chunk

    if isinstance(record, Attachment) and is_zipfile(BytesIO(record.data)):
        return sum(each.file_size for each in ZipFile(BytesIO(record.data)).infolist())
    if isinstance(record, Chunk) and record.compression == 'zstd':
        import zstandard

        # The library takes the frame at its word.
        return max(record.uncompressed_size, zstandard.frame_content_size(record.data))
    return record.uncompressed_size if isinstance(record, Chunk) else 0


def _unpacked(record: McapRecord) -> Sequence[McapRecord]:
    """Return the records of a chunk, or else the record."""
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    if not isinstance(record, Chunk):
        return [record]
    if record.compression == 'lz4':  # the library does not stop at the size that is stated
        from lz4.frame import LZ4FrameDecompressor

        data = LZ4FrameDecompressor().decompress(record.data, record.uncompressed_size)
        record = replace(record, compression='', data=data)
    return breakup_chunk(record, validate_crc=True)


@lru_cache
def _decoder(kind: str) -> Any:
    from mcap.records import Schema
    from mcap.well_known import MessageEncoding
    from mcap_ros2.decoder import DecoderFactory

    # The decoder reads int8 one by one, in seconds for a large map, and uint8 as one slice.
    text = re.sub(r'\bint8\[', 'uint8[', definitions()[kind].text)
    schema = Schema(1, text.encode(), 'ros2msg', kind)
    return DecoderFactory().decoder_for(MessageEncoding.CDR, schema)


def decode(message: RecordedMessage) -> Any:
    """Decode a message of a type that recordings have."""
    return _decoder(message.type)(message.data)


def _contents(path: Path, found: Sequence[McapRecord],
              entries: Mapping[str, Any]) -> RecordingFile:
    from mcap import records

    schemas = {each.id: each for each in found if isinstance(each, records.Schema)}
    channels = {each.id: each for each in found if isinstance(each, records.Channel)}
    messages = []
    for each in found:
        if isinstance(each, records.Message):
            channel = channels[each.channel_id]
            messages.append(RecordedMessage(
                channel.topic, schemas[channel.schema_id].name, each.data,
                channel.metadata['offered_qos_profiles'], each.log_time))
    return RecordingFile(
        path, tuple(sorted(messages, key=lambda each: each.stamp_ns)), entries,
        {each.name: each.data for each in found if isinstance(each, records.Attachment)},
    )
