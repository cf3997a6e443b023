"""Sessions of recordings: private folders that are bags, and files that are whole or not there."""

import os
import resource
import shutil
import stat
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from recording_samples import (
    LATCHED,
    START_NS,
    VOLATILE,
    assert_departure,
    departure,
    pose,
    read_with_rosbags,
    record,
    recorded,
    small_departure,
)

from ambush_planner.errors import AmbushPlannerError, InvalidOption
from ambush_planner.recordings import Recorder, RecordingFailed, recordings_in
from ambush_planner.recordings import recorder as recorder_module


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def bag_information(folder):
    text = (folder / 'metadata.yaml').read_text()
    return yaml.safe_load(text)['rosbag2_bagfile_information']


@contextmanager
def disk_full_after(size):
    """Let the system refuse to write files longer than ``size`` bytes (root too)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_folders_and_files_are_private_and_named_like_those_of_rosbag2(tmp_path):
    path = record(Recorder(tmp_path / 'some' / 'runs'), departure())
    session = path.parent
    assert session.parent == tmp_path / 'some' / 'runs'
    assert path.name == f'{session.name}_0.mcap'
    assert mode(session.parent) == mode(session) == 0o700
    assert {p.name: mode(p) for p in session.iterdir()} == {
        path.name: 0o600,
        'metadata.yaml': 0o600,
    }


def test_new_folders_above_are_private_and_on_the_disk(tmp_path, monkeypatch):
    flushed = []

    def watched(descriptor, fsync=os.fsync):
        flushed.append(Path(os.readlink(f'/proc/self/fd/{descriptor}')))
        fsync(descriptor)

    monkeypatch.setattr(os, 'fsync', watched)
    directory = tmp_path / 'on' / 'a' / 'disk'
    record(Recorder(directory), departure())
    above = [tmp_path / 'on', tmp_path / 'on' / 'a', directory]
    assert [mode(folder) for folder in above] == [0o700] * 3
    # The folder that holds each new name, from the top.
    assert flushed[:4] == [tmp_path, *above]


def test_a_session_is_one_bag_with_a_file_a_departure(tmp_path):
    recorder = Recorder(tmp_path)
    first, second = departure(), departure(START_NS + 60_000_000_000)
    paths = [record(recorder, sent) for sent in (first, second)]
    session = paths[0].parent
    assert [p.name for p in paths] == [f'{session.name}_{n}.mcap' for n in (0, 1)]
    assert_departure(first + second, read_with_rosbags(session))
    for sent, path in zip((first, second), paths, strict=True):
        assert_departure(sent, read_with_rosbags(path))


def test_metadata_yaml_has_every_key_of_version_9(tmp_path):
    recorder = Recorder(tmp_path)
    for start_ns in (START_NS, START_NS + 60_000_000_000):
        session = record(recorder, departure(start_ns)).parent
    information = bag_information(session)
    names = [f'{session.name}_{n}.mcap' for n in (0, 1)]
    topics = information.pop('topics_with_message_count')
    files = information.pop('files')
    assert isinstance(information.pop('ros_distro'), str)
    assert information == {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': 60_005_000_000},
        'starting_time': {'nanoseconds_since_epoch': START_NS},
        'message_count': 12,
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': names,
        'custom_data': {},
    }
    assert [f['path'] for f in files] == names
    assert files[1] == {
        'path': names[1],
        'starting_time': {'nanoseconds_since_epoch': START_NS + 60_000_000_000},
        'duration': {'nanoseconds': 5_000_000},
        'message_count': 6,
    }
    assert [t['message_count'] for t in topics] == [2] * 6
    keys = 'name type serialization_format offered_qos_profiles type_description_hash'
    assert {frozenset(t['topic_metadata']) for t in topics} == {frozenset(keys.split())}


def test_a_topic_whose_qos_changes_stays_readable_in_the_folder(tmp_path):
    recorder = Recorder(tmp_path)
    sent = [
        recorded('/start_pose', pose(1.0, 2.0), qos, START_NS + i)
        for i, qos in enumerate((VOLATILE, LATCHED))
    ]
    for message in sent:
        session = record(recorder, [message]).parent
    found = [row for row in read_with_rosbags(session) if row[0] == '/start_pose']
    assert_departure(sent, found)


def test_recorders_of_the_same_second_do_not_clash(tmp_path):
    recorders = [Recorder(tmp_path) for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        jobs = [pool.submit(record, r, departure()) for r in recorders]
        paths = [job.result() for job in jobs]
    assert len({path.parent for path in paths}) == 8
    for path in paths:
        assert_departure(departure(), read_with_rosbags(path.parent))


def test_departures_from_several_threads_share_one_session(tmp_path):
    recorder = Recorder(tmp_path)
    with ThreadPoolExecutor(8) as pool:
        jobs = [pool.submit(record, recorder, departure()) for _ in range(16)]
        paths = {job.result() for job in jobs}
    (session,) = tmp_path.iterdir()
    assert paths == {session / f'{session.name}_{n}.mcap' for n in range(16)}
    assert bag_information(session)['message_count'] == 16 * 6


def test_a_directory_that_is_a_file(tmp_path):
    occupied = tmp_path / 'runs'
    occupied.write_text('mine')
    for directory in (occupied, occupied / 'below'):
        with pytest.raises(RecordingFailed, match='check that recording.directory') as caught:
            record(Recorder(directory), departure())
        assert caught.value.path == directory
        assert isinstance(caught.value, AmbushPlannerError)
    assert occupied.read_text() == 'mine'


def test_a_full_disk_leaves_nothing_half_written_and_recording_resumes(tmp_path):
    recorder = Recorder(tmp_path, 'none')
    first = record(recorder, departure())
    session = first.parent
    before = {p: p.read_bytes() for p in session.iterdir()}
    with disk_full_after(1000), pytest.raises(RecordingFailed, match='File too large') as caught:
        record(recorder, departure())
    assert caught.value.path == session / f'{session.name}_1.mcap'
    assert {p: p.read_bytes() for p in session.iterdir()} == before
    third = record(recorder, departure())
    assert third.name == f'{session.name}_2.mcap'
    assert bag_information(session)['relative_file_paths'] == [first.name, third.name]
    assert_departure(departure() * 2, read_with_rosbags(session))


def test_a_full_disk_at_the_metadata_keeps_the_file_and_the_old_metadata(tmp_path):
    recorder = Recorder(tmp_path)
    first = record(recorder, small_departure())
    session = first.parent
    for _ in range(80):  # until the metadata alone is longer than a departure
        record(recorder, small_departure())
    limit = first.stat().st_size + 500
    assert (session / 'metadata.yaml').stat().st_size > limit
    with disk_full_after(limit), pytest.raises(RecordingFailed, match='metadata.yaml'):
        record(recorder, small_departure())
    assert not list(session.glob('*.tmp'))
    assert bag_information(session)['message_count'] == 4 * 81
    assert len(read_with_rosbags(session / f'{session.name}_81.mcap')) == 4
    record(recorder, small_departure())
    assert bag_information(session)['message_count'] == 4 * 83


def test_a_session_that_is_full_is_followed_by_a_new_one(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, 'MOST_FILES', 3)
    with Recorder(tmp_path) as recorder:
        paths = [record(recorder, departure()) for _ in range(7)]
    folders = list(dict.fromkeys(path.parent for path in paths))
    assert [len(list(folder.glob('*.mcap'))) for folder in folders] == [3, 3, 1]
    assert all(len(read_with_rosbags(folder)) for folder in folders)
    assert recordings_in(tmp_path) == paths


def test_a_session_folder_that_was_taken_away_is_followed_by_a_new_one(tmp_path):
    recorder = Recorder(tmp_path / 'runs')
    record(recorder, departure())
    shutil.rmtree(tmp_path / 'runs')
    path = record(recorder, departure())
    assert path.name == f'{path.parent.name}_0.mcap'
    assert_departure(departure(), read_with_rosbags(path.parent))


def test_a_file_that_was_taken_away_leaves_the_metadata(tmp_path):
    recorder = Recorder(tmp_path)
    record(recorder, departure()).unlink()
    path = record(recorder, departure())
    assert bag_information(path.parent)['relative_file_paths'] == [path.name]
    assert_departure(departure(), read_with_rosbags(path.parent))


def test_a_link_in_place_of_the_temporary_file_is_not_followed(tmp_path):
    recorder = Recorder(tmp_path / 'runs')
    session = record(recorder, departure()).parent
    victim = tmp_path / 'victim'
    victim.write_text('mine')
    (session / f'{session.name}_1.mcap.tmp').symlink_to(victim)
    path = record(recorder, departure())
    assert victim.read_text() == 'mine'
    assert not path.is_symlink()
    assert_departure(departure(), read_with_rosbags(path))


def test_wrong_arguments_are_refused(tmp_path):
    with pytest.raises(InvalidOption, match="'gzip' is not one of zstd, lz4, none"):
        Recorder(tmp_path, 'gzip')
    with pytest.raises(ValueError, match='without messages'):
        record(Recorder(tmp_path), [])
    assert not list(tmp_path.iterdir())
