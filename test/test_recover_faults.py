"""ambush_recover where things go wrong: full disks, interruptions, odd names, many files."""

import errno
import os
import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from recording_samples import METADATA, read_with_rosbags, small_departure

from ambush_planner.recording import Attachment, Recorder, recordings_in, recovery
from ambush_planner.recording.durable import create_durably
from ambush_planner.recording.encoding import encode_departure
from ambush_planner.recording.recorder import COMPRESSIONS
from ambush_planner.recording.recovery import recover_folder
from ambush_planner.tools import recover
from ambush_planner.tools.recover import main

ROOT = Path(__file__).resolve().parent.parent
ODD = os.fsdecode(b'a\xff')


@pytest.fixture
def session(tmp_path):
    """The folder of a session with three departures."""
    with Recorder(tmp_path / 'runs') as recorder:
        paths = [recorder.record_departure(small_departure(), METADATA) for _ in range(3)]
    return paths[0].parent


def test_what_was_saved_before_the_disk_was_full_is_a_bag_and_told(
        session, tmp_path, monkeypatch, capsys):
    def full_at_the_third(path, data):
        if path.name.endswith('_2.mcap'):
            raise OSError(errno.ENOSPC, 'No space left on device')
        create_durably(path, data)

    monkeypatch.setattr(recovery, 'create_durably', full_at_the_third)
    assert main([str(session), '-o', str(tmp_path / 'out')]) == 1
    out, err = capsys.readouterr()
    assert out.count('saved in') == 2
    assert '_2.mcap: No space left on device' in err
    assert len(read_with_rosbags(tmp_path / 'out')) == 8


def test_what_was_saved_before_an_interruption_is_a_bag_and_told(
        session, tmp_path, monkeypatch, capsys):
    told = []

    def interrupted_at_the_second(recovered, tell=recover._tell):
        if told:
            raise KeyboardInterrupt
        told.append(recovered)
        return tell(recovered)

    monkeypatch.setattr(recover, '_tell', interrupted_at_the_second)
    assert main([str(session), '-o', str(tmp_path / 'out')]) == 1
    out, err = capsys.readouterr()
    assert out.count('saved in') == 1 and 'interrupted' in err
    assert len(read_with_rosbags(tmp_path / 'out')) == 8


def test_a_repeated_command_says_what_to_do(session, capsys):
    assert main([str(session)]) == 0
    capsys.readouterr()
    assert main([str(session)]) == 1
    err = capsys.readouterr().err
    assert f'{session}.recovered: it is already there' in err
    assert 'remove it, or name another output (-o)' in err


def test_many_files_take_no_more_memory_than_one(session, tmp_path):
    noise = Attachment('noise', 'application/octet-stream', os.urandom(2**21))
    data = encode_departure(small_departure(), METADATA, [noise], COMPRESSIONS['none'])
    for number in range(12):
        (session / f'{session.name}_{number}.mcap').write_bytes(data)
    peaks = []
    tracemalloc.start()
    try:
        for _ in recover_folder(session, tmp_path / 'out', lambda *_: None):
            peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert len(peaks) == 12
    assert peaks[-1] < 1.2 * peaks[0]


def test_names_that_are_not_utf8(session, tmp_path, capsys):
    shutil.copy(session / f'{session.name}_0.mcap', session / f'{ODD}.mcap')
    assert main([str(session), '-o', str(tmp_path / 'out')]) == 0
    assert (tmp_path / 'out' / 'a_.mcap').exists()
    assert len(read_with_rosbags(tmp_path / 'out')) == 16
    assert r'a\xff.mcap' in capsys.readouterr().out.replace(r'\udcff', r'\xff')
    cut = tmp_path / f'{ODD}.mcap'
    cut.write_bytes((session / f'{ODD}.mcap').read_bytes()[:-50])
    assert main([str(cut)]) == 0
    assert recordings_in(tmp_path / f'{ODD}.recovered.mcap')


@pytest.mark.parametrize('command', ['recover', 'verify', 'audit', 'report', 'replay'])
def test_output_that_takes_utf8_only(tmp_path, command):
    folder = tmp_path / ODD
    folder.mkdir()
    (folder / f'{ODD}.mcap').write_bytes(b'nothing')
    output = ['-o', tmp_path / f'{ODD}out'] if command in ('audit', 'report') else []
    paths = [str(ROOT), os.environ.get('PYTHONPATH', '')]
    done = subprocess.run(
        [sys.executable, '-m', f'ambush_planner.tools.{command}', folder, *output],
        env={**os.environ, 'PYTHONIOENCODING': 'utf-8:strict',
             'PYTHONPATH': os.pathsep.join(paths)},
        capture_output=True, text=True, timeout=60, check=False,
    )
    assert done.returncode == 1
    assert 'Traceback' not in done.stderr
    assert r'a\udcff.mcap' in done.stdout + done.stderr
