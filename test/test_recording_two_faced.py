"""A file is read only if who reads by its indexes finds what who reads from the beginning finds."""

import itertools
from dataclasses import replace
from io import BytesIO

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import CompressionType, IndexType, Writer
from recording_samples import METADATA, START_NS, STRATEGY, small_departure
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from two_faced import (
    PRIVATE,
    assembled,
    early_message_index,
    encoded,
    framed,
    hidden_chunk,
    of_section,
    of_summary,
    records_of,
    renamed_topics,
    split,
)

from ambush_planner.recording.encoding import encode_departure
from ambush_planner.recording.mcap_content import read_content
from ambush_planner.recording.mcap_records import MAGIC, DamagedRecord
from ambush_planner.recording.recorder import COMPRESSIONS
from ambush_planner.recording.salvage import salvage

SENT = small_departure()
WHOLE = encode_departure(SENT, METADATA, [STRATEGY], COMPRESSIONS['zstd'])
SECTION, SUMMARY = split(WHOLE)
RAW = [raw for _, raw, _ in SECTION]


def only(kind, change):
    """Change the summary's records of a kind."""
    return of_summary(WHOLE, lambda each: change(each) if isinstance(each, kind) else each)


def with_times(stated):
    return replace(stated, message_start_time=stated.message_start_time + 1)


def first_count_doubled(stated):
    counts = stated.channel_message_counts
    return replace(stated, channel_message_counts={**counts, min(counts): 2})


def redefined(section):
    """A channel that is another one from here on."""
    channel = Channel(1, '/other', 'cdr', {}, 1)
    return [*(raw for _, raw, _ in section), encoded(channel)]


def twice_the_key():
    """Metadata in which a key has two values: readers take the first one or the last."""
    text = b''.join(len(part).to_bytes(4, 'little') + part for part in (b'format', b'2') * 2)
    body = (1).to_bytes(4, 'little') + b'm' + len(text).to_bytes(4, 'little') + text
    return framed(Opcode.METADATA, body)


def offsets_elsewhere():
    """The summary's own index leads to other bytes."""
    offset = SummaryOffset(Opcode.CHANNEL, len(MAGIC), 40)
    return assembled(RAW, [*(raw for _, raw, _ in SUMMARY), encoded(offset)])


LIES = {
    'a hidden chunk': lambda: hidden_chunk(WHOLE),
    'other topics': lambda: renamed_topics(WHOLE),
    'another time in the index of a chunk': lambda: early_message_index(WHOLE),
    'a private record': lambda: assembled([*RAW, framed(PRIVATE, b'x')], []),
    'an unknown record': lambda: assembled([*RAW, framed(0x10, b'')], []),
    'a footer before the end': lambda: assembled([*RAW, records_of(WHOLE)[-1][1]], []),
    'a second header': lambda: assembled([*RAW, RAW[0]], []),
    'no header': lambda: assembled(RAW[1:], []),
    'a message in the summary': lambda: assembled(RAW, [framed(Opcode.MESSAGE, bytes(22))]),
    'a channel defined twice': lambda: of_section(WHOLE, redefined),
    'metadata with a key twice': lambda: assembled([*RAW, twice_the_key()], []),
    'a message index for no chunk': lambda: assembled([*RAW, RAW[1], RAW[-1]], []),
    'a message index twice': lambda: assembled([*RAW, RAW[-1]], []),
    'a message that is in no index': lambda: assembled(RAW[:-1], []),
    'a message outside of the chunks': lambda: assembled(
        [*RAW, framed(Opcode.MESSAGE, b'\1\0' + bytes(20))], [raw for _, raw, _ in SUMMARY]),
    'another schema': lambda: only(Schema, lambda each: replace(each, data=each.data + b'#')),
    'a channel left out': lambda: only(Channel, lambda each: None if each.id == 1 else each),
    'a schema left out': lambda: only(Schema, lambda each: None if each.id == 1 else each),
    'a chunk elsewhere': lambda: only(
        ChunkIndex, lambda each: replace(each, chunk_start_offset=each.chunk_start_offset + 1)),
    'a chunk of other times': lambda: only(
        ChunkIndex, lambda each: replace(each, message_end_time=1)),
    'a chunk without its message indexes': lambda: only(
        ChunkIndex, lambda each: replace(each, message_index_offsets={})),
    'an attachment of another name': lambda: only(
        AttachmentIndex, lambda each: replace(each, name='another')),
    'metadata elsewhere': lambda: only(
        MetadataIndex, lambda each: replace(each, offset=each.offset + 1)),
    'other counts': lambda: only(Statistics, first_count_doubled),
    'other times': lambda: only(Statistics, with_times),
    'offsets elsewhere': offsets_elsewhere,
}


def test_the_untouched_file_is_read_in_pieces_too():
    assert read_content(assembled(RAW, [raw for _, raw, _ in SUMMARY])) == read_content(WHOLE)


@pytest.mark.parametrize('lie', LIES)
def test_a_lie_is_found_and_the_messages_are_saved(lie):
    data = LIES[lie]()
    with pytest.raises(DamagedRecord):
        read_content(data)
    found = salvage(data)
    assert not found.is_whole
    sent = [message.data for message in SENT]
    assert [message.data for message in found.content.messages][: len(sent)] == sent
    assert len(found.content.messages) == len(sent) + (lie == 'a message outside of the chunks')


def test_what_is_saved_of_two_definitions_is_said():
    found = salvage(LIES['a channel defined twice']())
    assert any('defined twice' in str(loss) for loss in found.losses)
    assert found.content.channels[1].topic == '/alpha_map'


OPTIONS = [
    {'use_chunking': False}, {'enable_crcs': False}, {'enable_data_crcs': True},
    {'chunk_size': 1}, {'chunk_size': 1500}, {'compression': CompressionType.LZ4},
    {'compression': CompressionType.NONE}, {'repeat_channels': False}, {'repeat_schemas': False},
    {'use_statistics': False}, {'use_summary_offsets': False},
    *({'index_types': kind, 'chunk_size': 1500} for kind in (
        IndexType.NONE, IndexType.ATTACHMENT, IndexType.CHUNK, IndexType.MESSAGE,
        IndexType.METADATA, IndexType.CHUNK | IndexType.MESSAGE)),
]
NOTHING_AT_THE_END = {
    'use_statistics': False, 'repeat_channels': False, 'repeat_schemas': False,
    'index_types': IndexType.NONE,
}


@pytest.mark.parametrize('options', [
    {}, NOTHING_AT_THE_END, {**NOTHING_AT_THE_END, 'use_summary_offsets': False}, *OPTIONS,
    *({**one, **other} for one, other in itertools.combinations(OPTIONS, 2)
      # There the library leaves what it has not flushed out of its checksum.
      if {**one, **other} != {'use_chunking': False, 'enable_data_crcs': True}),
], ids=str)
def test_whatever_conforming_writers_leave_out_is_read(options):
    stream = BytesIO()
    writer = Writer(stream, **options)
    writer.start('ros2')
    writer.add_metadata('m', METADATA)
    schemas = [writer.register_schema(f'a/msg/{n}', 'ros2msg', b'x') for n in 'ABC']
    first, second, _ = [writer.register_channel(f'/{key}', 'cdr', key) for key in schemas]
    rows = [(first, 5), (second, 3), (first, 3), (first, 9), (second, 9)]
    for number, (channel, after) in enumerate(rows):
        writer.add_message(channel, START_NS + after, bytes(1000), 0, number)
        if number == 2:
            writer.add_attachment(1, 2, 'f', 't', b'data')
            third = writer.register_channel('/late', 'json', 0)
            writer.add_message(third, START_NS, b'{}', 0)
    writer.register_channel('/never', 'cdr', writer.register_schema('a/msg/D', 'ros2msg', b''))
    writer.finish()
    content = read_content(stream.getvalue())
    assert sorted((m.channel_id, m.log_time - START_NS) for m in content.messages) == sorted(
        [*rows, (third, 0)])
    assert [file.name for file in content.attachments] == ['f']
    assert content.metadata[0].metadata == METADATA


def test_the_writer_of_rosbags_is_read(tmp_path):
    kind, store = 'std_msgs/msg/String', get_typestore(Stores.ROS2_HUMBLE)
    with BagWriter(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        used, _ = [writer.add_connection(name, kind, typestore=store) for name in ('/a', '/b')]
        for stamp in (5, 3, 9):
            writer.write(used, stamp, store.serialize_cdr(store.types[kind]('x'), kind))
    (path,) = (tmp_path / 'bag').glob('*.mcap')
    assert sorted(m.log_time for m in read_content(path.read_bytes()).messages) == [3, 5, 9]


def test_files_without_messages_are_read():
    for options in ({}, NOTHING_AT_THE_END, {'use_chunking': False}):
        stream = BytesIO()
        writer = Writer(stream, **options)
        writer.start('ros2')
        writer.register_channel('/a', 'json', 0)
        writer.finish()
        assert read_content(stream.getvalue()).messages == []


def test_the_lies_are_ones():
    """What the library's reader finds in them is not what is in the data section."""
    for lie, topic in (('a hidden chunk', '/path'), ('other topics', '/start_pose')):
        found = {
            channel.topic: message.data
            for _, channel, message in make_reader(BytesIO(LIES[lie]())).iter_messages()
        }
        (sent,) = [each.data for each in SENT if each.topic == topic]
        assert found[topic] != sent
