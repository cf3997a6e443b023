# SPDX-License-Identifier: Apache-2.0
"""Recordings are read back without ROS, and what is damaged, foreign or old is named."""

import os
import shutil
import tracemalloc
from dataclasses import replace
from io import BytesIO

import lz4.frame
import numpy as np
import pytest
import zstandard
from audit_samples import departure, drawn, record, sample_plan
from forging import GET_PLAN, MOVED_GOAL, NEW_ROUTE, SEEDED, Forger
from geometry_msgs.msg import PoseArray
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.writer import Writer
from recording_samples import file_of, metadata_entries, recorded, small_departure

from ambush_planner import InvalidOption
from ambush_planner.operations.slots import Slots
from ambush_planner.recordings.encoding import FORMAT, MAGIC, encode
from ambush_planner.recordings.metadata import typed
from ambush_planner.recordings.recorded_departure import read_departure
from ambush_planner.recordings.recorded_departures import (
    read_departures,
    recordings_in,
    source_findings,
)
from ambush_planner.recordings.recording_errors import UnreadableRecording
from ambush_planner.recordings.recording_file import read_recording


def test_messages_are_read_in_the_order_of_time(tmp_path):
    stamps = (0, 2**63 - 1, 1, 1)
    sent = [recorded(f'/{k}', PoseArray(), stamp_ns=stamp) for k, stamp in enumerate(stamps)]
    path = tmp_path / 'x.mcap'
    path.write_bytes(file_of(sent))
    found = [(each.topic, each.stamp_ns) for each in read_recording(path).messages]
    assert found == sorted(found, key=lambda row: row[1]) and len(found) == 4


def test_a_departure_of_a_node(files):
    first, moved, asked = (read_departure(files[k]) for k in (NEW_ROUTE, MOVED_GOAL, GET_PLAN))
    said, moved_goal, request = (each.metadata for each in (first, moved, asked))
    assert (said.departure, said.frame, request.departure) == (1, 'map', 4)
    called = [each.call.service.rpartition('/')[2] for each in (said, request)]
    assert called == ['new_route', 'get_plan']
    assert set(said.versions) == {'ambush_planner', 'python', 'numpy', 'scipy', 'rclpy'}
    assert said.trip.start == (1.5, 5.5) and said.trip.goal == (8.5, 5.5)
    assert moved_goal.trip.goal == moved_goal.ends[1] != (5.0, 5.2)
    assert request.call.request['tolerance'] == 0.0
    assert first.drawn_from is first.trip
    for each in (first, moved, asked):
        ends = each.trip.game.network.points[each.route[0][[0, -1]]]
        trip = each.metadata.trip
        assert ends.tolist() == [[*trip.start], [*trip.goal]]
        assert [tuple(row) for row in each.path_poses[[0, -1], :2]] == [*each.metadata.ends]


def damaged(data):
    """Copies cut off, and copies with one bit changed."""
    for place in np.linspace(0, len(data) - 1, 30).astype(int):
        yield data[:place]
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(data), 60):
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(8))
        yield bytes(changed)


def test_damaged_files_are_refused_or_read_the_same(tmp_path):
    sent = small_departure()
    data = file_of(sent)
    path = tmp_path / 'x.mcap'
    path.write_bytes(data)
    whole = read_recording(path)
    refused = 0
    for changed in damaged(data):
        path.write_bytes(changed)
        try:
            found = read_recording(path)
        except UnreadableRecording as error:
            assert error.path == path and str(path) in str(error)
            refused += 1
            continue
        # A record of a kind that no reader knows.
        assert (found.entries, found.messages) == (whole.entries, whole.messages)
        assert found.attachments == whole.attachments
    assert refused > 80


def other_bag(name, **entries):
    """A bag of another program with one message and perhaps a metadata record."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start(profile='ros2')
    writer.add_metadata(name, {'format': FORMAT, **entries}) if name else None
    schema = writer.register_schema('std_msgs/msg/Header', 'ros2msg', b'string frame_id')
    writer.add_message(writer.register_channel('/a', 'cdr', schema), 1, b'', 1)
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize('name', ['', 'rosbag2', 'ambush_planner_2'])
def test_a_file_without_the_record_is_said_to_have_none(name, tmp_path):
    path = tmp_path / 'x.mcap'
    path.write_bytes(other_bag(name))
    with pytest.raises(UnreadableRecording, match='no record .*Its 1 messages can be seen'):
        read_recording(path)


@pytest.mark.parametrize(('change', 'words'), [
    (lambda data: data.replace(b'ambush_planner', b'another_tool!!'), 'damaged'),
    (lambda data: b'# a text\n' * 50, 'damaged or not an MCAP file: .* try `mcap recover`'),
])
def test_files_of_others(tmp_path, change, words):
    path = tmp_path / 'x.mcap'
    path.write_bytes(change(file_of(small_departure())))
    with pytest.raises(UnreadableRecording, match=words):
        read_recording(path)


def test_what_unpacks_to_more_than_the_memory_is_refused_before_it_does(tmp_path, monkeypatch):
    """Also where the parts are small, and where a chunk states less than it holds."""
    zeros, arrays = bytes(10**8), BytesIO()
    np.savez_compressed(arrays, **{f'a{k}': np.zeros(10**6) for k in range(8)})
    monkeypatch.setattr('ambush_planner.recordings.recording_errors.MAX_BYTES', 10**7)
    sent = small_departure()
    noise = recorded('/noise', PoseArray())
    bombs = [
        *(encode([*sent, replace(noise, data=zeros)], metadata_entries(), {}, compression)
          for compression in ('zstd', 'lz4')),
        encode(sent, metadata_entries(), {'a.npz': arrays.getvalue()}, 'none'),
        *(chunk_of(compression, pack(zeros), stated) for stated in (2 * 10**8, 1000)
          for compression, pack in (('zstd', zstandard.compress), ('lz4', lz4.frame.compress)))]
    del zeros
    assert max(map(len, bombs)) < 10**6
    for data in bombs:
        path = tmp_path / 'x.mcap'
        path.write_bytes(data)
        tracemalloc.start()
        with pytest.raises(UnreadableRecording, match='bytes of memory|damaged'):
            read_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 10**7
        tracemalloc.stop()


def chunk_of(compression, data, stated):
    """A file with one chunk, which states its size."""
    builder = RecordBuilder()
    for each in (records.Header('ros2', ''), records.Chunk(compression, data, 1, 1, 0, stated),
                 records.DataEnd(0), records.Footer(0, 0, 0)):
        each.write(builder)
    return MAGIC + builder.end() + MAGIC


def a_day(**changes):
    return {'date': '2026-12-01', 'slot': '', 'slot_drawn': False, **changes}


@pytest.mark.parametrize(('times', 'shares', 'window'), [
    ([], [], 1), (['08:00'], [], 1), (['08:00'], [0.9], 1), (['08:00', '09:00'], [1.5, -0.5], 1),
    (['08:00'], [1.0], 0), (['8 am'], [1.0], 1)])
def test_slots_that_are_none_are_refused(times, shares, window):
    slots = {'times': times, 'shares': shares, 'window': window, 'value': 1.0, 'lower_bound': 1.0}
    with pytest.raises(InvalidOption):
        typed(slots, Slots, 'slots')


@pytest.mark.parametrize(('spoil', 'words'), [
    (lambda f: f.attachments.pop('strategy.npz'), 'departure: missing or malformed'),
    (lambda f: f.set_arrays(edges=np.array([None])), 'departure: '),
    (lambda f: f.set_arrays(edge_probability=f.arrays()['edge_probability'][1:]), 'departure: '),
    (lambda f: f.entries.update(route=[[0, 10**6]]), 'departure: .*malformed'),
    (lambda f: f.entries['parameters'].pop('seed'), 'departure: seed is missing: '),
    (lambda f: f.entries.update(departure='x'), 'departure: departure is not of the type int'),
    (lambda f: f.entries.update(route_entropy_source=[0.5]), 'departure: route_entropy_source is'),
    (lambda f: f.entries.update(ends=[[1.0, 2.0]]), 'departure: ends is not of the type tuple'),
    (lambda f: f.entries['call'].update(request_ns=10**30), 'departure: request_ns is out of ra'),
    (lambda f: f.entries.update(day=a_day(date='2026-13-01')), 'departure: a date or time is not'),
    (lambda f: f.entries.update(diversion={'number': 1}), 'departure: left is missing'),
    (lambda f: f.edit('map', lambda m: m.data.pop()), 'departure: the map holds 399 cells'),
])
def test_a_part_that_cannot_be_read_is_named(files, tmp_path, spoil, words):
    forger = Forger(files[NEW_ROUTE])
    spoil(forger)
    path = forger.save(tmp_path / 'x.mcap')
    read_recording(path)
    with pytest.raises(UnreadableRecording, match=words) as caught:
        read_departure(path)
    errors = []
    assert [each.path for each in read_departures([path, files[0]], errors.append)] == [files[0]]
    assert [str(each) for each in errors] == [str(caught.value)]


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'deep').write_bytes(other_bag('ambush_planner', call='[' * 10**5))
    for path, words in ((tmp_path / 'none', 'No such file'), (tmp_path, 'Is a directory'),
                        (tmp_path / 'pipe', 'neither a file'), (tmp_path / 'deep', 'Recursion')):
        with pytest.raises(UnreadableRecording, match=words):
            read_recording(path)
    with pytest.raises(UnreadableRecording, match='no .mcap file in this folder'):
        recordings_in(tmp_path)


def test_recordings_are_listed_in_the_order_of_their_numbers(tmp_path):
    names = ['a_2/a_2_0', 'a_10/a_10_0', 'a_10/a_10_2', 'a_10/a_10_11']
    paths = [tmp_path / f'{name}.mcap' for name in names]
    for path in paths[::-1]:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    assert recordings_in(tmp_path) == paths
    assert recordings_in(tmp_path / 'a_10') == paths[1:]
    assert recordings_in(paths[0]) == paths[:1]


def test_random_sources_that_repeat_or_are_short(files, tmp_path):
    def read(path):
        return path.name, read_departure(path).metadata

    honest = [read(path) for path in files]
    assert source_findings(honest) == []
    assert source_findings([*honest, honest[0]]) == []  # a copy
    (source,) = honest[0][1].route_entropy_source
    for number, (forged, words) in enumerate({
        source: 'the same', source ^ 5: 'nearly the same', 2**190: 'fewer than 192 bits',
    }.items()):
        forger = Forger(files[1])
        forger.entries['route_entropy_source'] = [forged]
        path = forger.save(tmp_path / f'{number}.mcap')
        (finding,) = source_findings([*honest, read(path)])
        assert words in finding and str(forged) not in finding
    forger = Forger(files[SEEDED])
    forger.entries.update(departure_id='another')
    assert len(source_findings([*honest, read(forger.save(path))])) == 1


def test_departures_come_in_order_of_time_then_number_and_copies_count_once(tmp_path):
    plan = sample_plan()
    paths = record(tmp_path, [
        departure(plan, route, number, stamp_ns=stamp) for route, number, stamp in zip(
            drawn(plan, 4), (7, 3, 2, 1), (5, 0, 0, 9), strict=True)])
    shutil.copy(paths[0], tmp_path / 'copy_0.mcap')
    found = read_departures(recordings_in(tmp_path), pytest.fail)
    assert [each.metadata.departure for each in found] == [2, 3, 7, 1]
