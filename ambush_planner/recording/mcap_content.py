"""The content of one whole MCAP file, believed only when every checksum in it holds."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from mmap import mmap

from mcap import records
from mcap.opcode import Opcode

from .mcap_records import (
    HEADER_SIZE,
    MAGIC,
    MOST_BYTES,
    MOST_RECORDS,
    DamagedRecord,
    RawRecord,
    chunk_data,
    parse,
    record_at,
    walk,
)

_FOOTER_CRC_SIZE = 4
# A footer record and the magic after it.
_TAIL_SIZE = HEADER_SIZE + 20 + len(MAGIC)


@dataclass
class Content:
    """What the records of a file hold; schemas and channels by their ids."""

    profile: str = ''
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    messages: list[records.Message] = field(default_factory=list)
    metadata: list[records.Metadata] = field(default_factory=list)
    attachments: list[records.Attachment] = field(default_factory=list)

    def add(self, record: records.McapRecord) -> None:
        """Keep a record that carries content; others are ignored."""
        if isinstance(record, records.Message):
            self.messages.append(record)
        elif isinstance(record, records.Schema):
            self.schemas[record.id] = record
        elif isinstance(record, records.Channel):
            self.channels[record.id] = record
        elif isinstance(record, records.Metadata):
            self.metadata.append(record)
        elif isinstance(record, records.Attachment):
            self.attachments.append(record)
        elif isinstance(record, records.Header):
            self.profile = record.profile


def read_content(data: bytes) -> Content:
    """Read a whole MCAP file: magic at both ends, all records, all checksums that it has.

    Raises:
        DamagedRecord: It is not one, or not whole.
    """
    if not data:
        raise DamagedRecord(0, 'the file is empty')
    if not data.startswith(MAGIC):
        raise DamagedRecord(0, 'not an MCAP file')
    if not data.endswith(MAGIC) or len(data) < 2 * len(MAGIC):
        raise DamagedRecord(len(data), 'the end of the file is missing')
    view = memoryview(data)
    content = _StrictContent()
    summary_start = _read_data_section(view, content)
    _check_summary(view, summary_start, content)
    return content


@dataclass
class Summary:
    """What a file's summary section says about it."""

    statistics: records.Statistics
    schemas: dict[int, records.Schema]
    channels: dict[int, records.Channel]


def read_summary(data: bytes | mmap) -> Summary:
    """Read the summary section of a file and nothing else of it.

    Raises:
        DamagedRecord: There is none, or it is not whole.
    """
    with memoryview(data) as view:
        return _read_summary(view)


def _read_summary(view: memoryview) -> Summary:
    footer = parse(record_at(view, max(0, len(view) - _TAIL_SIZE)))
    if not isinstance(footer, records.Footer) or not footer.summary_start:
        raise DamagedRecord(max(0, len(view) - _TAIL_SIZE), 'there is no summary')
    content = Content()
    statistics = _walk_summary(view, footer.summary_start, content)
    if statistics is None:
        raise DamagedRecord(footer.summary_start, 'the summary has no statistics')
    return Summary(statistics, content.schemas, content.channels)


class _StrictContent(Content):
    """Content that unpacks chunks, within bounds."""

    def __init__(self) -> None:
        super().__init__()
        self._bytes_left = MOST_BYTES
        self._records_left = MOST_RECORDS

    def take(self, raw: RawRecord) -> None:
        """Keep what a record of the data section holds."""
        self._records_left -= 1
        if self._records_left < 0:
            raise DamagedRecord(raw.offset, f'more than {MOST_RECORDS} records')
        if raw.opcode == Opcode.CHUNK:
            self._take_chunk(raw)
        elif raw.opcode != Opcode.MESSAGE_INDEX:
            self.add(parse(raw))

    def _take_chunk(self, raw: RawRecord) -> None:
        chunk = parse(raw)
        self._bytes_left -= chunk.uncompressed_size
        if self._bytes_left < 0:
            raise DamagedRecord(raw.offset, f'it unpacks to more than {MOST_BYTES} bytes')
        try:
            for inner in walk(memoryview(chunk_data(chunk, raw.offset))):
                if inner.opcode not in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                    raise DamagedRecord(inner.offset, f'a record of kind {inner.opcode}')
                self.take(inner)
        except DamagedRecord as error:
            raise DamagedRecord(raw.offset, f'in a chunk, {error.reason}') from error


def _read_data_section(view: memoryview, content: _StrictContent) -> int:
    """Read up to the end of the data section; return where the summary begins."""
    body = view[: -len(MAGIC)]
    for raw in walk(body, len(MAGIC)):
        if raw.opcode == Opcode.DATA_END:
            stated = parse(raw).data_section_crc
            if stated and stated != zlib.crc32(view[: raw.offset]):
                raise DamagedRecord(raw.offset, "the data section's checksum does not hold")
            return raw.end
        content.take(raw)
    raise DamagedRecord(len(view), 'the end of the data section is missing')


def _check_summary(view: memoryview, start: int, content: Content) -> None:
    statistics = _walk_summary(view, start, Content())
    if statistics and statistics.message_count != len(content.messages):
        raise DamagedRecord(start, f'{len(content.messages)} messages are not all that it states')


def _walk_summary(view: memoryview, start: int, content: Content) -> records.Statistics | None:
    """Check the summary, keep its schemas and channels, and return its statistics, if any."""
    end = len(view) - len(MAGIC)
    statistics = None
    for raw in walk(view[:end], start):
        if raw.opcode == Opcode.FOOTER:
            _check_footer(view, start, raw)
            return statistics
        if raw.opcode == Opcode.STATISTICS:
            statistics = parse(raw)
        if raw.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            content.add(parse(raw))
    raise DamagedRecord(end, 'the footer is missing')


def _check_footer(view: memoryview, start: int, raw: RawRecord) -> None:
    footer = parse(raw)
    if raw.end != len(view) - len(MAGIC):
        raise DamagedRecord(raw.end, 'bytes after the footer')
    if footer.summary_start not in (0, start):
        raise DamagedRecord(raw.offset, 'the summary is not where the footer says')
    checked = view[start : raw.offset + HEADER_SIZE + len(raw.body) - _FOOTER_CRC_SIZE]
    if footer.summary_crc and footer.summary_crc != zlib.crc32(checked):
        raise DamagedRecord(raw.offset, "the summary's checksum does not hold")
