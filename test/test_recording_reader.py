"""Recordings read back: equal to what was recorded, or one clear error for whatever is broken."""

import json
import os
import random
import struct
import tracemalloc
from pathlib import Path

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_samples import (
    LATCHED,
    START_NS,
    STRATEGY,
    departure,
    encoded_departure,
    fields,
    file_of,
    get_plan_events,
    metadata_for,
    record,
    recorded,
    small_departure,
    trigger_events,
)

from ambush_planner.errors import AmbushPlannerError
from ambush_planner.recordings import (
    Attachment,
    RecordedMessage,
    Recorder,
    RecordingFailed,
    UnreadableRecording,
    read_departure,
    recordings_in,
)
from ambush_planner.recordings.mcap_file import COMPRESSIONS, decode, encode
from ambush_planner.recordings.verify_file import file_faults

TEXT = st.text(st.characters(codec='utf-8'))


def encoded(compression='zstd'):
    return file_of(small_departure(), compression)


def unreadable(tmp_path, data):
    """The reason for which a file with these bytes is refused."""
    path = tmp_path / 'broken.mcap'
    path.write_bytes(data)
    with pytest.raises(UnreadableRecording) as caught:
        read_departure(path)
    assert isinstance(caught.value, AmbushPlannerError)
    assert caught.value.path == path
    assert str(path) in str(caught.value)
    return caught.value.reason


def test_a_departure_reads_back_as_it_was_recorded(tmp_path):
    sent = departure() + [
        recorded(f'/{name}/_service_event', event, stamp_ns=START_NS + 9_000_000)
        for name, events in (('new_route', trigger_events()), ('get_plan', get_plan_events()))
        for event in events
    ]
    path = record(Recorder(tmp_path), sent[::-1])
    read = read_departure(path)
    assert read.path == path
    assert [m.stamp_ns for m in read.messages] == [m.stamp_ns for m in sent]
    assert sorted(map(fields, read.messages)) == sorted(map(fields, sent))
    entries = {key: text for key, text in read.metadata.texts.items() if key != 'chain'}
    assert entries == metadata_for(sent)
    assert read.attachments == {STRATEGY.name: STRATEGY.data}
    assert read.strategy == STRATEGY.data


@settings(max_examples=40, deadline=None)
@given(
    rows=st.lists(
        st.tuples(st.sampled_from(('/a', '/tópic')), st.integers(0, 2**63 - 1), st.binary()),
        min_size=1,
        max_size=10,
    ),
    metadata=st.dictionaries(TEXT, TEXT),
    attachments=st.dictionaries(TEXT, st.binary()),
    compression=st.sampled_from(sorted(COMPRESSIONS)),
)
def test_any_bytes_stamps_metadata_and_attachments_come_back(
    rows, metadata, attachments, compression
):
    sent = [
        RecordedMessage(topic, 'std_msgs/msg/Header', b'\0\1\0\0' + data, LATCHED, stamp)
        for topic, stamp, data in rows
    ]
    files = [Attachment(name, 'application/zip', data) for name, data in attachments.items()]
    data = encoded_departure(sent, metadata, files, compression)
    for content in (decode(data), decode(encode(decode(data)))):
        in_order = sorted(sent, key=lambda m: m.stamp_ns)
        read = [
            (content.channels[m.channel_id].topic, m.log_time, m.data) for m in content.messages
        ]
        assert read == [(m.topic, m.stamp_ns, m.data) for m in in_order]
        assert content.metadata[0].metadata == metadata
        assert {file.name: file.data for file in content.attachments} == attachments


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_every_truncation_and_every_flipped_bit_is_noticed(tmp_path, compression):
    data = encoded(compression)
    generator = random.Random(7)
    for _ in range(70):
        unreadable(tmp_path, data[: generator.randrange(len(data))])
    content = decode(data)
    for _ in range(170):
        place = generator.randrange(8 * len(data))
        changed = bytearray(data)
        changed[place // 8] ^= 1 << place % 8
        path = tmp_path / 'changed.mcap'
        path.write_bytes(changed)
        try:
            # What no reader minds may be read, if it changes nothing: a length that is not used.
            same = read_departure(path).content
            same.library = content.library
            assert same == content and file_faults(read_departure(path))
        except UnreadableRecording:
            pass


def test_truncation_at_each_of_the_last_bytes_and_what_to_do(tmp_path):
    data = encoded()
    for kept in range(len(data) - 60, len(data)):
        assert 'run ambush_recover' in unreadable(tmp_path, data[:kept])


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (b'', 'empty'),
        (b'hello', 'not an MCAP file'),
        (b'\x89MCAP0\r\n', 'broken or cut off'),
        (b'\x89MCAP0\r\n' * 2, 'broken or cut off'),
        (os.urandom(5000), 'not an MCAP file'),
        (b'\x89MCAP0\r\n' + bytes(5000) + b'\x89MCAP0\r\n', 'broken or cut off'),
    ],
)
def test_what_is_no_recording(tmp_path, data, reason):
    assert reason in unreadable(tmp_path, data)


@pytest.mark.parametrize('opcode', range(1, 16))
@pytest.mark.parametrize('size', [0, 3, 2**31, 2**63, 2**64 - 1])
def test_absurd_sizes_in_records(tmp_path, opcode, size):
    magic = b'\x89MCAP0\r\n'
    for body in (b'', b'\xff' * 40, struct.pack('<Q', size) * 6):
        for length in (size, len(body)):
            record = bytes([opcode]) + struct.pack('<Q', length) + body
            unreadable(tmp_path, magic + record + magic)


def chunk_of(packed, claimed, compression=b'zstd'):
    """A file with one chunk, whatever it holds."""
    body = struct.pack('<QQQI', 0, 0, claimed, 0)
    body += struct.pack('<I', len(compression)) + compression
    body += struct.pack('<Q', len(packed)) + packed
    return (
        b'\x89MCAP0\r\n\x06' + struct.pack('<Q', len(body)) + body
        + b'\x0f' + struct.pack('<QI', 4, 0)
        + b'\x02' + struct.pack('<QQQI', 20, 0, 0, 0) + b'\x89MCAP0\r\n'
    )


@pytest.mark.parametrize(
    ('claimed', 'compression', 'reason'),
    [
        (1000, b'zstd', 'another size'),
        (2**40, b'zstd', 'unpacks to more'),
        (2**31, b'zstd', 'unpacks to more'),
        (2**28, b'zstd', 'a record of kind|another size|cut'),
        (1000, b'lz4', 'broken'),
        (1000, b'', 'another size'),
        (1000, b'snappy', 'compressed'),
    ],
)
def test_a_decompression_bomb_takes_no_memory(tmp_path, claimed, compression, reason):
    packed = zstandard.compress(bytes(2**26))
    tracemalloc.start()
    try:
        text = unreadable(tmp_path, chunk_of(packed, claimed, compression))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert any(part in text for part in reason.split('|'))
    assert peak < (3 * 2**26 if claimed == 2**28 else 10**6)


def file_with(change):
    """A valid MCAP file whose content is not that of a departure."""
    content = decode(encoded())
    change(content)
    return encode(content)


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        (lambda c: c.metadata.clear(), "0 metadata records 'ambush_planner'"),
        (lambda c: c.metadata.append(c.metadata[0]), "2 metadata records 'ambush_planner'"),
        (lambda c: c.metadata[0].metadata.pop('format'), "states the format ''"),
        (lambda c: c.metadata[0].metadata.update(format='9'), "states the format '9'"),
        (lambda c: c.channels[1].metadata.clear(), 'quality-of-service'),
        (lambda c: c.channels[1].metadata.update(offered_qos_profiles='['), 'quality-of-service'),
        (lambda c: c.channels[1].metadata.update(offered_qos_profiles='[' * 3999), 'quality'),
        (lambda c: c.channels[1].metadata.update(offered_qos_profiles='[' * 9999), 'quality'),
        (lambda c: c.channels[1].metadata.update(offered_qos_profiles='- history: 3'), 'quality'),
        (lambda c: setattr(c.channels[1], 'message_encoding', 'json'), 'not serialised as CDR'),
        (lambda c: setattr(c.messages[0], 'data', b'\0'), 'not serialised as CDR'),
        (lambda c: setattr(c.messages[0], 'log_time', 2**64 - 1), 'not a ROS time'),
    ],
)
def test_a_valid_file_that_is_no_departure(tmp_path, change, reason):
    text = unreadable(tmp_path, file_with(change))
    assert reason in text
    assert 'not from this planner' in text


@pytest.mark.parametrize('make', [lambda p: None, lambda p: p.mkdir(), lambda p: os.mkfifo(p)])
def test_what_is_no_file(tmp_path, make):
    path = tmp_path / 'x.mcap'
    make(path)
    with pytest.raises(UnreadableRecording) as caught:
        read_departure(path)
    assert caught.value.path == path


def test_a_file_larger_than_any_recording_is_not_read(tmp_path):
    path = tmp_path / 'x.mcap'
    with path.open('wb') as file:
        file.truncate(2**40)
    with pytest.raises(UnreadableRecording, match='more than a departure has'):
        read_departure(path)


def test_a_file_that_may_not_be_read(tmp_path):
    # /proc/self/mem opens for root too, and then refuses to be read from the start.
    with pytest.raises(UnreadableRecording):
        read_departure(Path('/proc/self/mem'))
    with pytest.raises(UnreadableRecording, match='Not a directory'):
        read_departure(Path('/proc/self/stat/x'))


def test_recordings_in_the_order_of_their_numbers(tmp_path):
    recorder = Recorder(tmp_path)
    paths = [record(recorder, small_departure()) for _ in range(11)]
    session = paths[0].parent
    assert recordings_in(paths[3]) == [paths[3]]
    assert recordings_in(session) == recordings_in(str(tmp_path)) == paths


def test_the_recorder_writes_nothing_that_readers_would_refuse(tmp_path):
    recorder = Recorder(tmp_path)
    first = record(recorder, small_departure())
    sent = small_departure()
    refused = {
        'departure': 'x', 'frame': 'f' * 300, 'route': '[1.5, 2]', 'service': 's' * 256,
        'parameters': json.dumps({'recording.directory': 'd' * 5000}),
    }
    for key, text in refused.items():
        with pytest.raises(RecordingFailed, match=f'readers would refuse it: .*{key}'):
            recorder.record_departure(sent, {**metadata_for(sent), key: text}, [STRATEGY])
    with pytest.raises(RecordingFailed, match='readers would refuse it: .*attachment'):
        recorder.record_departure(sent, metadata_for(sent), [])
    bad = Attachment(STRATEGY.name, STRATEGY.media_type, b'no strategy')
    with pytest.raises(RecordingFailed, match='readers would refuse it: .*damaged'):
        recorder.record_departure(sent, metadata_for(sent, bad), [bad])
    assert list(first.parent.glob('*.mcap')) == [first]
    assert read_departure(record(recorder, sent)).metadata.link.follows == first.name


def test_sessions_are_listed_in_the_order_of_time(tmp_path):
    names = ['run_2026_09_30-10_00_00', 'run_2026_10_01-09_00_00', 'run_2026_10_01-09_00_00-2',
             'run_2026_10_01-09_00_00-10']
    for name in reversed(names):
        (tmp_path / name).mkdir()
        (tmp_path / name / f'{name}_0.mcap').touch()
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'note.txt').touch()
    assert [path.parent.name for path in recordings_in(tmp_path)] == names


def test_a_loose_recording_hides_no_session(tmp_path):
    for name in ('run_1/run_1_0.mcap', 'run_2/run_2_0.mcap', 'one.mcap',
                 'run_1.recovered/run_1_0.mcap'):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = [path.relative_to(tmp_path).as_posix() for path in recordings_in(tmp_path)]
    assert found == ['one.mcap', 'run_1/run_1_0.mcap', 'run_2/run_2_0.mcap']


@pytest.mark.parametrize('make', [lambda p: None, lambda p: p.mkdir()])
def test_folders_without_recordings(tmp_path, make):
    path = tmp_path / 'runs'
    make(path)
    with pytest.raises(UnreadableRecording) as caught:
        recordings_in(path)
    assert caught.value.path == path
