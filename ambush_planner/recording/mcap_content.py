"""The content of one whole MCAP file.

It is believed only when every checksum in it holds, and when who reads by its summary finds what
who reads from the beginning finds.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection
from dataclasses import dataclass, field
from mmap import mmap

from mcap import records
from mcap.opcode import Opcode

from .mcap_index import DataIndex, check_plain, check_summary
from .mcap_records import (
    BULKY,
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

_CHUNK_KINDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_DATA_KINDS = _CHUNK_KINDS | {
    Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA,
}
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
    raws = _framed(view)
    ends = [place for place, raw in enumerate(raws) if raw.opcode == Opcode.DATA_END]
    if not ends:
        raise DamagedRecord(len(view), 'the end of the data section is missing')
    content = _StrictContent()
    for raw in raws[: ends[0]]:
        content.take(raw)
    content.index.check_message_indexes()
    _check_data_end(view, raws[ends[0]])
    if raws[0].opcode != Opcode.HEADER:
        raise DamagedRecord(len(MAGIC), 'the header is missing')
    start, footer = raws[ends[0]].end, raws[-1]
    if footer.opcode != Opcode.FOOTER:
        raise DamagedRecord(footer.end, 'the footer is missing')
    _check_footer(view, start, footer)
    check_summary(
        raws[ends[0] + 1 : -1], footer, content.index, content.schemas, content.channels
    )
    return content


def _framed(view: memoryview) -> list[RawRecord]:
    """The records between the magic at both ends."""
    raws = []
    for raw in walk(view[: -len(MAGIC)], len(MAGIC)):
        raws.append(raw)
        if len(raws) > MOST_RECORDS:
            raise DamagedRecord(raw.offset, f'more than {MOST_RECORDS} records')
    return raws


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
    if view[: len(MAGIC)] != MAGIC:
        raise DamagedRecord(0, 'not an MCAP file')
    footer = parse(record_at(view, max(0, len(view) - _TAIL_SIZE)))
    if not isinstance(footer, records.Footer) or not footer.summary_start:
        raise DamagedRecord(max(0, len(view) - _TAIL_SIZE), 'there is no summary')
    content = Content()
    statistics = _walk_summary(view, footer.summary_start, content)
    if statistics is None:
        raise DamagedRecord(footer.summary_start, 'the summary has no statistics')
    return Summary(statistics, content.schemas, content.channels)


class _StrictContent(Content):
    """Content that unpacks chunks, within bounds, and takes nothing that it does not know.

    Attributes:
        index: What the file's indexes have to say.
    """

    def __init__(self) -> None:
        super().__init__()
        self.index = DataIndex()
        self._bytes_left = MOST_BYTES
        self._records_left = MOST_RECORDS

    def take(self, raw: RawRecord) -> None:
        """Keep what a record of the data section holds."""
        record = self._parsed(raw, _DATA_KINDS)
        if isinstance(record, records.Chunk):
            self._take_chunk(raw, record)
        elif isinstance(record, records.MessageIndex):
            self.index.add_message_index(raw, record)
        else:
            self._keep(raw, record)
        if isinstance(record, records.Message):
            self.index.add_message(record)
        elif isinstance(record, records.Attachment):
            self.index.add_attachment(raw, record)
        elif isinstance(record, records.Metadata):
            self.index.add_metadata(raw, record)

    def _take_chunk(self, raw: RawRecord, chunk: records.Chunk) -> None:
        self._bytes_left -= chunk.uncompressed_size
        if self._bytes_left < 0:
            raise DamagedRecord(raw.offset, f'it unpacks to more than {MOST_BYTES} bytes')
        messages = []
        try:
            for inner in walk(memoryview(chunk_data(chunk, raw.offset))):
                record = self._parsed(inner, _CHUNK_KINDS)
                self._keep(inner, record)
                if isinstance(record, records.Message):
                    messages.append((inner.offset, record))
        except DamagedRecord as error:
            raise DamagedRecord(raw.offset, f'in a chunk, {error.reason}') from error
        self.index.add_chunk(raw, chunk, messages)

    def _parsed(self, raw: RawRecord, kinds: Collection[int]) -> records.McapRecord:
        """Parse a record of one of these kinds: others could hold what only some readers find."""
        self._records_left -= 1
        if self._records_left < 0:
            raise DamagedRecord(raw.offset, f'more than {MOST_RECORDS} records')
        misplaced = raw.opcode == Opcode.HEADER and raw.offset != len(MAGIC)
        if raw.opcode not in kinds or misplaced:
            raise DamagedRecord(raw.offset, f'a record of kind {raw.opcode}')
        record = parse(raw)
        if raw.opcode not in BULKY:
            check_plain(raw, record)
        return record

    def _keep(self, raw: RawRecord, record: records.McapRecord) -> None:
        if isinstance(record, (records.Schema, records.Channel)):
            known = self.schemas if isinstance(record, records.Schema) else self.channels
            if known.get(record.id, record) != record:
                raise DamagedRecord(raw.offset, 'a schema or channel is defined twice, differently')
        self.add(record)


def _check_data_end(view: memoryview, raw: RawRecord) -> None:
    stated = parse(raw).data_section_crc
    if stated and stated != zlib.crc32(view[: raw.offset]):
        raise DamagedRecord(raw.offset, "the data section's checksum does not hold")


def _walk_summary(view: memoryview, start: int, content: Content) -> records.Statistics | None:
    """Keep the summary's schemas and channels, and return its statistics, if any."""
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
    check_plain(raw, footer)
    if raw.end != len(view) - len(MAGIC):
        raise DamagedRecord(raw.end, 'bytes after the footer')
    if footer.summary_start not in (0, start):
        raise DamagedRecord(raw.offset, 'the summary is not where the footer says')
    checked = view[start : raw.offset + HEADER_SIZE + len(raw.body) - _FOOTER_CRC_SIZE]
    if footer.summary_crc and footer.summary_crc != zlib.crc32(checked):
        raise DamagedRecord(raw.offset, "the summary's checksum does not hold")
