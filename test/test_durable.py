"""Files that are whole or not there, and folders that only their owner can read."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ambush_planner.recording import durable
from ambush_planner.recording.durable import create_durably, make_private_folders

ROOT = Path(__file__).resolve().parent.parent
DATA = b'whole' * 1000


def mode(path):
    return path.stat().st_mode & 0o777


def no_links(*_):
    raise PermissionError(errno.EPERM, 'Operation not permitted')


def test_the_name_appears_when_all_is_on_the_disk(tmp_path, monkeypatch):
    path = tmp_path / 'x.mcap'
    at_sync = []

    def watched(descriptor, fsync=os.fsync):
        at_sync.append((path.exists(), os.fstat(descriptor).st_size))
        fsync(descriptor)

    monkeypatch.setattr(os, 'fsync', watched)
    create_durably(path, DATA)
    assert at_sync[0] == (False, len(DATA))
    assert [exists for exists, _ in at_sync] == [False, True]  # the file, the folder
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == DATA and mode(path) == 0o600 and path.stat().st_nlink == 1


def test_a_kill_leaves_no_stump_and_does_not_block_the_next(tmp_path):
    code = (
        'import os, signal, sys\n'
        'from pathlib import Path\n'
        'from ambush_planner.recording.durable import create_durably\n'
        'os.fsync = lambda descriptor: os.kill(os.getpid(), signal.SIGKILL)\n'
        'create_durably(Path(sys.argv[1]), bytes(1000))\n'
    )
    path = tmp_path / 'x.mcap'
    done = subprocess.run([sys.executable, '-c', code, path], cwd=ROOT, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    assert [each.name for each in tmp_path.iterdir()] == ['x.mcap.part']
    create_durably(path, DATA)
    assert list(tmp_path.iterdir()) == [path] and path.read_bytes() == DATA


def test_what_a_kill_left_behind_is_replaced(tmp_path):
    path, part = tmp_path / 'x.mcap', tmp_path / 'x.mcap.part'
    victim = tmp_path / 'victim'
    victim.write_text('mine')
    part.symlink_to(victim)
    create_durably(path, DATA)
    assert path.read_bytes() == DATA and victim.read_text() == 'mine'
    assert not os.path.lexists(part)
    path.unlink()
    part.write_bytes(DATA[:100])
    create_durably(path, DATA)
    assert path.read_bytes() == DATA and not part.exists()


@pytest.mark.parametrize('links', [True, False])
def test_what_is_there_is_left_alone(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr(os, 'link', no_links)
    path = tmp_path / 'x.mcap'
    path.symlink_to(tmp_path / 'nowhere')
    with pytest.raises(FileExistsError):
        create_durably(path, DATA)
    assert path.is_symlink()
    path.unlink()

    def meanwhile(path_, data, write=durable._write_new_file):
        write(path_, data)
        path.write_text('mine')

    monkeypatch.setattr(durable, '_write_new_file', meanwhile)
    with pytest.raises(FileExistsError):
        create_durably(path, DATA)
    assert path.read_text() == 'mine'
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_system_without_hard_links(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'link', no_links)
    path = tmp_path / 'x.mcap'
    create_durably(path, DATA)
    assert path.read_bytes() == DATA
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OSError, match='No space'):
        create_durably(tmp_path / 'x.mcap', DATA)
    assert list(tmp_path.iterdir()) == []


def test_folders_that_are_there_stay_as_they_are(tmp_path):
    tmp_path.chmod(0o755)
    make_private_folders(tmp_path / 'a' / 'b')
    assert [mode(tmp_path / name) for name in ('', 'a', 'a/b')] == [0o755, 0o700, 0o700]
    make_private_folders(tmp_path / 'a' / 'b')
    (tmp_path / 'file').touch()
    for path in (tmp_path / 'file', tmp_path / 'file' / 'below'):
        with pytest.raises(FileExistsError):
            make_private_folders(path)


def test_a_folder_that_another_process_makes_meanwhile(tmp_path, monkeypatch):
    def meanwhile(path):
        path.mkdir()
        raise FileExistsError

    monkeypatch.setattr(durable, 'make_private_folder', meanwhile)
    make_private_folders(tmp_path / 'a' / 'b')
    assert (tmp_path / 'a' / 'b').is_dir()
