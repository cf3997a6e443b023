"""Finds the records in bytes of which some are broken."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode

from .mcap_records import (
    HEADER_SIZE,
    MAGIC,
    DamagedRecord,
    RawRecord,
    parse,
    record_at,
)

# A record's header: a kind, and a length below 4 GiB.
_HEADER = re.compile(rb'(?=[\x01-\x0f].{4}\x00{4})', re.DOTALL)
_LENGTH_HIGH = slice(5, 9)
# From here on, kinds are free for private use: what is in such a record is none of the file's.
_PRIVATE = 0x80
_WINDOW = 2**20
# How many times the size of the data may be parsed in search of the next record: bytes that were
# made to look like headers everywhere would take the square of their size.
_MOST_PARSED = 4
# The least bytes that the body of each kind can have.
_LEAST_BODY = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}


@dataclass(frozen=True)
class Gap:
    """Bytes among the records that are none."""

    offset: int
    end: int


class Resync:
    """A walk over the records in ``data`` that goes on after what is broken.

    Args:
        data: The bytes.
        knows_channel: Says whether a channel's id was met; bytes are taken for a message only
            then, for a message's body may be anything.
        progress: Called now and then with the offset that was reached.
    """

    def __init__(
        self,
        data: bytes,
        knows_channel: Callable[[int], bool],
        progress: Callable[[int], None] = lambda offset: None,
    ) -> None:
        self._data = data
        self._view = memoryview(data)
        self._knows_channel = knows_channel
        self._progress = progress
        self._bytes_left = _MOST_PARSED * len(data)

    def walk(self, offset: int) -> Iterator[RawRecord | Gap]:
        """Yield records that are framed right, and the gaps between them, to the end."""
        end = len(self._data)
        if self._data.endswith(MAGIC):
            end = max(offset, end - len(MAGIC))
        while offset < end:
            self._progress(offset)
            if (private := self._private_end(offset)) is not None:
                yield Gap(offset, private)
                offset = private
                continue
            raw = self.framed(offset)
            if raw is not None and self.follows(raw.end):
                yield raw
                offset = raw.end
                continue
            # Either the length of this record is broken, or the one after it.
            after = min(self.next_record(offset + 1), end)
            if raw is not None and raw.end <= after and _parses(raw):
                yield raw
                offset = raw.end
            if offset < after:
                yield Gap(offset, after)
            offset = after

    def framed(self, offset: int) -> RawRecord | None:
        """Return the record at ``offset`` if its kind and length can be right."""
        try:
            raw = record_at(self._view, offset)
        except DamagedRecord:
            return None
        if len(raw.body) < _LEAST_BODY.get(raw.opcode, len(self._data)):
            return None
        channel = int.from_bytes(raw.body[:2], 'little')
        if raw.opcode == Opcode.MESSAGE and not self._knows_channel(channel):
            return None
        return raw

    def _private_end(self, offset: int) -> int | None:
        """The end of a record of a private kind: whatever it holds, records in it do not count."""
        if self._data[offset] < _PRIVATE:
            return None
        try:
            end = record_at(self._view, offset).end
        except DamagedRecord:
            return None
        return end if self.follows(end) else None

    def follows(self, offset: int) -> bool:
        """Whether the data ends at ``offset`` or a record can begin there."""
        header = self._data[offset : offset + HEADER_SIZE]
        if header.startswith(MAGIC) or not header:
            return True
        known = header[0] in _LEAST_BODY or header[0] >= _PRIVATE
        return known and not any(header[_LENGTH_HIGH])

    def next_record(self, offset: int) -> int:
        """Return where the next record begins that parses and is followed by another one.

        The end, too, where too much in the data looks like records and is none.
        """
        end = len(self._data)
        while offset < end:
            self._progress(offset)
            window = min(offset + _WINDOW, end)
            for match in _HEADER.finditer(self._data, offset, min(window + HEADER_SIZE, end)):
                start = match.start()
                if start < window and (raw := self.framed(start)) and self.follows(raw.end):
                    if self._bytes_left < 0:
                        return end
                    self._bytes_left -= len(raw.body)
                    if _parses(raw):
                        return start
            offset = window
        return end


def _parses(raw: RawRecord) -> bool:
    try:
        parse(raw)
    except DamagedRecord:
        return False
    return True
