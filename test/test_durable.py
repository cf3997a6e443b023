"""Files that are whole or not there, and folders that only their owner can read."""

import errno
import os
from pathlib import Path

import pytest

from ambush_planner.recordings import durable_files as durable
from ambush_planner.recordings.durable_files import make_private_folders, write_durably

ROOT = Path(__file__).resolve().parent.parent
DATA = b'whole' * 1000


def mode(path):
    return path.stat().st_mode & 0o777


def no_links(*_):
    raise PermissionError(errno.EPERM, 'Operation not permitted')


def test_the_name_appears_when_all_is_on_the_disk(tmp_path, monkeypatch):
    path = tmp_path / 'x.mcap'

    def synced(descriptor, fsync=os.fsync):
        fsync(descriptor)
        if os.path.isfile(f'/proc/self/fd/{descriptor}'):
            assert not path.exists()

    monkeypatch.setattr(os, 'fsync', synced)
    write_durably(path, DATA)
    assert path.read_bytes() == DATA and path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / 'x.mcap'
    path.write_bytes(b'old')
    monkeypatch.setattr(os, 'replace', lambda *_: (_ for _ in ()).throw(OSError(28, 'full')))
    with pytest.raises(OSError):
        write_durably(path, DATA)
    assert path.read_bytes() == b'old' and list(tmp_path.iterdir()) == [path]


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
