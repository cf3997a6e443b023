"""Session folders after a crash: put right at the next start, without touching living ones."""

import errno
import os
import random
import shutil

import pytest
import yaml
from recording_samples import (
    file_of,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    small_departure,
)
from rosbags.highlevel import AnyReader

from ambush_planner.recordings import Recorder, recordings_in
from ambush_planner.recordings import repair as repairing
from ambush_planner.recordings.folder_lock import FolderLock
from ambush_planner.recordings.repair import repair


@pytest.fixture
def session(tmp_path):
    """The folder of a session with three departures that has ended."""
    with Recorder(tmp_path / 'runs') as recorder:
        paths = [record(recorder, small_departure()) for _ in range(3)]
    return paths[0].parent


def actions(done):
    return sorted((each.action, each.path.name) for each in done)


def assert_in_order(session, departures):
    names = sorted(path.name for path in session.iterdir())
    assert not [name for name in names if name.endswith('.tmp')]
    listed = yaml.safe_load((session / 'metadata.yaml').read_text())
    listed = listed['rosbag2_bagfile_information']['relative_file_paths']
    assert sorted(listed) == [name for name in names if name.endswith('.mcap')]
    assert len(read_with_rosbags(session)) == 4 * departures
    assert repair(session.parent) == []


def test_a_session_in_order_is_left_alone(session):
    def state():
        return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in session.iterdir()}

    before = state()
    assert repair(session.parent) == []
    assert state() == before


def test_a_whole_temporary_file_gets_its_name(session):
    whole = session / f'{session.name}_2.mcap'
    left = session / f'{session.name}_7.mcap.tmp'
    shutil.copy(whole, left)
    done = repair(session.parent)
    assert actions(done) == [('finished', f'{session.name}_7.mcap'), ('listed', 'metadata.yaml')]
    assert left.with_suffix('').read_bytes() == whole.read_bytes()
    assert_in_order(session, 4)


def test_of_a_partial_temporary_file_the_whole_messages_are_kept(session):
    data = (session / f'{session.name}_2.mcap').read_bytes()
    left = session / f'{session.name}_3.mcap.tmp'
    left.write_bytes(data[:-200])
    done = repair(session.parent)
    assert actions(done) == [('finished', f'{session.name}_3.mcap'), ('listed', 'metadata.yaml')]
    assert '4 messages' in str(done[0])
    assert len(read_with_mcap_ros2(left.with_suffix(''))) == 4
    assert_in_order(session, 4)


@pytest.mark.parametrize('size', [0, 1, 8, 100, 400])
def test_a_temporary_file_without_a_whole_message_is_removed(session, size):
    data = (session / f'{session.name}_2.mcap').read_bytes()
    (session / f'{session.name}_3.mcap.tmp').write_bytes(data[:size])
    assert actions(repair(session.parent)) == [('removed', f'{session.name}_3.mcap.tmp')]
    assert_in_order(session, 3)


def test_a_temporary_metadata_file_and_links_are_removed(session):
    (session / 'metadata.yaml.tmp').write_text('rosbag2')
    victim = session.parent.parent / 'victim.mcap'
    victim.write_text('mine')
    (session / f'{session.name}_3.mcap.tmp').symlink_to(victim)
    assert [each.action for each in repair(session.parent)] == ['removed', 'removed']
    assert victim.read_text() == 'mine'
    assert_in_order(session, 3)


def test_no_file_is_overwritten(session):
    taken = session / f'{session.name}_2.mcap'
    before = taken.read_bytes()
    shutil.copy(session / f'{session.name}_1.mcap', session / f'{taken.name}.tmp')
    assert ('finished', f'{session.name}_2-2.mcap') in actions(repair(session.parent))
    assert taken.read_bytes() == before
    assert_in_order(session, 4)


@pytest.mark.parametrize('text', [None, '', '{', '[' * 9999, 'x: 1', '\xff\0'])
def test_metadata_that_is_missing_or_unreadable_is_rebuilt(session, text):
    path = session / 'metadata.yaml'
    before = yaml.safe_load(path.read_text())
    if text is None:
        path.unlink()
    else:
        path.write_text(text)
    assert actions(repair(session.parent)) == [('listed', 'metadata.yaml')]
    assert yaml.safe_load(path.read_text()) == before
    assert path.stat().st_mode & 0o777 == 0o600


def test_metadata_that_lists_other_files_than_there_are_is_rebuilt(session):
    (session / f'{session.name}_1.mcap').unlink()
    assert actions(repair(session.parent)) == [('listed', 'metadata.yaml')]
    assert_in_order(session, 2)


def test_a_broken_file_keeps_its_name_and_is_not_listed(session):
    broken = session / f'{session.name}_9.mcap'
    data = (session / f'{session.name}_2.mcap').read_bytes()
    broken.write_bytes(data[:-30])
    (session / 'metadata.yaml').unlink()
    (done,) = repair(session.parent)
    assert done.action == 'listed' and 'ambush_recover' in str(done) and broken.name in str(done)
    assert broken.read_bytes() == data[:-30]
    assert len(read_with_rosbags(session)) == 4 * 3
    assert repair(session.parent) == []


def test_nothing_that_has_its_name_is_ever_renamed_or_changed(session):
    """Whole recordings, also such as the readers refuse for their content, and all others."""
    (session / f'{session.name}_4.mcap').write_bytes(file_of(small_departure(), format='99'))
    (session / f'{session.name}_5.mcap').write_bytes(b'of another program')
    (session / f'{session.name}_6.mcap').touch()
    (session / 'metadata.yaml').unlink()
    before = {path.name: path.read_bytes() for path in session.iterdir()}
    repair(session.parent)
    after = {path.name: path.read_bytes() for path in session.iterdir()}
    after.pop('metadata.yaml')
    assert after == before


def test_when_the_list_cannot_be_written_the_old_one_stays(session, monkeypatch):
    (session / f'{session.name}_1.mcap').unlink()
    before = (session / 'metadata.yaml').read_bytes()

    def full(path, data):
        raise OSError(errno.ENOSPC, 'No space left on device')

    with monkeypatch.context() as patch:
        patch.setattr(repairing, 'write_durably', full)
        assert [each.action for each in repair(session.parent)] == ['failed']
    assert (session / 'metadata.yaml').read_bytes() == before
    assert actions(repair(session.parent)) == [('listed', 'metadata.yaml')]
    assert_in_order(session, 2)


def test_a_name_that_yaml_cannot_hold_is_no_hindrance(session):
    odd = session / os.fsdecode(b'a\xff.mcap')
    shutil.copy(session / f'{session.name}_0.mcap', odd)
    assert repair(session.parent) == []
    (session / f'{session.name}_2.mcap').unlink()
    assert actions(repair(session.parent)) == [('listed', 'metadata.yaml')]
    assert odd.exists()
    assert len(read_with_rosbags(session)) == 8
    assert repair(session.parent) == []


def test_whatever_bits_have_changed_the_folder_is_a_bag_afterwards(session):
    generator = random.Random(3)
    whole = (session / f'{session.name}_0.mcap').read_bytes()
    for _ in range(20):
        # One that was just renamed when the power went, one that was not yet: broken anywhere.
        for name in ('3.mcap', '3b.mcap.tmp'):
            data = bytearray(whole)
            place = generator.randrange(8 * len(data))
            data[place // 8] ^= 1 << place % 8
            (session / f'{session.name}_{name}').write_bytes(data)
        done = repair(session.parent)
        assert 'failed' not in {each.action for each in done}
        assert repair(session.parent) == []
        with AnyReader([session]) as reader:
            assert reader.message_count >= 12
        for path in session.glob(f'{session.name}_3*'):
            path.unlink()


def test_when_no_recording_is_left_no_metadata_is(session):
    for path in session.glob('*.mcap'):
        path.unlink()
    assert actions(repair(session.parent)) == [('listed', 'metadata.yaml')]
    assert list(session.iterdir()) == []
    assert repair(session.parent) == []


def test_the_folder_of_a_living_recorder_is_left_alone(tmp_path):
    with Recorder(tmp_path) as recorder:
        path = record(recorder, small_departure())
        left = path.with_name(f'{path.parent.name}_1.mcap.tmp')
        left.write_bytes(b'being written')
        assert repair(tmp_path) == []
        assert left.read_bytes() == b'being written'
    assert actions(repair(tmp_path)) == [('removed', left.name)]


def test_the_lock_ends_with_close_with_the_recorder_and_with_the_session(tmp_path):
    recorder = Recorder(tmp_path)
    first = record(recorder, small_departure()).parent
    with pytest.raises(BlockingIOError):
        FolderLock(first, wait=False)
    recorder.close()
    recorder.close()
    FolderLock(first, wait=False).release()
    second = record(recorder, small_departure()).parent
    assert second != first
    with pytest.raises(BlockingIOError):
        FolderLock(second, wait=False)
    del recorder
    FolderLock(second, wait=False).release()


def test_one_bad_folder_does_not_keep_others_from_being_repaired(session):
    bad = session.with_name(f'{session.name}-bad')
    shutil.copytree(session, bad)
    (bad / 'metadata.yaml').unlink()
    (bad / 'metadata.yaml').mkdir()  # cannot be replaced by a file, not even by root
    shutil.copytree(session, session.with_name(f'{session.name}-last'))
    (session.with_name(f'{session.name}-last') / 'metadata.yaml').unlink()
    done = repair(session.parent)
    assert actions(done) == [('failed', bad.name), ('listed', 'metadata.yaml')]
    assert 'directory' in str(done[0])


def test_only_folders_of_sessions_are_touched(session):
    other = session.with_name('my_bag')
    shutil.copytree(session, other)
    (other / 'x.mcap.tmp').touch()
    (session.parent / f'{session.name}.tmp').touch()
    (session.parent / f'{session.name}-link').symlink_to(other)
    assert repair(session.parent) == []
    assert (other / 'x.mcap.tmp').exists()


def test_directories_that_are_missing_or_files(tmp_path):
    assert repair(tmp_path / 'none') == []
    (tmp_path / 'file').touch()
    (failed,) = repair(tmp_path / 'file')
    assert (failed.action, failed.path) == ('failed', tmp_path / 'file')


def test_recordings_are_found_after_a_repair(session):
    (session / f'{session.name}_10.mcap.tmp').write_bytes(
        (session / f'{session.name}_2.mcap').read_bytes())
    repair(session.parent)
    assert [path.name for path in recordings_in(session)] == [
        f'{session.name}_{number}.mcap' for number in (0, 1, 2, 10)
    ]


def test_many_sessions_in_order_cost_little(session):
    for number in range(200):
        copy = session.with_name(f'{session.name}-{number}')
        copy.mkdir()
        for path in session.iterdir():
            os.link(path, copy / path.name)
    for path in session.glob('*.mcap'):
        path.write_bytes(b'')  # all copies
    assert repair(session.parent) == [], 'nothing but names and metadata.yaml is read'
