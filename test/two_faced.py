"""Files in which readers find different things, though all checksums and the data section hold."""

import struct
import zlib
from dataclasses import replace
from io import BytesIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message, serialize_message

from ambush_planner.recordings.mcap_file import MAGIC, decode, encode

PRIVATE = 0x80


def records_of(data):
    """The records in a file: (kind, bytes with the header, parsed)."""
    found, place = [], len(MAGIC)
    while place < len(data) - len(MAGIC):
        end = place + 9 + int.from_bytes(data[place + 1 : place + 9], 'little')
        raw = bytes(data[place:end])
        reader = StreamReader(BytesIO(raw), skip_magic=True, emit_chunks=True)
        found.append((raw[0], raw, reader._read_record(*_header(reader))))
        place = end
    return found


def _header(reader):
    return reader._stream.read1(), reader._stream.read8()


def encoded(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def framed(opcode, body):
    return struct.pack('<BQ', opcode, len(body)) + body


def assembled(data_section, summary):
    """A file of the records before the data section's end and those of the summary."""
    data = MAGIC + b''.join(data_section)
    data += framed(Opcode.DATA_END, struct.pack('<I', zlib.crc32(data)))
    ending = framed(Opcode.FOOTER, struct.pack('<QQI', len(data), 0, 0))[:-4]
    body = b''.join(summary) + ending
    return data + body + struct.pack('<I', zlib.crc32(body)) + MAGIC


def split(data):
    """The records of the data section and of the summary, without their ends."""
    found = records_of(data)
    (end,) = [k for k, (opcode, _, _) in enumerate(found) if opcode == Opcode.DATA_END]
    kept = [each for each in found[end + 1 :]
            if each[0] not in (Opcode.FOOTER, Opcode.SUMMARY_OFFSET)]
    return found[:end], kept


def of_summary(data, change):
    """The file with another summary; ``change`` is given each of its records, or drops it."""
    section, summary = split(data)
    changed = [change(record) for _, _, record in summary]
    return assembled(
        [raw for _, raw, _ in section], [encoded(each) for each in changed if each is not None]
    )


def of_section(data, change):
    """The file with other records in the data section and no index: ``change`` is given all."""
    section, summary = split(data)
    kept = [raw for opcode, raw, _ in summary if opcode in (Opcode.SCHEMA, Opcode.CHANNEL)]
    return assembled(change(section), kept)


def another_path(data):
    """The same departure with all poses of the path a kilometre away."""
    content = decode(data)
    for message in content.messages:
        if content.channels[message.channel_id].topic == '/path':
            path = deserialize_message(message.data, PathMessage)
            for each in path.poses:
                each.pose.position.y += 1000.0
            message.data = serialize_message(path)
    return encode(content)


def hidden_chunk(data):
    """Who reads from the beginning skips what who reads by the summary is led to."""
    section, summary = split(data)
    start = len(MAGIC) + sum(len(raw) for _, raw, _ in section) + 9
    other = another_path(data)
    chunks = [(opcode, raw) for opcode, raw, _ in split(other)[0]
              if opcode in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)]
    (index,) = make_reader(BytesIO(other)).get_summary().chunk_indexes
    moved = start - index.chunk_start_offset
    index = replace(index, chunk_start_offset=start, message_index_offsets={
        key: offset + moved for key, offset in index.message_index_offsets.items()
    })
    return assembled(
        [*(raw for _, raw, _ in section), framed(PRIVATE, b''.join(raw for _, raw in chunks))],
        [encoded(index) if opcode == Opcode.CHUNK_INDEX else raw for opcode, raw, _ in summary],
    )


def renamed_topics(data):
    """Start and goal swapped in the summary only."""
    names = {'/start_pose': '/goal_pose', '/goal_pose': '/start_pose'}
    return of_summary(data, lambda record: replace(record, topic=names[record.topic])
                      if getattr(record, 'topic', None) in names else record)


def early_message_index(data):
    """The index behind the chunk says that a message is of 1970."""
    section, summary = split(data)
    channels = decode(data).channels
    return assembled(
        [
            encoded(replace(record, records=[(1, offset) for _, offset in record.records]))
            if opcode == Opcode.MESSAGE_INDEX and channels[record.channel_id].topic == '/path'
            else raw
            for opcode, raw, record in section
        ],
        [raw for _, raw, _ in summary],
    )
