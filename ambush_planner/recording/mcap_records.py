"""The records of an MCAP file, read with a check of every length before it is believed.

The readers of the ``mcap`` library trust the sizes that a file states: one flipped bit makes them
ask for exabytes, read short or stop. Here the library parses the bodies of records only.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO

import lz4.frame
import zstandard
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord

MAGIC = b'\x89MCAP0\r\n'
HEADER_SIZE = 9
# More than any departure needs (a map of 10000 x 10000 cells takes 0.1 GB), and less than what
# would bring a machine down where a broken file claims it.
MOST_BYTES = 2**28
MOST_RECORDS = 200_000
_MOST_TABLE_BYTES = 2**24
# What is read in one step is lost when the step fails.
_STEP = 2**14
# What holds bytes at length.
BULKY = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.MESSAGE)

_TYPES = {
    Opcode.HEADER: mcap_records.Header,
    Opcode.FOOTER: mcap_records.Footer,
    Opcode.SCHEMA: mcap_records.Schema,
    Opcode.CHANNEL: mcap_records.Channel,
    Opcode.CHUNK: mcap_records.Chunk,
    Opcode.MESSAGE_INDEX: mcap_records.MessageIndex,
    Opcode.CHUNK_INDEX: mcap_records.ChunkIndex,
    Opcode.ATTACHMENT: mcap_records.Attachment,
    Opcode.ATTACHMENT_INDEX: mcap_records.AttachmentIndex,
    Opcode.STATISTICS: mcap_records.Statistics,
    Opcode.METADATA: mcap_records.Metadata,
    Opcode.METADATA_INDEX: mcap_records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: mcap_records.SummaryOffset,
    Opcode.DATA_END: mcap_records.DataEnd,
}
_MESSAGE_PREFIX = struct.Struct('<HIQQ')


class DamagedRecord(Exception):
    """The bytes at ``offset`` are no whole record; the text says why."""

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(f'byte {offset}: {reason}')
        self.offset = offset
        self.reason = reason


@dataclass(frozen=True)
class RawRecord:
    """One record as it lies in the file: where it begins, and its body."""

    opcode: int
    offset: int
    body: memoryview

    @property
    def end(self) -> int:
        """The offset of the byte after the record."""
        return self.offset + HEADER_SIZE + len(self.body)


def record_at(data: memoryview, offset: int) -> RawRecord:
    """Return the record that begins at ``offset``.

    Raises:
        DamagedRecord: It reaches beyond the end of ``data``.
    """
    body = offset + HEADER_SIZE
    if body > len(data):
        raise DamagedRecord(offset, 'the file ends in the header of a record')
    length = int.from_bytes(data[offset + 1 : body], 'little')
    if length > len(data) - body:
        raise DamagedRecord(
            offset, f'a record claims {length} bytes where {len(data) - body} are left'
        )
    return RawRecord(data[offset], offset, data[body : body + length])


def walk(data: memoryview, offset: int = 0) -> Iterator[RawRecord]:
    """Yield the records from ``offset`` to the end of ``data``.

    Raises:
        DamagedRecord: One is cut short.
    """
    while offset < len(data):
        record = record_at(data, offset)
        yield record
        offset = record.end


def parse(record: RawRecord) -> McapRecord | None:
    """Parse a record's body with the ``mcap`` library; None for a kind that it does not know.

    Raises:
        DamagedRecord: The body does not hold what its kind demands.
    """
    if record.opcode == Opcode.MESSAGE:
        return _parse_message(record)
    type_ = _TYPES.get(record.opcode)
    if type_ is None:
        return None
    if len(record.body) > _MOST_TABLE_BYTES and record.opcode not in BULKY:
        raise DamagedRecord(record.offset, f'a {type_.__name__} of {len(record.body)} bytes')
    stream = _ExactStream(BytesIO(record.body))
    try:
        parsed = type_.read(stream)
    except (EndOfFile, UnicodeDecodeError, OverflowError) as error:
        raise DamagedRecord(record.offset, f'a broken {type_.__name__} record') from error
    if type_ is mcap_records.Attachment and not _attachment_is_whole(record.body):
        raise DamagedRecord(record.offset, 'an attachment whose checksum does not hold')
    return parsed


def chunk_data(chunk: Chunk, offset: int) -> bytes:
    """Return the records in a chunk, decompressed and checked.

    Never more than the chunk states and never more than ``MOST_BYTES``, whatever it unpacks to.

    Raises:
        DamagedRecord: It does not unpack, or its size or checksum is not as stated.
    """
    if chunk.uncompressed_size > MOST_BYTES:
        raise DamagedRecord(offset, f'a chunk claims {chunk.uncompressed_size} bytes')
    data, error = unpack(chunk.compression, chunk.data, chunk.uncompressed_size)
    if error:
        raise DamagedRecord(offset, f'a chunk does not unpack: {error}')
    if len(data) != chunk.uncompressed_size:
        raise DamagedRecord(offset, 'a chunk unpacks to another size than it states')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedRecord(offset, 'a chunk whose checksum does not hold')
    return data


def unpack(compression: str, data: bytes, size: int) -> tuple[bytes, str]:
    """Decompress what is whole, at most ``size`` + 1 bytes, and say what stopped it, if anything.

    The stated size alone is not believed: a frame may unpack to any other.
    """
    if compression == '':
        return bytes(data[: size + 1]), ''
    if compression not in ('zstd', 'lz4'):
        return b'', f'the compression {compression[:20]!r} is none of zstd, lz4 and none'
    try:
        reader = (
            zstandard.ZstdDecompressor().stream_reader(BytesIO(data))
            if compression == 'zstd'
            else lz4.frame.LZ4FrameFile(BytesIO(data))
        )
    except (zstandard.ZstdError, RuntimeError, OSError) as error:
        return b'', str(error)
    return _read_at_most(reader, size + 1)


def _read_at_most(reader: BytesIO, size: int) -> tuple[bytes, str]:
    parts: list[bytes] = []
    left = size
    try:
        while left and (part := reader.read(min(left, _STEP))):
            parts.append(part)
            left -= len(part)
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError) as error:
        return b''.join(parts), str(error)
    return b''.join(parts), ''


def _parse_message(record: RawRecord) -> mcap_records.Message:
    if len(record.body) < _MESSAGE_PREFIX.size:
        raise DamagedRecord(record.offset, 'a broken Message record')
    channel, sequence, log_time, publish_time = _MESSAGE_PREFIX.unpack_from(record.body)
    data = bytes(record.body[_MESSAGE_PREFIX.size :])
    return mcap_records.Message(channel, log_time, data, publish_time, sequence)


def _attachment_is_whole(body: memoryview) -> bool:
    stated = int.from_bytes(body[-4:], 'little')
    return not stated or zlib.crc32(body[:-4]) == stated


class _ExactStream(ReadDataStream):
    """Raises where the library's own stream reads short."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile()
        return data
