"""Recording where the disk, the folder or the clock fails: an error, or a valid file."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from recording_samples import (
    START_NS,
    assert_departure,
    departure,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    recorded,
    small_departure,
)
from std_msgs.msg import Header, String
from waiting import TIMEOUT

from ambush_planner.recordings import Recorder, RecordingFailed, read_departure
from ambush_planner.recordings import recorder as recorder_module
from ambush_planner.recordings.mcap_file import decode
from ambush_planner.recordings.repair import repair
from ambush_planner.recordings.schemas import load_definition

NOBODY = 65534


def listed(folder):
    document = yaml.safe_load((folder / 'metadata.yaml').read_text())
    return document['rosbag2_bagfile_information']['relative_file_paths']


@contextmanager
def small_disk(folder, size):
    """A file system of this size on ``folder``."""
    options = ['-t', 'tmpfs', '-o', f'size={size}', 'none', str(folder)]
    done = subprocess.run(['mount', *options], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f'only a privileged user may mount: {done.stderr.strip()}')
    try:
        yield
    finally:
        subprocess.run(['umount', '-l', str(folder)], check=True)


@contextmanager
def as_nobody():
    """Without the privileges of root, on whom permissions have no hold."""
    for message in small_departure():
        load_definition(message.type)  # the interface files may lie where nobody may look
    if os.geteuid() == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(os.getuid())


@pytest.fixture
def open_folder():
    """A folder that an unprivileged user owns and reaches."""
    folder = Path(tempfile.mkdtemp(prefix='ambush_planner_test_'))
    if os.geteuid() == 0:
        os.chown(folder, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder)


def test_a_full_disk(tmp_path):
    with small_disk(tmp_path, '64k'):
        recorder = Recorder(tmp_path, 'none')
        kept = [record(recorder, small_departure())]
        with pytest.raises(RecordingFailed, match='No space left.*check that recording.directory'):
            while True:
                kept.append(record(recorder, small_departure()))
        session = kept[0].parent
        assert not list(session.glob('*.tmp'))
        assert set(listed(session)) <= {path.name for path in session.glob('*.mcap')}
        for path in session.glob('*.mcap'):
            assert_departure(small_departure(), read_with_rosbags(path))
        kept.pop(0).unlink()
        recorder.close()
        again = record(Recorder(tmp_path, 'zstd'), small_departure())
        assert len(read_departure(again).messages) == 4


def test_a_file_size_limit_in_a_process_of_its_own(tmp_path):
    # Works for everybody: the limit holds for root too, and ends with the process.
    assert 'File too large' in in_a_process_of_its_own('fill', tmp_path)
    (session,) = tmp_path.iterdir()
    assert list(session.iterdir()) == []


def test_a_folder_that_may_not_be_written(open_folder):
    with as_nobody():
        recorder = Recorder(open_folder)
        session = record(recorder, small_departure()).parent
        session.chmod(0o500)
        with pytest.raises(RecordingFailed, match='Permission denied') as caught:
            record(recorder, small_departure())
        assert caught.value.path.parent == session
        session.chmod(0o700)
        later = record(recorder, small_departure())
        assert listed(session) == [f'{session.name}_0.mcap', later.name]
        open_folder.chmod(0o500)
        with pytest.raises(RecordingFailed, match='Permission denied'):
            record(Recorder(open_folder), small_departure())
        with pytest.raises(RecordingFailed):
            record(Recorder(Path('/proc/runs')), small_departure())


def test_a_repair_that_may_not_write_reports_it(open_folder):
    with as_nobody():
        with Recorder(open_folder) as recorder:
            session = record(recorder, small_departure()).parent
        (session / 'metadata.yaml').unlink()
        session.chmod(0o500)
        (failed,) = repair(open_folder)
        assert (failed.action, failed.path) == ('failed', session)
        assert 'Permission denied' in failed.detail
        session.chmod(0o000)
        assert [each.action for each in repair(open_folder)] == ['failed']
        session.chmod(0o700)
        assert [each.action for each in repair(open_folder)] == ['listed']


def test_a_file_in_place_of_the_session_folder(tmp_path):
    recorder = Recorder(tmp_path)
    session = record(recorder, small_departure()).parent
    shutil.rmtree(session)
    session.write_text('mine')
    path = record(recorder, small_departure())
    assert session.read_text() == 'mine'
    assert path.parent != session
    assert_departure(small_departure(), read_with_rosbags(path.parent))


def test_another_folder_in_place_of_the_session_folder(tmp_path):
    recorder = Recorder(tmp_path)
    session = record(recorder, small_departure()).parent
    session.rename(tmp_path / 'kept')
    session.mkdir()
    path = record(recorder, small_departure())
    assert path.parent not in (session, tmp_path / 'kept')
    assert list(session.iterdir()) == []
    assert listed(tmp_path / 'kept') == [f'{session.name}_0.mcap']


def test_a_folder_in_place_of_the_next_file(tmp_path):
    recorder = Recorder(tmp_path)
    session = record(recorder, small_departure()).parent
    (session / f'{session.name}_1.mcap' / 'x').mkdir(parents=True)
    with pytest.raises(RecordingFailed, match='directory'):
        record(recorder, small_departure())
    assert not list(session.glob('*.tmp'))
    path = record(recorder, small_departure())
    assert listed(session) == [f'{session.name}_0.mcap', path.name]


class StoppedClock:
    """The wall clock of a machine without a battery: every session begins at the same time."""

    @staticmethod
    def now(tz):
        return datetime(1970, 1, 1, tzinfo=tz)


def test_sessions_that_begin_at_the_same_time(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, 'datetime', StoppedClock)
    paths = [record(Recorder(tmp_path), small_departure()) for _ in range(3)]
    name = 'ambush_planner_1970_01_01-00_00_00'
    assert [path.parent.name for path in paths] == [name, f'{name}-2', f'{name}-3']
    assert [path.name for path in paths] == [f'{path.parent.name}_0.mcap' for path in paths]


def test_sessions_are_in_order_where_clocks_are_put_back(tmp_path, monkeypatch):
    monkeypatch.setenv('TZ', 'Europe/Berlin')
    time.tzset()
    paths = []
    try:
        # The last Sunday of October: half past two, two, and half past two again.
        for second in (1792888200, 1792890000, 1792891800):
            clock = SimpleNamespace(now=lambda tz, at=second: datetime.fromtimestamp(at, tz))
            monkeypatch.setattr(recorder_module, 'datetime', clock)
            paths.append(record(Recorder(tmp_path), small_departure()))
    finally:
        monkeypatch.undo()
        time.tzset()
    follows = [read_departure(path).metadata.link.follows for path in paths]
    assert follows == ['', *(path.name for path in paths[:2])]


@pytest.mark.parametrize('stamps', [(5, 4, 3, 2), (0, 0, 0, 0), (7, 0, 7, 0), (0, 2**63 - 1, 1, 1)])
def test_stamps_out_of_order_equal_or_zero(tmp_path, stamps):
    sent = [
        recorded(message.topic, Header(frame_id=message.topic), stamp_ns=stamp)
        for message, stamp in zip(small_departure(), stamps, strict=True)
    ]
    recorder = Recorder(tmp_path)
    paths = [record(recorder, sent) for _ in range(2)]
    in_order = sorted(sent, key=lambda message: message.stamp_ns)
    expected = [(message.topic, message.stamp_ns) for message in in_order]
    for path in paths:
        read = read_departure(path)
        assert [(m.topic, m.stamp_ns) for m in read.messages] == expected
        assert sorted(row[:2] for row in read_with_mcap_ros2(path)) == sorted(expected)
        assert sorted(row[:2] for row in read_with_rosbags(path)) == sorted(expected)
    assert len(read_with_rosbags(path.parent)) == 2 * len(sent)


def test_a_clock_that_goes_backwards_between_departures(tmp_path):
    recorder = Recorder(tmp_path)
    for start_ns in (START_NS, START_NS - 10**12, 0):
        path = record(recorder, departure(start_ns))
    information = yaml.safe_load((path.parent / 'metadata.yaml').read_text())
    information = information['rosbag2_bagfile_information']
    assert information['starting_time'] == {'nanoseconds_since_epoch': 0}
    assert information['duration'] == {'nanoseconds': START_NS + 5_000_000}
    assert len(read_with_rosbags(path.parent)) == 18


def record_until_killed(directory):
    """Never returns; a departure is large enough to be met half written."""
    try:
        noise = recorded('/noise', String(data=random.Random(1).randbytes(150_000).hex()))
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


def in_a_process_of_its_own(*arguments):
    """Run this file as a program; return what it prints."""
    paths = [str(Path(__file__).parents[1]), os.environ.get('PYTHONPATH', '')]
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(paths)}
    command = [sys.executable, __file__, *map(str, arguments)]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_whatever_a_kill_interrupts_named_files_are_whole_and_the_rest_is_repaired(
        tmp_path, request):
    kills = 3 * request.config.getoption('--kills')  # they cost less than whole nodes
    # Forked there, where there are no threads.
    in_a_process_of_its_own('kill', tmp_path, kills)
    sessions = list(tmp_path.iterdir())
    assert len(sessions) == kills
    finished = {path for session in sessions for path in session.glob('*.mcap')}
    for path in finished:
        assert_departure(small_departure(), [
            row for row in read_with_mcap_ros2(path) if row[0] != '/noise'
        ])
        assert len(read_with_rosbags(path)) == 5
    for session in sessions:
        if (session / 'metadata.yaml').exists():
            assert {session / name for name in listed(session)} <= finished
            read_with_rosbags(session)
    done = repair(tmp_path)
    assert not [each for each in done if each.action == 'failed']
    assert not list(tmp_path.rglob('*.tmp'))
    assert finished <= set(tmp_path.rglob('*.mcap'))
    for session in sessions:
        recordings = {path.name for path in session.glob('*.mcap')}
        for path in session.glob('*.mcap'):
            decode(path.read_bytes())
        if recordings:
            assert set(listed(session)) == recordings
            assert len(read_with_rosbags(session)) >= len(recordings)
    assert repair(tmp_path) == []


def record_with_a_limit(directory):
    """Print the error of recording where no file may be longer than 1000 bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
    try:
        record(Recorder(directory), small_departure())
    except RecordingFailed as error:
        print(error)


if __name__ == '__main__':
    if sys.argv[1] == 'fill':
        record_with_a_limit(Path(sys.argv[2]))
    else:
        pauses = random.Random(5)
        for _ in range(int(sys.argv[3])):
            kill_while_recording(Path(sys.argv[2]), pauses.uniform(0, 0.02))
