# SPDX-License-Identifier: Apache-2.0
"""The node in its own process: over DDS from the first map to a clean exit."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from recording_samples import read_with_mcap_ros2
from ros_harness import (
    TIMEOUT,
    Client,
    free_domain,
    pose,
    risk_grid,
    ros_context,
    spinning,
    wait_until,
)

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.ros.shared_memory import segments

SEED = '987654321'


@contextmanager
def node_process(domain, tmp_path, *parameters, arguments=(), environment=None):
    """Start the node as a user does, with its output in a file, and kill it at the end."""
    arguments = [*arguments, *(word for parameter in parameters for word in ('-p', parameter))]
    environment = {**os.environ, **(environment or {}), 'ROS_DOMAIN_ID': str(domain),
                   'ROS_LOG_DIR': str(tmp_path / 'log')}
    with (tmp_path / 'output').open('w') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', 'ambush_planner.ros.program', '--ros-args', *arguments],
            env=environment, stdout=output, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            process.kill()
            process.wait()


@contextmanager
def client_in(domain):
    with ros_context(domain) as context:
        node = Node('client', context=context)
        client = Client(node)
        with spinning(node, SingleThreadedExecutor(context=context)):
            yield client


def exit_code(process, *signals):
    """Send the signals and return the exit code, which must not take as long as a solve."""
    for each in signals:
        process.send_signal(each)
    return process.wait(timeout=TIMEOUT)


def test_departures_and_a_clean_exit(tmp_path):
    recordings = tmp_path / 'recordings'
    parameters = (f'recording.directory:={recordings}', 'network.spacing:=1.0', f'seed:={SEED}',
                  'game.alpha_threshold:=.inf')
    with free_domain() as domain, node_process(domain, tmp_path, *parameters) as process:
        with client_in(domain) as client:
            client.give()
            for number in (1, 2):
                answer = client.call('new_route')
                assert answer.success, answer.message
                client.last('path', number)
            assert client.call('replan').success
            plan = client.get_plan(pose(1.5, 5.5), pose(8.5, 2.5))
            rows = path_from_ros(client.last('path', 3))
            assert (path_from_ros(plan) == rows).all()
            assert rows[0, :2].tolist() == [1.5, 5.5]
            assert rows[-1, :2].tolist() == [8.5, 2.5]
            assert client.last('edge_probabilities').markers[0].points
        with client_in(domain) as late:
            assert (path_from_ros(late.last('path')) == rows).all(), 'the path is latched'
        # The second interrupt must not disturb the exit.
        assert exit_code(process, signal.SIGINT, signal.SIGINT) == 0
    files = [path for path in recordings.rglob('*') if path.is_file()]
    assert sorted({path.suffix for path in files}) == ['.mcap', '.yaml'], 'no half-written file'
    assert sum(path.suffix == '.mcap' for path in files) == 3
    assert all(read_with_mcap_ros2(path) for path in files if path.suffix == '.mcap')
    logs = [path.read_text() for path in (tmp_path / 'log').rglob('*') if path.is_file()]
    said = '\n'.join([*logs, (tmp_path / 'output').read_text()])
    assert 'the parameter seed is set' in said
    assert SEED not in said
    assert 'Traceback' not in said


# Says when signals are noted, and then hangs.
HANGS = """
import sys
from ambush_planner.ros.program import noted_signals
came = noted_signals()
print('noted', flush=True)
while True:
    sys.stdin.read(1)
    print(came, flush=True)
"""


def test_a_second_sigterm_ends_a_process_that_hangs():
    with subprocess.Popen([sys.executable, '-c', HANGS], text=True, stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'noted\n'
        for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM):
            process.send_signal(number)
        process.stdin.write('x')
        process.stdin.flush()
        assert '15' in process.stdout.readline(), 'it goes on'
        assert exit_code(process, signal.SIGTERM) == -signal.SIGTERM


def other_heaps(pid):
    """The heaps of glibc besides the main one: 64 MB, of which the end is not in use yet."""
    maps = [re.match(r'(\w+)-(\w+) (\S+)', line).groups()
            for line in Path(f'/proc/{pid}/maps').read_text().splitlines()]
    spans = [(int(begin, 16), int(end, 16), mode) for begin, end, mode in maps]
    return [one[0] for one, other in pairwise(spans) if one[0] % 2**26 == 0
            and other == (one[1], one[0] + 2**26, '---p')]


def test_a_node_has_one_heap_no_core_dump_and_shared_memory_that_others_cannot_read(
        tmp_path, monkeypatch):
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')  # which switches it off
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with free_domain() as domain, node_process(domain, tmp_path) as process:
        wait_until(lambda: 'version' in (tmp_path / 'output').read_text(), 'the node')
        (own,) = segments(process.pid)
        assert stat.S_IMODE(own.stat().st_mode) == 0o600
        assert other_heaps(process.pid) == []
        limits = Path(f'/proc/{process.pid}/limits').read_text()
        assert re.search(r'^Max core file size +0 ', limits, re.MULTILINE), 'it would hold routes'
        assert exit_code(process, signal.SIGINT) == 0
    assert not own.exists()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_a_solve_ends_node_and_worker_at_once(tmp_path, number):
    """SIGTERM for the node; SIGINT for all its processes, as a terminal and systemd send it."""
    parameters = ('network.target_nodes:=40000', 'strategy.solver:=simplex',
                  f'recording.directory:={tmp_path / "runs"}')
    with free_domain() as domain, node_process(domain, tmp_path, *parameters) as process:
        with client_in(domain) as client:
            client.give(risk_grid(np.zeros((300, 300), dtype=np.int8)), (5.0, 75.0), (145.0, 75.0))
            futures = [client.send('new_route') for _ in range(10)]
            client.diagnostics(state='solving')
            # The node answers requests in order, so these answers come after the node has those.
            for _ in futures:
                assert not client.get_plan(pose(0.0, 0.0, frame=''), pose(0.0, 0.0)).poses
            (parent,) = wait_until(lambda: _children(process.pid), "the workers' parent")
            (worker,) = wait_until(lambda: _children(parent), 'a worker')
            if number == signal.SIGINT:
                for each in (worker, parent):
                    os.kill(int(each), number)
                time.sleep(0.2)  # in which a worker that dies would be reported
            assert exit_code(process, number) == 0
            # A client that is slower than the node's shutdown may miss its answer.
            answers = {each.result().message for each in futures if each.done()}
            assert answers <= {'the planner is shutting down'}
    assert not any(Path('/proc', each).exists() for each in (parent, worker)), 'no orphan'
    assert not list(tmp_path.rglob('*.tmp'))
    said = (tmp_path / 'output').read_text()
    # The first is logged at once, and the others are counted.
    (more,) = re.findall(r'new_route: the planner is shutting down \(and (\d+) more', said)
    assert int(more) == len(futures) - 1
    assert all(each not in said for each in ('Traceback', 'never retrieved', 'the worker process'))


def _children(pid):
    threads = Path(f'/proc/{pid}/task')
    with suppress(OSError):  # a thread that has just ended
        return ' '.join(each.read_text() for each in threads.glob('*/children')).split()
    return []


# Start a node with each line of arguments.
STARTS = """
import sys
from ambush_planner.ros.planner_node import main
for arguments in sys.stdin:
    print('exit code', main(['--ros-args', *arguments.split()], []), file=sys.stderr)
"""


def test_unusable_arguments_stop_the_start_with_a_reason():
    unusable = {'--params-file /nowhere/my.yaml': '/nowhere/my.yaml', '--no-such-flag': 'no-such',
                '-p map.alpha_min:=20.0': 'alpha_min 20.0',
                '-p strategy.max_detour:=2': "'strategy.max_detour'"}
    with free_domain() as domain:
        done = subprocess.run(
            [sys.executable, '-c', STARTS], input='\n'.join(unusable),
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)}, capture_output=True, text=True,
            timeout=TIMEOUT, check=False)
    assert (done.returncode, done.stdout) == (0, ''), done.stderr
    assert 'Traceback' not in done.stderr
    *outputs, end = re.split(r'^exit code 1\n', done.stderr, flags=re.MULTILINE)
    assert end == ''
    for reason, output in zip(unusable.values(), outputs, strict=True):
        last = output.splitlines()[-1]
        assert last.startswith('ambush_planner: cannot start: ') and reason in last
