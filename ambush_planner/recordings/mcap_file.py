"""Departures as bytes of MCAP files of the profile ``ros2``, by the ``mcap`` library.

A file is believed only if all its checksums hold and if the library's two readers, the one that
reads from the beginning and the one that goes by the index at the end, find the same in it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import IO

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

MAGIC = b'\x89MCAP0\r\n'
COMPRESSIONS = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}
METADATA_RECORD = 'ambush_planner'
# More than any departure needs (a map of 10000 x 10000 cells takes 0.1 GB); what a file unpacks
# to is bounded by it too.
MOST_BYTES = 2**30
# Without this a message of no bytes, a million times, would be a departure.
MOST_MESSAGES = 10_000
_CHUNK_SIZE = 2**20
_STEP = 2**22  # bytes that are unpacked at a time
HEADER_SIZE = 9
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
# What the library's readers raise at bytes that are not theirs.
BROKEN = (
    McapError, ValueError, ArithmeticError, LookupError, TypeError, EOFError, MemoryError,
    RuntimeError, OSError, struct.error, zlib.error, zstandard.ZstdError,
)


class BadFile(ValueError):
    """The bytes are not a whole MCAP file; the text says why."""


@dataclass
class Content:
    """What the records of a file hold; schemas and channels by their ids."""

    profile: str = ''
    library: str = ''
    compression: str = ''
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    messages: list[records.Message] = field(default_factory=list)
    metadata: list[records.Metadata] = field(default_factory=list)
    attachments: list[records.Attachment] = field(default_factory=list)

    def add(self, record: object) -> None:
        """Keep a record that carries content; others are ignored.

        Raises
        ------
        BadFile
            A schema or channel is defined a second time, differently.
        """
        if isinstance(record, (records.Schema, records.Channel)):
            known = self.schemas if isinstance(record, records.Schema) else self.channels
            if known.setdefault(record.id, record) != record:
                raise BadFile('a schema or channel is defined twice, differently')
        elif isinstance(record, records.Message):
            self.messages.append(record)
        elif isinstance(record, records.Metadata):
            self.metadata.append(record)
        elif isinstance(record, records.Attachment):
            self.attachments.append(record)
        elif isinstance(record, records.Header):
            self.profile, self.library = record.profile, record.library
        elif isinstance(record, records.Chunk):
            self.compression = record.compression


def encode(content: Content) -> bytes:
    """Return a whole file with this content, its messages in their order.

    Metadata and attachments come first: what is cut off at the end costs outputs that can be
    computed again before it costs what they were computed from. Each message's channel and its
    schema must be there; channels without messages are left out.
    """
    stream = BytesIO()
    # The checksum over the data section covers the metadata record; those of chunks do not.
    writer = Writer(
        stream, chunk_size=_CHUNK_SIZE, compression=COMPRESSIONS[content.compression or 'none'],
        enable_data_crcs=True,
    )
    writer.start(profile=content.profile)
    for each in content.metadata:
        writer.add_metadata(each.name, each.metadata)
    for file in content.attachments:
        writer.add_attachment(
            file.create_time, file.log_time, file.name, file.media_type, file.data
        )
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for message in content.messages:
        if (key := message.channel_id) not in channels:
            channel = content.channels[key]
            if (id_ := channel.schema_id) not in schemas:
                schema = content.schemas[id_]
                schemas[id_] = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[key] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[id_], channel.metadata
            )
        writer.add_message(
            channels[key], message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()
    return stream.getvalue()


def decode(data: bytes) -> Content:
    """Read a whole MCAP file: all records, all checksums that it has, by both readers.

    Raises
    ------
    BadFile
        It is not one, or not whole, or its index leads to something else.
    """
    content, fault = whole_part(data)
    if fault:
        raise BadFile(fault)
    return content


def whole_part(data: bytes) -> tuple[Content, str]:
    """Return the whole records up to the first fault, and what the fault is ('': none).

    A fault, too, is an index that leads to something else.
    """
    content, place = Content(), 0
    if not data.startswith(MAGIC):
        return content, 'it is not an MCAP file' if data else 'it is empty'
    stream = BytesIO(data)
    left, ended = MOST_BYTES, False
    try:
        reader = StreamReader(
            stream, emit_chunks=True, validate_crcs=True, record_size_limit=len(data)
        )
        for record in reader.records:
            place = stream.tell()
            ended = ended or isinstance(record, records.DataEnd)
            if isinstance(record, records.Attachment):
                _check_attachment(record, data, place)
            found = [record]
            if isinstance(record, records.Chunk):
                found.extend(records_of(record, left))
                left -= record.uncompressed_size
            if len(found) + len(content.messages) > MOST_MESSAGES:
                return content, f'it has more than {MOST_MESSAGES} messages'
            if not ended:
                for each in found:
                    content.add(each)
        if ended and stream.tell() == len(data):
            _check_summary(data)
    except BROKEN as error:
        where = f'after {place} of {len(data)} bytes'
        return content, f'it is broken or cut off {where} ({_why(error)})'
    if not ended or stream.tell() != len(data):
        return content, 'its end is not where it should be'
    return content, _index_fault(data, content)


def _index_fault(data: bytes, content: Content) -> str:
    """What is wrong with the index of a file with this content ('': nothing)."""
    try:
        reader = SeekingReader(BytesIO(data), record_size_limit=len(data))
        indexed = list(reader.iter_messages(log_time_order=False))
        summary = reader.get_summary()
        same = (
            summary is not None
            and [each[2] for each in indexed] == content.messages
            and all(channel == content.channels.get(channel.id) for _, channel, _ in indexed)
            and all(schema == content.schemas.get(schema.id) for schema, _, _ in indexed if schema)
            and (summary.schemas, summary.channels) == (content.schemas, content.channels)
            and list(reader.iter_attachments()) == content.attachments
            and list(reader.iter_metadata()) == content.metadata
            and _counts_hold(summary.statistics, content)
        )
    except BROKEN as error:
        return f'its index is broken ({type(error).__name__})'
    return '' if same else 'its index leads to another content than its records have'


def records_of(chunk: records.Chunk, most: int) -> list[records.McapRecord]:
    """The records in a chunk. No more is unpacked than is stated, whatever it unpacks to."""
    size = chunk.uncompressed_size
    if size > most:
        raise BadFile(f'it unpacks to more than {MOST_BYTES} bytes')
    if chunk.compression == 'zstd':
        data = _at_most(zstandard.ZstdDecompressor().stream_reader(BytesIO(chunk.data)), size)
    elif chunk.compression == 'lz4':
        data = _at_most(lz4.frame.LZ4FrameFile(BytesIO(chunk.data)), size)
    elif chunk.compression == '':
        data = chunk.data
    else:
        raise BadFile('its chunks are compressed by something else than zstd or lz4')
    if len(data) != size:
        raise BadFile('a chunk unpacks to another size than it states')
    _check_lengths(data)
    return breakup_chunk(replace(chunk, compression='', data=data), validate_crc=True)


def _at_most(reader: IO[bytes], size: int) -> bytes:
    """Read a little more than ``size`` bytes at most; memory is taken as they come."""
    parts: list[bytes] = []
    while sum(map(len, parts)) <= size and (part := reader.read(min(_STEP, size + 1))):
        parts.append(part)
    return b''.join(parts)


def _check_lengths(data: bytes) -> None:
    """Check that records fill a chunk, and that they are of the kinds that it may hold."""
    for opcode, body in walk(data, 0, len(data)):
        if opcode not in _IN_CHUNKS or (opcode == Opcode.MESSAGE and len(body) < 22):
            raise BadFile(f'a record of kind {opcode} in a chunk')


def walk(data: bytes, start: int, end: int) -> Iterator[tuple[int, memoryview]]:
    """Kind and body of the records from ``start`` to ``end``."""
    view = memoryview(data)
    while start < end:
        body = start + HEADER_SIZE
        length = int.from_bytes(view[start + 1 : body], 'little')
        if body + length > end:
            raise BadFile('a record is cut short')
        yield view[start], view[body : body + length]
        start = body + length


def _check_attachment(record: records.Attachment, data: bytes, end: int) -> None:
    """The stream reader does not check their checksums."""
    builder = RecordBuilder()
    record.write(builder)
    written = builder.end()
    if data[end - len(written) : end] != written:
        raise BadFile('an attachment whose checksum does not hold')


def _check_summary(data: bytes) -> None:
    """Check the summary's own checksum, which neither reader does."""
    tail = len(data) - len(MAGIC) - 20
    start = int.from_bytes(data[tail : tail + 8], 'little')
    stated = int.from_bytes(data[tail + 16 : tail + 20], 'little')
    if start > tail or (stated and zlib.crc32(data[start : tail + 16]) != stated):
        raise BadFile("the summary's checksum does not hold")


def _counts_hold(statistics: records.Statistics | None, content: Content) -> bool:
    times = [each.log_time for each in content.messages] or [0]
    return statistics is not None and (
        statistics.message_count, statistics.attachment_count, statistics.metadata_count,
        statistics.message_start_time, statistics.message_end_time,
    ) == (
        len(content.messages), len(content.attachments), len(content.metadata),
        min(times), max(times),
    )


def _why(error: BaseException) -> str:
    return str(error) if isinstance(error, BadFile) else type(error).__name__
