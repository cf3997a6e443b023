"""A file is read only if who reads by its indexes finds what who reads from the beginning finds."""

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
from recording_samples import file_of, small_departure
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

from ambush_planner.recordings import UnreadableRecording
from ambush_planner.recordings.mcap_file import MAGIC, decode, whole_part
from ambush_planner.recordings.reader import read_departure
from ambush_planner.recordings.verify_file import file_faults

SENT = small_departure()
WHOLE = file_of(SENT)
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


def test_the_untouched_file_put_together_again_is_read():
    assert decode(assembled(RAW, [raw for _, raw, _ in SUMMARY])) == decode(WHOLE)


@pytest.mark.parametrize('lie', LIES)
def test_a_lie_is_found_and_the_messages_are_saved(lie, tmp_path):
    """Either no reader takes the file, or verify says that its layout is not the recorder's."""
    data = LIES[lie]()
    (tmp_path / 'x.mcap').write_bytes(data)
    try:
        assert file_faults(read_departure(tmp_path / 'x.mcap'))
    except UnreadableRecording:
        pass
    content, _ = whole_part(data)
    sent = [message.data for message in SENT]
    assert [message.data for message in content.messages][: len(sent)] == sent


def test_the_writer_of_rosbags_is_read(tmp_path):
    kind, store = 'std_msgs/msg/String', get_typestore(Stores.ROS2_HUMBLE)
    with BagWriter(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        used, _ = [writer.add_connection(name, kind, typestore=store) for name in ('/a', '/b')]
        for stamp in (5, 3, 9):
            writer.write(used, stamp, store.serialize_cdr(store.types[kind]('x'), kind))
    (path,) = (tmp_path / 'bag').glob('*.mcap')
    assert sorted(m.log_time for m in decode(path.read_bytes()).messages) == [3, 5, 9]


def test_the_lies_are_ones():
    """What the library's reader finds in them is not what is in the data section."""
    for lie, topic in (('a hidden chunk', '/path'), ('other topics', '/start_pose')):
        found = {
            channel.topic: message.data
            for _, channel, message in make_reader(BytesIO(LIES[lie]())).iter_messages()
        }
        (sent,) = [each.data for each in SENT if each.topic == topic]
        assert found[topic] != sent
