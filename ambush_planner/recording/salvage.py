"""What is whole in a broken MCAP file, and what is lost.

A file that was cut off, or in which bits have changed, is walked record by record. Of a chunk that
is damaged, what unpacks is kept. Messages need their channel and schema, which stand in a chunk and
again in the file's summary: either will do.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from mcap import records
from mcap.opcode import Opcode

from .mcap_content import Content, read_content, read_summary
from .mcap_records import (
    HEADER_SIZE,
    MAGIC,
    MOST_BYTES,
    MOST_RECORDS,
    DamagedRecord,
    RawRecord,
    chunk_data,
    parse,
    unpack,
)
from .resync import Gap, Resync

_CHUNK_PREFIX = 32
_COMPRESSIONS = {b'': '', b'zstd': 'zstd', b'lz4': 'lz4'}
_LONGEST_NAME = max(map(len, _COMPRESSIONS))


@dataclass(frozen=True)
class Loss:
    """Bytes of the input of which something is missing or not to be trusted, and why."""

    start: int
    end: int
    reason: str

    def __str__(self) -> str:
        return f'bytes {self.start} to {self.end}: {self.reason}'


@dataclass
class Salvage:
    """What was saved of a file.

    Attributes:
        content: Its records; every message has its channel and schema.
        losses: What is missing or not to be trusted; none if all of the content is there.
        rebuilt: What was broken, though nothing is missing for it: the index at the end.
        unverified: How many messages are from chunks whose checksum does not hold.
        stated_messages: How many messages the file says it had, if it still does.
    """

    content: Content
    losses: list[Loss] = field(default_factory=list)
    rebuilt: str = ''
    unverified: int = 0
    stated_messages: int | None = None

    @classmethod
    def nothing(cls, reason: str) -> Salvage:
        """Of a file that cannot be read."""
        return cls(Content(), [Loss(0, 0, reason)])

    @property
    def is_whole(self) -> bool:
        """Whether the input was a whole file to begin with."""
        return not self.losses and not self.rebuilt


def salvage(data: bytes, progress: Callable[[int], None] = lambda offset: None) -> Salvage:
    """Save what is whole in the bytes of an MCAP file; never fails, whatever they are.

    Args:
        data: The file.
        progress: Called now and then with the number of bytes that are done.
    """
    try:
        return Salvage(read_content(data))
    except DamagedRecord:
        return _Salvager(data, progress).run()


class _Salvager:
    """One walk over a file that is not whole."""

    def __init__(self, data: bytes, progress: Callable[[int], None]) -> None:
        self._data = data
        self._found = Salvage(Content())
        self._bytes_left = MOST_BYTES
        self._records_left = MOST_RECORDS
        self._walk = Resync(data, self._knows_channel, progress)
        self._section_ended = False
        self._defined: dict[tuple[type, int], records.Schema | records.Channel] = {}
        self._add_summary()

    def run(self) -> Salvage:
        start = len(MAGIC) if self._data.startswith(MAGIC) else 0
        if not start:
            self._lose(0, 0, 'it does not begin as an MCAP file')
        for item in self._walk.walk(start):
            if isinstance(item, Gap):
                self._take_gap(item)
            else:
                self._take(item)
            if self._is_proven(item):
                self._found.rebuilt = 'the index at the end of the file'
                break
        self._judge()
        self._drop_undefined()
        return self._found

    def _judge(self) -> None:
        """Say what is lost besides what was met on the way."""
        if not self._section_ended:
            self._lose(len(self._data), len(self._data), 'the end is missing')
        elif not self._found.losses and not self._found.rebuilt:
            self._lose(0, len(self._data), "the whole file's checksum does not hold; a metadata "
                       'record may be wrong, or what lies between the records')
        if self._records_left < 0:
            self._lose(0, len(self._data), f'there are more than {MOST_RECORDS} records')

    def _add_summary(self) -> None:
        """Take channels and schemas from the summary, in case the chunk that has them is lost."""
        try:
            summary = read_summary(self._data)
        except DamagedRecord:
            return
        self._found.content.schemas = summary.schemas
        self._found.content.channels = summary.channels
        self._found.stated_messages = summary.statistics.message_count

    def _is_proven(self, item: RawRecord | Gap) -> bool:
        """Whether the data section ended here, all of it as it was written."""
        if isinstance(item, Gap) or item.opcode != Opcode.DATA_END or self._section_ended:
            return False
        self._section_ended = True
        stated = int.from_bytes(item.body[:4], 'little')
        return not self._found.losses and stated in (0, zlib.crc32(self._data[: item.offset]))

    def _take(self, raw: RawRecord) -> None:
        try:
            record = parse(raw)
            if isinstance(record, records.Chunk):
                self._take_chunk(raw, record)
            elif not self._section_ended:
                self._keep(record)
            elif isinstance(record, (records.Schema, records.Channel)):
                self._add_definition(record)
        except DamagedRecord as error:
            if raw.opcode != Opcode.CHUNK or not self._take_broken_chunk(raw.offset, raw.end):
                self._lose(raw.offset, raw.end, error.reason)

    def _take_gap(self, gap: Gap) -> None:
        if not self._take_broken_chunk(gap.offset, gap.end):
            self._lose(gap.offset, gap.end, 'no whole record')

    def _take_chunk(self, raw: RawRecord, chunk: records.Chunk) -> None:
        if chunk.uncompressed_size > self._bytes_left:
            raise DamagedRecord(raw.offset, f'it unpacks to more than {MOST_BYTES} bytes')
        data = chunk_data(chunk, raw.offset)
        self._bytes_left -= len(data)
        for item in Resync(data, lambda channel: True).walk(0):
            if isinstance(item, Gap):
                self._lose(raw.offset, raw.end, 'a chunk holds what are no records')
            else:
                self._keep(parse(item))

    def _take_broken_chunk(self, start: int, end: int) -> bool:
        """Save what can be unpacked of a chunk whose header is readable; say whether it is."""
        prefix = start + HEADER_SIZE + _CHUNK_PREFIX
        name_size = int.from_bytes(self._data[prefix - 4 : prefix], 'little')
        packed = prefix + name_size + 8
        if packed > end or name_size > _LONGEST_NAME:
            return False
        compression = _COMPRESSIONS.get(self._data[prefix : packed - 8])
        if compression is None:
            return False
        if compression == '' and self._data[start] != Opcode.CHUNK:
            return False  # four zeros alone do not tell a chunk
        data, _ = unpack(compression, self._data[packed:end], self._bytes_left)
        self._bytes_left = max(0, self._bytes_left - len(data))
        saved = self._take_unverified(data)
        self._lose(start, end, f'a damaged chunk; messages saved from it, unverified: {saved}')
        return True

    def _take_unverified(self, data: bytes) -> int:
        """Keep the whole records in a chunk's data; return how many messages there were."""
        before = len(self._found.content.messages)
        for item in Resync(data, self._knows_channel).walk(0):
            try:
                record = None if isinstance(item, Gap) else parse(item)
            except DamagedRecord:
                continue
            if isinstance(record, (records.Schema, records.Channel)):
                self._add_definition(record)
            elif isinstance(record, records.Message):
                self._keep(record)
        saved = len(self._found.content.messages) - before
        self._found.unverified += saved
        return saved

    def _keep(self, record: records.McapRecord | None) -> None:
        self._records_left -= 1
        if self._records_left < 0 or record is None:
            return
        if isinstance(record, (records.Schema, records.Channel)):
            first = self._defined.setdefault((type(record), record.id), record)
            if first != record:
                self._lose(0, len(self._data), 'a schema or channel is defined twice, differently; '
                           'the first one is saved')
            record = first
        self._found.content.add(record)

    def _add_definition(self, record: records.Schema | records.Channel) -> None:
        """Keep what no verified part of the file defines."""
        content = self._found.content
        known = content.schemas if isinstance(record, records.Schema) else content.channels
        known.setdefault(record.id, record)

    def _knows_channel(self, channel: int) -> bool:
        return channel in self._found.content.channels

    def _drop_undefined(self) -> None:
        content = self._found.content
        defined = {
            channel.id for channel in content.channels.values()
            if channel.schema_id in content.schemas
        }
        kept = [message for message in content.messages if message.channel_id in defined]
        if len(kept) < len(content.messages):
            lost = len(content.messages) - len(kept)
            self._lose(0, len(self._data), f'messages whose channel or schema is lost: {lost}')
        content.messages = kept

    def _lose(self, start: int, end: int, reason: str) -> None:
        self._found.losses.append(Loss(start, end, reason))
