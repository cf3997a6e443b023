"""What stands in a recording beside what it says: compared with what the recorder would write."""

from __future__ import annotations

import re
from dataclasses import replace
from io import BytesIO

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from . import Attachment, RecordedDeparture, RecordingFailed
from .mcap_file import BROKEN, HEADER_SIZE, MAGIC, MOST_BYTES, encode, records_of, walk
from .qos_text import is_written_so
from .recorder import departure_content


def file_faults(recorded: RecordedDeparture) -> list[str]:
    """Check that a file has what the recorder writes, where it writes it, and nothing else.

    The recorder's own content of the same messages, entries and attachments is encoded again. So
    times of publishing and of attachments, definitions of types, channels without messages or
    with more metadata, records of other kinds or of another length and the order of all are
    compared. Offsets and compressed bytes are not: other releases of the libraries pack otherwise.
    """
    texts, parameters = recorded.metadata.texts, recorded.metadata.parameters
    faults = [
        f"channels: {topic[:60]!r} has another quality of service's text"
        for topic, qos in dict.fromkeys((each.topic, each.qos_text) for each in recorded.messages)
        if not is_written_so(qos)
    ]
    files = [
        Attachment(name, 'application/zip', data) for name, data in recorded.attachments.items()
    ]
    compression = str(parameters.get('recording.compression', ''))
    try:
        content = departure_content(recorded.messages, dict(texts), files, compression)
        again = encode(content)
    except (RecordingFailed, LookupError, ValueError) as error:
        return [*faults, f'file: it is not what the recorder writes ({type(error).__name__})']
    return [*faults, *_layout_faults(recorded.data, again)]


def _layout_faults(data: bytes, again: bytes) -> list[str]:
    if again == data:
        return []
    one, other = _skeleton(data), _skeleton(again)
    if one == other:
        return []
    pairs = zip(one, other, strict=False)
    name = next((a[0] for a, b in pairs if a != b), 'its end')
    return [f'file: it is not laid out as the recorder does it; the first difference is at {name}']


def _skeleton(data: bytes) -> list[tuple[str, object]]:
    """Kind by kind what a file says, without offsets, compressed bytes and the library's name."""
    found = []
    for opcode, body in walk(data, len(MAGIC), len(data) - len(MAGIC)):
        record = _parsed(opcode, body)
        if record is None:
            found.append((f'a record of kind {opcode}', bytes(body)))
            continue
        builder = RecordBuilder()
        record.write(builder)
        # A length of its own, or what is written back otherwise.
        plain = builder.end()[HEADER_SIZE:] == bytes(body)
        found.append((Opcode(opcode).name, (plain, _without_offsets(record))))
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
        return record.profile, re.sub(r'[\d.]+$', '', record.library)
    if isinstance(record, (records.Footer, records.DataEnd)):
        return type(record)
    return record
