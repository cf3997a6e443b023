"""What stands in a recording beside the messages: its layout, and definitions of types."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from ..recording import RecordedDeparture
from ..recording.map_changes import MAP_CHANGES_FILE
from ..recording.mcap_file import (
    BROKEN,
    HEADER_SIZE,
    MAGIC,
    METADATA_RECORD,
    MOST_BYTES,
    Content,
    encode,
    records_of,
    walk,
)
from ..recording.qos import is_written_so
from ..recording.schemas import load_definition
from ..recording.strategy_file import STRATEGY_FILE
from .case import TYPES

_CHANNEL_KEYS = {'offered_qos_profiles', 'topic_type_hash'}


def file_faults(recorded: RecordedDeparture) -> list[str]:
    """Check that a file has what the recorder writes, where it writes it, and nothing else.

    Raises
    ------
    RecordingFailed
        The interfaces of a type are not installed.
    """
    content = recorded.content
    faults = []
    expected = [STRATEGY_FILE] + [MAP_CHANGES_FILE] * bool(recorded.map_changes)
    if [each.name for each in content.attachments] != expected:
        faults.append(
            f'attachments: there are {len(content.attachments)}, not just {" and ".join(expected)}'
        )
    if [each.name for each in content.metadata] != [METADATA_RECORD]:
        faults.append(f'metadata: there are records beside {METADATA_RECORD}')
    return [*faults, *_channel_faults(content), *_layout_faults(recorded.data, content)]


def _channel_faults(content: Content) -> list[str]:
    """Compare with the interfaces that are installed; others than the planner's are not known."""
    faults = []
    for channel in content.channels.values():
        schema = content.schemas[channel.schema_id]
        if set(channel.metadata) != _CHANNEL_KEYS:
            faults.append(f'channels: that of {channel.topic[:60]!r} does not state what ours do')
        elif not is_written_so(channel.metadata['offered_qos_profiles']):
            faults.append(f"channels: {channel.topic[:60]!r} has another quality of service's text")
        if schema.name not in TYPES:
            continue
        known = load_definition(schema.name)
        stated = schema.encoding, schema.data, channel.metadata.get('topic_type_hash')
        if stated != (known.encoding, known.text.encode(), known.type_hash):
            faults.append(f'definition of {schema.name}: it is not that of the installed one')
    if unused := content.channels.keys() - {each.channel_id for each in content.messages}:
        faults.append(f'channels: {len(unused)} have no messages')
    return list(dict.fromkeys(faults))


def _layout_faults(data: bytes, content: Content) -> list[str]:
    """Compare a file with what the recorder makes of its content: nothing more may be in it.

    Times of publishing and of attachments, channels without messages, their metadata, records of
    other kinds or of another length and the order of all are compared this way. Offsets and
    compressed bytes are not: other releases of the libraries pack otherwise.
    """
    ordered = sorted(content.messages, key=lambda each: each.log_time)
    first = ordered[0].log_time if ordered else 0
    plain = replace(
        content,
        profile='ros2',
        messages=[replace(each, publish_time=each.log_time, sequence=0) for each in ordered],
        attachments=[
            replace(each, create_time=0, log_time=first, media_type='application/zip')
            for each in content.attachments
        ],
    )
    again = encode(plain)
    if again == data:
        return []
    one, other = _skeleton(data), _skeleton(again)
    if one == other:
        return []
    kinds = next((pair for pair in zip(one, other, strict=False) if pair[0] != pair[1]), None)
    name = kinds[0][0] if kinds else 'its end'
    return [f'file: it is not laid out as the recorder does it; the first difference is at {name}']


def _skeleton(data: bytes) -> list[tuple[str, object]]:
    """Kind by kind what a file says, without offsets, compressed bytes and the library's name."""
    found = []
    for opcode, body in walk(data, len(MAGIC), len(data) - len(MAGIC)):
        name = Opcode(opcode).name if opcode in list(Opcode) else f'a record of kind {opcode}'
        record = _parsed(opcode, body)
        builder = RecordBuilder()
        if record is not None:
            record.write(builder)
        # A length of its own, or what is written back otherwise.
        plain = record is not None and builder.end()[HEADER_SIZE:] == bytes(body)
        found.append((name, (plain, _without_offsets(record))))
    return found


def _parsed(opcode: int, body: memoryview) -> records.McapRecord | None:
    framed = bytes([opcode]) + len(body).to_bytes(8, 'little') + bytes(body)
    reader = StreamReader(BytesIO(framed), skip_magic=True, emit_chunks=True)
    try:
        return next(reader.records, None)
    except BROKEN:
        return None


def _without_offsets(record: object) -> object:
    if isinstance(record, records.Chunk):
        return (
            record.compression, record.message_start_time, record.message_end_time,
            [*map(repr, records_of(record, MOST_BYTES))],
        )
    if isinstance(record, records.ChunkIndex):
        return (
            record.compression, record.message_start_time, record.message_end_time,
            record.uncompressed_size, sorted(record.message_index_offsets),
        )
    if isinstance(record, (records.AttachmentIndex, records.MetadataIndex)):
        return replace(record, offset=0)
    if isinstance(record, records.SummaryOffset):
        return record.group_opcode
    if isinstance(record, records.Header):
        return record.profile, record.library.partition('mcap ')[0]
    if isinstance(record, (records.Footer, records.DataEnd)):
        return type(record)
    return record
