# SPDX-License-Identifier: Apache-2.0
"""Recording fails under a running node: departures go on, and recording resumes."""

import os
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.srv import GetPlan
from recording_samples import read_with_rosbags
from ros_harness import FLAT, GOAL, START, free_domain, risk_grid, stage, wait_until
from test_node_process import client_in, exit_code, node_process
from waiting import TIMEOUT, held, stderr_in

from ambush_planner.maps.ros_messages import path_from_ros
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


def disk_is_idle(running):
    (recordings,) = running.planner._recordings
    wait_until(lambda: not recordings._unwritten, 'the disk')


@contextmanager
def hung_disk(running, monkeypatch, patience):
    """A disk that counts as hung after this time [s]; yields what sets it going again."""
    # An answer may come before its departure waits for the disk.
    folder = Path(running.planner._settings.current.recording.directory)
    number = running.planner._dispatcher._departures._count
    wait_until(lambda: len(recordings(folder)) == number, 'all recordings')
    disk_is_idle(running)
    monkeypatch.setattr(recordings_module, '_MAX_WAIT', patience)
    with held(durable.os, 'fsync') as (_, go_on):
        yield go_on


def test_a_disk_that_does_not_answer_holds_nobody_up(tmp_path, monkeypatch):
    with stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        with hung_disk(running, monkeypatch, 0.5):
            for _ in range(10):  # the last ones go without a recording
                departs(client)
            client.diagnostics(code='RECORDING_FAILED', recording='failed')
            for words in ('4 departures wait for it', 'has not responded for'):
                wait_until(lambda words=words: words in client.diagnostics()['message'], words)
        disk_is_idle(running)
        wait_until(lambda: 'has not responded' not in client.diagnostics()['message'], 'its end')
    assert len(recordings(tmp_path)) == 5, 'what could wait was written in the end'


def wall(column):
    """A map with a wall that leaves a way round in the north."""
    values = FLAT.copy()
    values[:17, column] = 100
    return values


def assert_clear(path, values):
    """No pose of a dense path is in an obstacle."""
    cells = np.floor(path_from_ros(path)[:, :2] / 0.5).astype(int)
    assert not (values[cells[:, 1], cells[:, 0]] == 100).any()


DENSE = {'route.path_spacing': 0.05, 'replan.tolerance': 1e9}


def test_a_path_that_a_new_map_blocks_while_it_is_recorded_does_not_leave(tmp_path):
    with stage(tmp_path / 'runs', {'recording.required': True, **DENSE}) as running:
        client = running.give(risk_grid(FLAT))
        with held(durable.os, 'fsync') as (stuck, _):
            answer = client.send('get_plan', GetPlan.Request(start=START, goal=GOAL))
            wait_until(stuck.is_set, 'the recording')
            running.know(wall(10))
        wait_until(answer.done, 'the answer')
        assert_clear(answer.result().plan, wall(10))
        client.diagnostics(departures='2')  # the first one has not left
        assert len(client.received['path']) == 1 == len(recordings(tmp_path))


def test_a_required_recording_that_hangs_is_refused_and_said(tmp_path, monkeypatch):
    with stage(tmp_path / 'runs', {'recording.required': True}) as running:
        client = running.give()
        assert client.call('new_route').success
        with hung_disk(running, monkeypatch, 0.5):
            for _ in range(2):  # the second one at once
                answer = client.call('new_route')
                assert not answer.success and 'the disk does not respond' in answer.message
            client.diagnostics(code='RECORDING_FAILED', recording='failed')
            wait_until(lambda: 'has not responded' in client.diagnostics()['message'], 'the disk')
        disk_is_idle(running)
        assert client.call('new_route').success
        assert len(client.received['path']) == 2 == len(recordings(tmp_path))


@pytest.mark.parametrize('how, words', [('cancel', 'was cancelled'), ('deactivate', 'inactive')])
def test_a_required_recording_that_hangs_is_ended(tmp_path, monkeypatch, how, words):
    with stage(tmp_path / 'runs', {'recording.required': True}) as running:
        client = running.give()
        assert client.call('new_route').success
        with hung_disk(running, monkeypatch, 10 * TIMEOUT):
            waiting = [client.send('new_route') for _ in range(6)]  # two wait for room in the queue
            dispatcher = running.planner._dispatcher
            wait_until(lambda: len(dispatcher._aside) == 2, 'all of them')
            if how == 'cancel':
                assert client.call('cancel').success
            else:
                running.planner.trigger_deactivate()
            wait_until(lambda: all(each.done() for each in waiting), 'the answers')
            assert all(words in each.result().message for each in waiting)
        disk_is_idle(running)
        assert len(client.received['path']) == 1
        wait_until(lambda: len(recordings(tmp_path)) == 1, 'the end of the other file')


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
