# SPDX-License-Identifier: Apache-2.0
"""Recording fails under a running node: departures go on, and recording resumes."""

import os
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import pytest
from nav_msgs.srv import GetPlan
from recording_samples import read_with_rosbags
from ros_harness import GOAL, START, free_domain, risk_grid, stage, wait_until
from test_node_process import client_in, exit_code, node_process
from waiting import TIMEOUT, held, stderr_in

from ambush_planner.recordings import durable_files as durable
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros import recordings as recordings_module


def recordings(directory):
    return sorted(directory.rglob('*.mcap'))


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


def departs(client):
    assert client.get_plan(START, GOAL).poses


def test_a_full_disk_is_reported_and_recording_resumes(tmp_path):
    filler = tmp_path / 'filler'
    with small_disk(tmp_path, '2m'), stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        # The last file written for a departure: no space becomes free after it.
        wait_until(lambda: list(tmp_path.rglob('metadata.yaml')), 'a recording and its list')
        with pytest.raises(OSError, match='No space left'):
            filler.write_bytes(bytes(4_000_000))
        departs(client)
        report = client.diagnostics(code='RECORDING_FAILED', recording='failed', level=b'\2')
        assert 'No space left on device' in report['message']
        filler.unlink()
        departs(client)
        client.diagnostics(code='NONE', recording='on', departures='3')
        assert len(recordings(tmp_path)) == 2
        assert all(read_with_rosbags(path) for path in recordings(tmp_path))


def test_a_departure_that_must_be_recorded_leaves_only_once_it_is(tmp_path, monkeypatch):
    steps, replaced = [], os.replace

    def written(source, target):
        replaced(source, target)
        steps.append((Path(target).name, len(client.received['path'])))

    parameters = {'recording.required': True}
    with small_disk(tmp_path, '2m'), stage(tmp_path / 'runs', parameters) as running:
        client = running.give()
        monkeypatch.setattr(durable.os, 'replace', written)
        answer = client.call('new_route')
        assert answer.success and client.last('path', 1).poses
        monkeypatch.undo()
        # Both files were on the disk before anybody heard of the path.
        assert [name.rpartition('.')[2] for name, _ in steps] == ['mcap', 'yaml']
        assert {heard for _, heard in steps} == {0}
        with pytest.raises(OSError, match='No space left'):
            (tmp_path / 'filler').write_bytes(bytes(4_000_000))
        for _ in range(2):
            refused = client.call('new_route')
            assert not refused.success and 'No space left on device' in refused.message
            assert not client.get_plan(START, GOAL).poses
        assert client.diagnostics(code='RECORDING_FAILED')['departures'] == '1'
        (tmp_path / 'filler').unlink()
        later = client.call('new_route')
        assert later.success and len(client.last('path', 2).poses)
        files = recordings(tmp_path)
        assert len(files) == len(client.received['path']) == 2, 'refused departures leave no file'
        for path, said in zip(files, (answer, later), strict=True):
            assert Verifier().verify(path).holds
            reports = [each for topic, _, each in read_with_rosbags(path)
                       if topic == '/diagnostics']
            values = {pair.key: pair.value for pair in reports[0].status[0].values}
            assert values['departure_id'] in said.message and values['recording'] == 'on'


def test_a_folder_that_cannot_be_written_is_reported_before_the_first_departure(tmp_path):
    (tmp_path / 'file').write_text('no folder')
    with stage(tmp_path / 'file' / 'runs') as running:
        report = running.client.diagnostics(code='RECORDING_FAILED', recording='failed')
        assert 'check that recording.directory is a folder' in report['message']


def test_a_node_that_starts_removes_what_a_kill_has_left(tmp_path):
    with stage(tmp_path) as running:
        departs(running.give())
    (path,) = recordings(tmp_path)
    left = path.with_name(f'{path.parent.name}_1.mcap.tmp')
    left.write_bytes(b'half')
    os.utime(left, (0.0, 0.0))
    with stderr_in(tmp_path / 'log') as said, stage(tmp_path):
        wait_until(lambda: f'removed the unfinished file {left}' in said(), 'the warning')
    assert not left.exists() and recordings(tmp_path) == [path]


def test_a_disk_that_does_not_answer_holds_nobody_up(tmp_path, monkeypatch):
    with stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        wait_until(lambda: list(tmp_path.rglob('metadata.yaml')), 'a recording and its list')
        wait_until(lambda: not running.planner._recordings[0]._unwritten, 'the disk')
        with held(durable.os, 'fsync') as (stuck, _):
            departs(client)
            assert stuck.wait(TIMEOUT)
            for _ in range(5):  # the last one waits in vain, and goes without a recording
                departs(client)
            report = client.diagnostics(code='RECORDING_FAILED', recording='failed')
            assert 'the disk does not respond' in report['message']
            # Nobody waits any more: this would not be answered in time.
            monkeypatch.setattr(recordings_module, '_MAX_WAIT', 10 * TIMEOUT)
            for _ in range(5):
                departs(client)
    assert len(recordings(tmp_path)) == 5, 'what could wait was written in the end'


def test_all_departures_are_recorded_when_the_node_ends(tmp_path):
    with free_domain() as domain, node_process(
            domain, tmp_path, f'recording.directory:={tmp_path / "runs"}',
            'network.spacing:=1.0') as process, client_in(domain) as client:
        client.publish('alpha_map', risk_grid())
        client.diagnostics(message='waiting for /start_pose, /goal_pose')
        for _ in range(30):
            client.send('get_plan', GetPlan.Request(start=START, goal=GOAL))
        wait_until(lambda: len(client.received['path']) > 3, 'some departures')
        assert exit_code(process, signal.SIGINT) == 0
        assert 'not recorded' not in (tmp_path / 'output').read_text()
        assert 'could not be written' not in (tmp_path / 'output').read_text()
        assert len(recordings(tmp_path)) >= len(client.received['path'])
