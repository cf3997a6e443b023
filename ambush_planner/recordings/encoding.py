# SPDX-License-Identifier: Apache-2.0
"""Encode one departure, or a plan, as an MCAP file with the profile ``ros2``.

The mcap library is imported on use: apt does not have it, and a node without it can still plan. Its
writer would compress everything again for each file. Here a large message has a chunk of its own,
whose compressed data stays with the message: map and markers are compressed once a plan. Only the
time of the message goes before them, uncompressed.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from .messages import Channel, RecordedMessage
from .schemas import definitions

if TYPE_CHECKING:
    from mcap.records import ChunkIndex, McapRecord

METADATA_RECORD = 'ambush_planner'
# Increases whenever the meaning of a metadata entry or an attachment changes.
FORMAT = '11'
MAGIC = b'\x89MCAP0\r\n'  # begins and ends a file
# Size of messages that have a chunk of their own [bytes].
_LARGE = 2**14
_LEVEL = 6  # of their compression: markers take a quarter less than at the usual 3
# How a message begins: operation code, length, channel, a number, and two times.
_MESSAGE, _MESSAGE_CODE = struct.Struct('<BQHIQQ'), 5
# A frame of zstd (RFC 8878): its magic number, and that a size of 8 bytes follows, the memory to
# unpack it. A block begins with 3 bytes: its size times 8 if it is not compressed, nor the last.
_FRAME = b'\x28\xb5\x2f\xfd\xe0'


def encode(messages: Sequence[RecordedMessage], entries: Mapping[str, Any],
           attachments: Mapping[str, bytes], compression: str) -> bytes:
    """Return the bytes of a whole file; ``messages`` are in the order of time.

    ``compression`` is ``zstd``, ``lz4`` or ``none``.
    """
    from mcap import records, writer

    begin, end = messages[0].stamp_ns, messages[-1].stamp_ns
    file = _File()
    indexes: list[McapRecord] = []
    file.add(records.Header(profile='ros2', library=writer.LIBRARY_IDENTIFIER))
    texts = {name: json.dumps(value) for name, value in entries.items()}
    place = file.add(records.Metadata(name=METADATA_RECORD, metadata={'format': FORMAT, **texts}))
    indexes.append(records.MetadataIndex(name=METADATA_RECORD, **place))
    for name, data in attachments.items():
        said: dict[str, Any] = {'name': name, 'media_type': 'application/zip', 'create_time': 0,
                                'log_time': begin}
        place = file.add(records.Attachment(data=data, **said))
        indexes.append(records.AttachmentIndex(data_size=len(data), **said, **place))
    channels = tuple(dict.fromkeys(each.channel for each in messages))
    ids = {channel: k for k, channel in enumerate(channels, 1)}
    small = [each for each in messages if len(each.data) < _LARGE]
    parts = [small, *([each] for each in messages if len(each.data) >= _LARGE)]
    known = _known(channels)
    chunks: list[ChunkIndex] = []
    for part in filter(None, parts):
        chunks.append(file.add_chunk(b'' if chunks else known, part, ids, compression))
    statistics = records.Statistics(
        attachment_count=len(attachments), channel_count=len(channels), metadata_count=1,
        channel_message_counts=Counter(ids[each.channel] for each in messages),
        chunk_count=len(chunks), message_count=len(messages), message_start_time=begin,
        message_end_time=end, schema_count=len({each.type for each in channels}))
    return file.finished(known + _bytes_of([statistics, *chunks, *indexes]))


@lru_cache(16)
def _known(channels: tuple[Channel, ...]) -> bytes:
    """Return the records of the channels, numbered from 1, after those of their types."""
    from mcap.records import Channel as ChannelRecord
    from mcap.records import Schema

    kinds = {kind: k for k, kind in enumerate(dict.fromkeys(each.type for each in channels), 1)}
    return _bytes_of([
        *(Schema(id=k, name=kind, encoding='ros2msg', data=definitions()[kind].text.encode())
          for kind, k in kinds.items()),
        *(ChannelRecord(
            id=k, topic=each.topic, message_encoding='cdr', schema_id=kinds[each.type],
            metadata={'offered_qos_profiles': each.qos,
                      'topic_type_hash': definitions()[each.type].type_hash})
          for k, each in enumerate(channels, 1))])


class _File:
    """The data section of a file so far."""

    def __init__(self) -> None:
        self._data = bytearray(MAGIC)

    def add(self, record: McapRecord) -> dict[str, Any]:
        """Add a record; return where it is, as an index says it."""
        data = _bytes_of([record])
        place = {'offset': len(self._data), 'length': len(data)}
        self._data += data
        return place

    def add_chunk(self, head: bytes, part: Sequence[RecordedMessage], ids: Mapping[Channel, int],
                  compression: str) -> ChunkIndex:
        """Add a chunk of messages after the records ``head``; return its index."""
        from mcap import records

        content, places = bytearray(head), defaultdict(list)
        last = part[-1]
        for each in part:
            number, stamp, size = ids[each.channel], each.stamp_ns, len(each.data)
            places[number].append((stamp, len(content)))
            content += _MESSAGE.pack(_MESSAGE_CODE, _MESSAGE.size - 9 + size, number, 0, stamp,
                                     stamp)
            content += each.data if each is not last else b''
        said: dict[str, Any] = {
            'message_start_time': part[0].stamp_ns, 'message_end_time': last.stamp_ns,
            'uncompressed_size': len(content) + len(last.data),
            'compression': compression.replace('none', '')}
        packed = _packed(bytes(content), last, compression)
        # A chunk has no CRC of its own (0): that of the data section covers the packed bytes.
        chunk = self.add(records.Chunk(data=packed, uncompressed_crc=0, **said))
        offsets, begin = {}, len(self._data)
        for number, found in places.items():
            place = self.add(records.MessageIndex(channel_id=number, records=found))
            offsets[number] = place['offset']
        return records.ChunkIndex(
            chunk_start_offset=chunk['offset'], chunk_length=chunk['length'],
            message_index_offsets=offsets, message_index_length=len(self._data) - begin,
            compressed_size=len(packed), **said)

    def finished(self, summary: bytes) -> bytes:
        """Return the whole file, with the records of its summary."""
        from mcap import records

        self.add(records.DataEnd(zlib.crc32(self._data)))
        # The footer ends with the CRC of all before it, from the summary on.
        summary += _bytes_of([records.Footer(len(self._data), 0, 0)])[:-4]
        crc = zlib.crc32(summary).to_bytes(4, 'little')
        return b''.join((self._data, summary, crc, MAGIC))


def _bytes_of(found: Sequence[McapRecord]) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    for each in found:
        each.write(builder)
    data: bytes = builder.end()
    return data


def _packed(head: bytes, last: RecordedMessage, compression: str) -> bytes:
    """Return what a chunk holds, compressed, which ends with the data of a message."""
    if compression == 'none':
        return head + last.data
    if compression == 'lz4':
        from lz4 import frame

        found: bytes = frame.compress(head + last.data)
        return found
    import zstandard

    if len(last.data) < _LARGE:
        return zstandard.compress(head + last.data)
    if not last.packed or last.packed[0] is not last.data:
        whole = zstandard.compress(last.data, _LEVEL)
        last.packed[:] = last.data, whole[zstandard.frame_header_size(whole):]
    size, block = (len(head) + len(last.data)).to_bytes(8, 'little'), len(head) * 8
    return b''.join((_FRAME, size, block.to_bytes(3, 'little'), head, last.packed[1]))
