# SPDX-License-Identifier: Apache-2.0
"""Sessions of recordings: private folders that are bags, files that are whole or not there.

What is in them is read back equal by independent readers, and complete for rosbag2.
"""

import json
import os
import random
import resource
import shutil
import signal
import stat
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
import zstandard
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import PoseArray
from mcap.reader import make_reader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from recording_samples import (
    ATTACHMENTS,
    START_NS,
    assert_departure,
    departure,
    fields,
    metadata_entries,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    recorded,
    risk_map,
    small_departure,
)
from std_msgs.msg import Header
from waiting import TIMEOUT

from ambush_planner.errors import AmbushPlannerError
from ambush_planner.recordings.messages import qos_text
from ambush_planner.recordings.recorder import Recorder, prepare
from ambush_planner.recordings.recording_errors import RecordingFailed
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.schemas import definitions


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def bag_information(folder):
    text = (folder / 'metadata.yaml').read_text()
    return yaml.safe_load(text)['rosbag2_bagfile_information']


def listed(folder):
    return bag_information(folder)['relative_file_paths']


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
    assert mode(session.parent.parent) == mode(session.parent) == mode(session) == 0o700
    assert {p.name: mode(p) for p in session.iterdir()} == {
        path.name: 0o600, 'metadata.yaml': 0o600}


def test_a_session_is_one_bag_with_one_file_per_departure(tmp_path):
    recorder = Recorder(tmp_path)
    first, second = departure(), departure(START_NS + 60_000_000_000)
    paths = [record(recorder, sent) for sent in (first, second)]
    session = paths[0].parent
    names = [f'{session.name}_{n}.mcap' for n in (0, 1)]
    assert [p.name for p in paths] == names
    assert_departure(first + second, read_with_rosbags(session))
    information = bag_information(session)
    assert (information['version'], information['storage_identifier']) == (9, 'mcap')
    assert (information['message_count'], information['relative_file_paths']) == (12, names)
    assert [each['message_count'] for each in information['files']] == [6, 6]
    assert [t['message_count'] for t in information['topics_with_message_count']] == [2] * 6


def test_a_file_in_place_of_the_directory_is_an_error(tmp_path):
    occupied = tmp_path / 'runs'
    occupied.write_text('mine')
    for directory in (occupied, occupied / 'below'):
        with pytest.raises(RecordingFailed, match='check that recording.directory') as caught:
            record(Recorder(directory), departure())
        assert caught.value.path == directory
        assert isinstance(caught.value, AmbushPlannerError)
    assert occupied.read_text() == 'mine'


def test_a_full_disk_leaves_no_partial_file_and_recording_resumes(tmp_path):
    recorder = Recorder(tmp_path)
    session = record(recorder, small_departure()).parent
    before = {path: path.read_bytes() for path in session.iterdir()}
    with disk_full_after(1000), pytest.raises(RecordingFailed, match='File too large'):
        record(recorder, small_departure())
    assert {path: path.read_bytes() for path in session.iterdir()} == before
    record(recorder, small_departure())
    assert len(listed(session)) == 2 == len(read_with_rosbags(session)) // 6


def test_recording_goes_on_after_files_and_folders_are_deleted(tmp_path):
    recorder = Recorder(tmp_path / 'runs')
    record(recorder, departure()).unlink()
    path = record(recorder, departure())
    assert listed(path.parent) == [path.name]
    shutil.rmtree(tmp_path / 'runs')
    path = record(recorder, departure())
    assert path.name == f'{path.parent.name}_0.mcap'
    shutil.rmtree(path.parent)


# What is in a file.


def summary_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_files_read_back_equal_in_independent_readers_and_large_messages_are_compressed_once(
        tmp_path, compression, monkeypatch):
    large, compress = [], zstandard.compress
    monkeypatch.setattr(zstandard, 'compress', lambda data, *level: (
        large.append(len(data)) if len(data) > 2**14 else None, compress(data, *level))[1])
    recorder, sent = Recorder(tmp_path / 'runs', compression), departure()
    for later in (0, 60 * 10**9, -1):
        again = [replace(each, stamp_ns=each.stamp_ns + later) for each in sent]
        path = record(recorder, again)
        for found in (read_with_mcap_ros2(path), read_with_rosbags(path)):
            assert_departure(again, found)
        assert [fields(each) for each in read_recording(path).messages] == [*map(fields, again)]
    assert len(large) == (compression == 'zstd')
    chunks = summary_of(path).chunk_indexes
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}
    sent[0] = replace(sent[0], data=recorded('/alpha_map', risk_map(200, 100)).data)
    assert_departure(sent, read_with_mcap_ros2(record(recorder, sent)))


def test_header_metadata_record_and_attachments(tmp_path):
    path = record(Recorder(tmp_path), departure(start_ns=0))
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        ((name, entries),) = [(each.name, each.metadata) for each in reader.iter_metadata()]
        (found,) = reader.iter_attachments()
    assert name == 'ambush_planner'
    read = {key: json.loads(text) for key, text in entries.items()}
    assert read == {'format': 11, **metadata_entries()}
    assert {found.name: found.data} == ATTACHMENTS and found.log_time == 0


def test_definitions_are_those_installed():
    for name, definition in definitions().items():
        package, kind, short = name.split('/')
        file = Path(sys.prefix, 'share', package, kind, f'{short}.json')
        if not file.is_file():
            file = Path(get_package_share_directory(package), kind, file.name)
        hashes = json.loads(file.read_text())['type_hashes']
        assert definition.type_hash in [each['hash_string'] for each in hashes
                                        if each['type_name'] == name]
        lines = [line.partition('#')[0].rstrip()
                 for line in file.with_suffix('.msg').read_text().splitlines()]
        assert definition.text.splitlines()[:sum(map(bool, lines))] == [*filter(None, lines)]


def test_qos_profiles_are_complete():
    """As rosbag2 demands, and as rclpy has them."""
    (profile,) = yaml.safe_load(qos_text(5, latched=True))
    qos = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    for name, value in profile.items():
        theirs = getattr(qos, name)
        if isinstance(value, dict):
            assert value == infinite and theirs == Duration()  # unspecified, so DDS' own
        elif name == 'liveliness':
            assert (value, theirs.short_key) == ('automatic', 'system_default')
        else:
            assert value == getattr(theirs, 'short_key', theirs), name
    assert {f'_{name}' for name in profile} == {*QoSProfile.__slots__}


def record_until_killed(directory):
    """Never returns; a departure takes long enough to be interrupted half written."""
    try:
        text = random.Random(1).randbytes(150_000).hex()
        noise = recorded('/noise', PoseArray(header=Header(frame_id=text)))
        recorder = Recorder(directory, 'none')
        while True:
            record(recorder, [*small_departure(), noise])
    finally:
        os._exit(1)


def kill_while_recording(directory, seconds):
    """Let a child process record, and kill it that long after its first file is begun."""
    before = set(directory.rglob('*'))
    child = os.fork()
    if not child:
        record_until_killed(directory)
    deadline = time.monotonic() + TIMEOUT
    while not any(path.is_file() for path in set(directory.rglob('*')) - before):
        assert time.monotonic() < deadline
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL


def test_named_files_are_whole_whatever_a_kill_interrupts(tmp_path, request):
    kills = 3 * request.config.getoption('--kills')  # they cost less than whole nodes
    paths = [str(Path(__file__).parents[1]), os.environ.get('PYTHONPATH', '')]
    # Forked in a process of its own, which has no other threads.
    subprocess.run([sys.executable, __file__, str(tmp_path), str(kills)], check=True,
                   timeout=10 * TIMEOUT, env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)})
    sessions = list(tmp_path.iterdir())
    assert len(sessions) == kills
    for session in sessions:
        for path in session.glob('*.mcap'):
            assert_departure(small_departure(), [
                row for row in read_with_mcap_ros2(path) if row[0] != '/noise'
            ])
            assert len(read_with_rosbags(path)) == 7
        if (session / 'metadata.yaml').exists():
            read_with_rosbags(session)
    left = list(tmp_path.rglob('*.tmp'))
    assert prepare(tmp_path) == []  # another node might be writing them
    for path in left:
        os.utime(path, (0.0, 0.0))
    assert sorted(prepare(tmp_path)) == sorted(left)
    assert not list(tmp_path.rglob('*.tmp'))


if __name__ == '__main__':
    pauses = random.Random(5)
    for _ in range(int(sys.argv[2])):
        kill_while_recording(Path(sys.argv[1]), pauses.uniform(0, 0.02))
