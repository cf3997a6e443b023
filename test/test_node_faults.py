"""Recording goes wrong under a running node: nothing is lost that need not be."""

import math
import os
import shutil
import signal
import time
from threading import Event

import pytest
from nav_msgs.srv import GetPlan
from rclpy.parameter import Parameter
from recording_samples import read_with_rosbags
from ros_harness import free_domain, pose, risk_grid, stage, wait_until
from test_node_process import client_in, exit_code, node_process
from test_recorder import small_disk
from waiting import TIMEOUT, stderr_in, unstamped

from ambush_planner.recordings import Recorder
from ambush_planner.recordings import durable_files as durable
from ambush_planner.ros import recordings as recordings_module

START, GOAL = pose(1.5, 5.5), pose(8.5, 5.5)


def recordings(directory):
    return sorted(directory.rglob('*.mcap'))


def departs(client):
    assert client.get_plan(START, GOAL).poses, 'departures go on, whatever happens to recordings'


def test_a_full_disk_is_told_and_recording_resumes(tmp_path):
    filler = tmp_path / 'filler'
    with small_disk(tmp_path, '2m'), stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        # The last that is written of a departure: from then on no space becomes free.
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


def test_a_file_system_that_becomes_read_only(tmp_path):
    with small_disk(tmp_path, '2m'), stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        wait_until(lambda: list(tmp_path.rglob('metadata.yaml')), 'a recording and its list')
        assert os.system(f'mount -o remount,ro {tmp_path}') == 0
        departs(client)
        report = client.diagnostics(code='RECORDING_FAILED', recording='failed')
        assert 'Read-only file system' in report['message']
        assert os.system(f'mount -o remount,rw {tmp_path}') == 0
        departs(client)
        client.diagnostics(code='NONE', recording='on', departures='3')
        assert len(recordings(tmp_path)) == 2


def test_the_folder_is_removed_under_the_node(tmp_path):
    with stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        wait_until(lambda: list(tmp_path.rglob('metadata.yaml')), 'a recording')
        shutil.rmtree(tmp_path / 'runs')
        departs(client)
        (path,) = wait_until(lambda: recordings(tmp_path), 'a new folder')
        client.diagnostics(code='NONE', recording='on', departures='2')
        assert read_with_rosbags(path)


def test_recording_is_switched_off_and_on(tmp_path):
    with stage(tmp_path) as running:
        client = running.give()
        for enabled, state in ((False, 'off'), (True, 'on')):
            running.planner.set_parameters([Parameter('recording.enabled', value=enabled)])
            client.diagnostics(recording=state)
            departs(client)
        wait_until(lambda: recordings(tmp_path), 'a recording')
    assert len(recordings(tmp_path)) == 1


def test_a_node_that_starts_removes_what_a_kill_has_left(tmp_path):
    with stage(tmp_path) as running:
        departs(running.give())
    (path,) = recordings(tmp_path)
    left = path.with_name(f'{path.parent.name}_1.mcap.tmp')
    left.write_bytes(b'half')
    os.utime(left, (0.0, 0.0))
    with stderr_in(tmp_path / 'log') as said, stage(tmp_path):
        wait_until(lambda: f'removed {left}' in said(), 'the warning')
    assert not left.exists() and recordings(tmp_path) == [path]


def test_a_disk_that_does_not_answer_holds_nobody_up(tmp_path, monkeypatch):
    stuck, go_on = Event(), Event()

    def hang(*_):
        stuck.set()
        assert go_on.wait(TIMEOUT)

    with stage(tmp_path / 'runs') as running:
        client = running.give()
        departs(client)
        wait_until(lambda: list(tmp_path.rglob('metadata.yaml')), 'a recording and its list')
        wait_until(lambda: not running.planner._dispatcher._recordings._unwritten, 'the disk')
        monkeypatch.setattr(durable.os, 'fsync', hang)
        try:
            departs(client)
            assert stuck.wait(TIMEOUT)
            for _ in range(5):  # the last one waits in vain, and goes without a recording
                departs(client)
            report = client.diagnostics(code='RECORDING_FAILED', recording='failed')
            assert 'wait for the disk, which does not answer' in report['message']
            # Nobody waits any more: this would not be answered in time.
            monkeypatch.setattr(recordings_module, '_PATIENCE', 10 * TIMEOUT)
            for _ in range(20):
                departs(client)
            running.planner.set_parameters([Parameter('recording.enabled', value=False)])
            client.diagnostics(recording='off', code='NONE')
        finally:
            monkeypatch.undo()
            go_on.set()
    assert len(recordings(tmp_path)) == 5, 'what could wait was written in the end'


def test_a_slow_disk_delays_answers_and_loses_nothing(tmp_path, monkeypatch):
    record = Recorder.record_departure

    def slow(*arguments):
        time.sleep(0.3)
        return record(*arguments)

    monkeypatch.setattr(Recorder, 'record_departure', slow)
    with stage(tmp_path) as running:
        client = running.give()
        answers = [client.send('get_plan', GetPlan.Request(start=START, goal=GOAL))
                   for _ in range(24)]
        wait_until(lambda: all(each.done() for each in answers), 'the answers')
        assert all(each.result().plan.poses for each in answers)
        # Four wait in the queue, and answers are sent while the next one leaves.
        assert len(recordings(tmp_path)) >= 18
        client.diagnostics(code='NONE', recording='on', departures='24')
    assert len(recordings(tmp_path)) == 24


def test_an_error_that_nobody_expected_is_told_without_its_words(tmp_path, monkeypatch, capfd):
    def broken(*_):
        raise ValueError(f'the route was {math.pi}')

    with stage(tmp_path) as running:
        client = running.give()
        with monkeypatch.context() as patch:
            patch.setattr(recordings_module, 'metadata_entries', broken)
            departs(client)
            message = client.diagnostics(recording='failed')['message']
        departs(client)
        client.diagnostics(recording='on', code='NONE')
    log = unstamped(capfd.readouterr().err)
    assert 'internal error (ValueError)' in message
    assert 'in broken' in log
    assert '3.14159' not in log + message


def test_all_that_departed_is_recorded_when_the_node_is_told_to_end(tmp_path):
    with free_domain() as domain, node_process(
            domain, tmp_path, f'recording.directory:={tmp_path / "runs"}',
            'network.spacing:=1.0') as process, client_in(domain) as client:
        client.publish('alpha_map', risk_grid())
        client.diagnostics(message='waiting for start_pose, goal_pose')
        for _ in range(60):
            client.send('get_plan', GetPlan.Request(start=START, goal=GOAL))
        wait_until(lambda: len(client.received['path']) > 3, 'some departures')
        assert exit_code(process, signal.SIGINT) == 0
        assert 'not recorded' not in (tmp_path / 'output').read_text()
        assert 'could not be written' not in (tmp_path / 'output').read_text()
        assert len(recordings(tmp_path)) >= len(client.received['path'])
