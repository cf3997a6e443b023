"""Whether the indexes of an MCAP file say of its data section what is in it.

Some readers walk a file from its beginning; others look up in its summary, or in the index behind
a chunk, where to read. A file is believed only if both find the same. MCAP lets writers leave out
whole groups of the summary's records, so a group may be missing, but none may have gaps.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from .mcap_records import HEADER_SIZE, DamagedRecord, RawRecord, parse

_SUMMARY_KINDS = (
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
)


class DataIndex:
    """What indexes have to say of the data section that is being read."""

    def __init__(self) -> None:
        self.chunks: dict[int, records.ChunkIndex] = {}
        self.attachments: dict[int, records.AttachmentIndex] = {}
        self.metadata: dict[int, records.MetadataIndex] = {}
        self.messages_outside = 0
        self.message_counts: Counter[int] = Counter()
        self.times: list[int] = []
        self._in_chunk: dict[int, list[tuple[int, int]]] = {}
        self._channels_in: dict[int, set[int]] = {}

    def add_message(self, message: records.Message) -> None:
        """Take note of a message outside of chunks."""
        self.messages_outside += 1
        self._count(message)

    def add_chunk(
        self, raw: RawRecord, chunk: records.Chunk, messages: Sequence[tuple[int, records.Message]]
    ) -> None:
        """Take note of a chunk and of the messages in it, with their offsets among its records.

        Raises:
            DamagedRecord: The times that it states are not those of its messages.
        """
        times = [message.log_time for _, message in messages]
        span = (chunk.message_start_time, chunk.message_end_time)
        if times and span != (min(times), max(times)):
            raise DamagedRecord(raw.offset, 'a chunk whose times are not those of its messages')
        self._in_chunk = defaultdict(list)
        for offset, message in messages:
            self._count(message)
            self._in_chunk[message.channel_id].append((message.log_time, offset))
        self._channels_in[raw.offset] = set(self._in_chunk)
        self.chunks[raw.offset] = records.ChunkIndex(
            chunk_start_offset=raw.offset,
            chunk_length=raw.end - raw.offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            message_index_offsets={},
            message_index_length=0,
        )

    def add_message_index(self, raw: RawRecord, index: records.MessageIndex) -> None:
        """Compare an index of messages with the chunk that it stands behind.

        Raises:
            DamagedRecord: It stands elsewhere, or does not list one channel's messages.
        """
        chunk = next(reversed(self.chunks.values()), None)
        if chunk is None or raw.offset != _index_end(chunk):
            raise DamagedRecord(raw.offset, 'a message index that stands behind no chunk')
        stated = sorted(index.records)
        known = chunk.message_index_offsets
        if index.channel_id in known or stated != sorted(self._in_chunk.get(index.channel_id, [])):
            raise DamagedRecord(raw.offset, 'a message index that is not that of its chunk')
        known[index.channel_id] = raw.offset
        chunk.message_index_length += raw.end - raw.offset

    def add_attachment(self, raw: RawRecord, file: records.Attachment) -> None:
        """Take note of an attachment."""
        self.attachments[raw.offset] = records.AttachmentIndex(
            offset=raw.offset,
            length=raw.end - raw.offset,
            log_time=file.log_time,
            create_time=file.create_time,
            data_size=len(file.data),
            name=file.name,
            media_type=file.media_type,
        )

    def add_metadata(self, raw: RawRecord, found: records.Metadata) -> None:
        """Take note of a metadata record."""
        self.metadata[raw.offset] = records.MetadataIndex(
            raw.offset, raw.end - raw.offset, found.name
        )

    def check_message_indexes(self) -> None:
        """Check at the end that all chunks' messages are indexed, or none.

        Raises:
            DamagedRecord: Some are, and others are not.
        """
        if not any(chunk.message_index_offsets for chunk in self.chunks.values()):
            return
        for offset, chunk in self.chunks.items():
            if not self._channels_in[offset] <= chunk.message_index_offsets.keys():
                raise DamagedRecord(offset, 'a chunk of which not all messages are indexed')

    def _count(self, message: records.Message) -> None:
        self.message_counts[message.channel_id] += 1
        self.times.append(message.log_time)


def check_plain(raw: RawRecord, record: records.McapRecord) -> None:
    """Check that a record has each key of a mapping once, and no bytes behind its fields.

    Raises:
        DamagedRecord: It has, and readers differ in which of them they take.
    """
    builder = RecordBuilder()
    record.write(builder)
    if builder.end()[HEADER_SIZE:] != raw.body:
        name = type(record).__name__
        raise DamagedRecord(raw.offset, f'a {name} with a key that comes twice, or more bytes')


def check_summary(
    raws: Sequence[RawRecord],
    footer: RawRecord,
    found: DataIndex,
    schemas: Mapping[int, records.Schema],
    channels: Mapping[int, records.Channel],
) -> None:
    """Compare a summary with the data section before it.

    Args:
        raws: The summary's records before the footer.
        footer: That behind them.
        found: What the data section holds.
        schemas, channels: As it defines them, by their ids.

    Raises:
        DamagedRecord: Who reads by the summary would find something else.
    """
    summary = _Summary(raws)
    summary.check_indexes(found)
    summary.check_definitions(found, schemas, channels)
    summary.check_statistics(found)
    summary.check_offsets(footer)


class _Summary:
    """The records of a summary, in their groups."""

    def __init__(self, raws: Sequence[RawRecord]) -> None:
        self._groups: dict[int, list[records.McapRecord]] = defaultdict(list)
        self._spans: dict[int, tuple[int, int]] = {}
        for raw in raws:
            if raw.opcode not in _SUMMARY_KINDS:
                raise DamagedRecord(raw.offset, f'a record of kind {raw.opcode} in the summary')
            record = parse(raw)
            check_plain(raw, record)
            start, end = self._spans.get(raw.opcode, (raw.offset, raw.offset))
            if end != raw.offset:
                raise DamagedRecord(raw.offset, 'a summary whose records are not in groups')
            self._spans[raw.opcode] = start, raw.end
            self._groups[raw.opcode].append(record)

    def check_indexes(self, found: DataIndex) -> None:
        """Each index lists all that there is, and it alone."""
        for opcode, expected, name in (
            (Opcode.CHUNK_INDEX, found.chunks, 'chunks'),
            (Opcode.ATTACHMENT_INDEX, found.attachments, 'attachments'),
            (Opcode.METADATA_INDEX, found.metadata, 'metadata records'),
        ):
            stated = self._groups[opcode]
            if stated and not _same_indexes(stated, expected):
                raise self._wrong(opcode, f'its index of {name} is not of those in the file')
        if self._groups[Opcode.CHUNK_INDEX] and found.messages_outside:
            raise self._wrong(Opcode.CHUNK_INDEX, 'there are messages outside of the chunks')

    def check_definitions(
        self,
        found: DataIndex,
        schemas: Mapping[int, records.Schema],
        channels: Mapping[int, records.Channel],
    ) -> None:
        """Definitions are those of the data section; what no message uses may be left out.

        Writers drop from the data section what was registered and never used.
        """
        used = [channels[key] for key in found.message_counts if key in channels]
        used_schemas = {channel.schema_id for channel in used} & schemas.keys()
        for opcode, known, needed in (
            (Opcode.CHANNEL, channels, set(found.message_counts)),
            (Opcode.SCHEMA, schemas, used_schemas),
        ):
            group = self._groups[opcode]
            stated = {record.id: record for record in group}
            same = all(known.get(key, each) == each for key, each in stated.items())
            if group and (len(stated) < len(group) or not same or not needed <= stated.keys()):
                raise self._wrong(opcode, 'its schemas and channels are not those of the messages')

    def check_statistics(self, found: DataIndex) -> None:
        """Counts and times are those of the messages."""
        group = self._groups[Opcode.STATISTICS]
        if not group:
            return
        stated, count = group[0], len(found.times)
        if stated.message_count != count:
            raise self._wrong(Opcode.STATISTICS, f'{count} messages are not all that it states')
        expected = (
            len(found.chunks), len(found.attachments), len(found.metadata),
            min(found.times, default=0), max(found.times, default=0),
        )
        counts = {key: each for key, each in stated.channel_message_counts.items() if each}
        right = (
            len(group) == 1
            and expected == (
                stated.chunk_count, stated.attachment_count, stated.metadata_count,
                stated.message_start_time, stated.message_end_time,
            )
            # Without any, they were not counted.
            and counts in ({}, dict(found.message_counts))
        )
        if not right:
            raise self._wrong(Opcode.STATISTICS, 'its counts or times are not those of the file')

    def check_offsets(self, footer: RawRecord) -> None:
        """The summary's own index leads to all of its groups."""
        stated = self._groups[Opcode.SUMMARY_OFFSET]
        start, _ = self._spans.get(Opcode.SUMMARY_OFFSET, (footer.offset, 0))
        if parse(footer).summary_offset_start not in (0, start):
            raise DamagedRecord(footer.offset, 'the offsets are not where the footer says')
        spans = {
            opcode: (start, end - start) for opcode, (start, end) in self._spans.items()
            if opcode != Opcode.SUMMARY_OFFSET
        }
        # Some writers have entries for empty groups.
        offsets = {
            each.group_opcode: (each.group_start, each.group_length)
            for each in stated if each.group_length
        }
        full = sum(each.group_length > 0 for each in stated)
        if stated and (offsets != spans or full != len(offsets)):
            raise self._wrong(Opcode.SUMMARY_OFFSET, 'its offsets are not those of its groups')

    def _wrong(self, opcode: int, reason: str) -> DamagedRecord:
        return DamagedRecord(self._spans[opcode][0], f'the summary is of another content: {reason}')


def _index_end(chunk: records.ChunkIndex) -> int:
    return chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length


def _same_indexes(
    stated: Sequence[records.McapRecord], expected: Mapping[int, records.McapRecord]
) -> bool:
    places = {
        each.chunk_start_offset if isinstance(each, records.ChunkIndex) else each.offset: each
        for each in stated
    }
    return len(stated) == len(expected) and places == expected
