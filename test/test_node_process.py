"""The node as a process of its own: over DDS from the first map to a clean exit."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
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

SEED = '987654321'


@contextmanager
def node_process(domain, tmp_path, *parameters):
    """The node, started as a user would, with its output in a file; killed if it is left over."""
    arguments = [word for parameter in parameters for word in ('-p', parameter)]
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'ROS_LOG_DIR': str(tmp_path / 'log')}
    with (tmp_path / 'output').open('w') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', 'ambush_planner.ros.planner_node', '--ros-args', *arguments],
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
    """Send the signals, and return the exit code: long before a solve of minutes would end."""
    for each in signals:
        process.send_signal(each)
        time.sleep(0.05)  # signals of one number that come at once are one
    return process.wait(timeout=TIMEOUT)


def test_a_convoy_departs_and_the_node_exits_cleanly(tmp_path):
    recordings = tmp_path / 'recordings'
    parameters = (f'recording.directory:={recordings}', 'network.spacing:=1.0', f'seed:={SEED}',
                  'game.alpha_threshold:=.inf')
    with free_domain() as domain, node_process(domain, tmp_path, *parameters) as process:
        with client_in(domain) as client:
            client.publish('alpha_map', risk_grid())
            client.publish('start_pose', pose(1.5, 5.5))
            client.publish('goal_pose', pose(8.5, 5.5, 1.0))
            client.diagnostics(state='ready')
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
        assert exit_code(process, signal.SIGINT) == 0
    files = [path for path in recordings.rglob('*') if path.is_file()]
    assert sorted({path.suffix for path in files}) == ['.mcap', '.yaml'], 'nothing half-written'
    assert sum(path.suffix == '.mcap' for path in files) == 3
    assert all(read_with_mcap_ros2(path) for path in files if path.suffix == '.mcap')
    logs = [path.read_text() for path in (tmp_path / 'log').rglob('*') if path.is_file()]
    said = '\n'.join([*logs, (tmp_path / 'output').read_text()])
    assert 'the parameter seed is fixed' in said
    assert SEED not in said
    assert 'Traceback' not in said


@pytest.mark.parametrize('signals', [
    (signal.SIGTERM,), (signal.SIGINT, signal.SIGINT)], ids=['SIGTERM', 'SIGINT twice'])
def test_other_ways_to_end_it(tmp_path, signals):
    with free_domain() as domain, node_process(domain, tmp_path) as process:
        with client_in(domain) as client:
            client.diagnostics(state='waiting')
        assert exit_code(process, *signals) == 0
    assert 'Traceback' not in (tmp_path / 'output').read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_solve_does_not_hold_up_the_exit_and_nothing_is_left(tmp_path, number):
    large = risk_grid(np.zeros((300, 300), dtype=np.int8))
    parameters = ('network.target_nodes:=40000', 'strategy.solver:=simplex',
                  f'recording.directory:={tmp_path / "runs"}')
    shared = set(Path('/dev/shm').iterdir())
    with free_domain() as domain, node_process(domain, tmp_path, *parameters) as process:
        with client_in(domain) as client:
            client.publish('alpha_map', large)
            client.publish('start_pose', pose(5.0, 75.0))
            client.publish('goal_pose', pose(145.0, 75.0))
            client.diagnostics(state='ready')
            futures = [client.send('new_route') for _ in range(10)]
            client.diagnostics(state='solving')
            # The node takes requests in turn: by the last of these answers it has all of those.
            for _ in futures:
                assert not client.get_plan(pose(0.0, 0.0, frame=''), pose(0.0, 0.0)).poses
            (worker,) = wait_until(lambda: _children(process.pid), 'a worker')
            ours = _shared_memory(process.pid) - _shared_memory('self') - shared
            assert exit_code(process, number) == 0
            # A client that is suspended for longer than the node stays may miss its answer.
            answers = {each.result().message for each in futures if each.done()}
            assert answers <= {'the planner is shutting down'}
    assert not Path('/proc', worker).exists(), 'no orphan'
    assert not [path for path in ours if path.exists()]
    assert not list(tmp_path.rglob('*.tmp'))
    said = (tmp_path / 'output').read_text()
    assert said.count('new_route: the planner is shutting down') == len(futures)
    assert 'Traceback' not in said and 'never retrieved' not in said


def _children(pid):
    threads = Path(f'/proc/{pid}/task')
    with suppress(OSError):  # a thread that has just ended
        return ' '.join(each.read_text() for each in threads.glob('*/children')).split()
    return []


def _shared_memory(pid):
    lines = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return {Path(line.split()[5]) for line in lines if ' /dev/shm/' in line}


UNUSABLE = {
    ('--params-file', '/nowhere/my.yaml'): '/nowhere/my.yaml',
    ('--no-such-flag',): 'no-such',
    ('-p', 'map.alpha_min:=20.0'): 'alpha_min 20.0 and alpha_max 10.0',
    ('-p', 'strategy.max_detour:=0.5'): 'out of range',
    ('-p', 'strategy.max_detour:=2'): "'strategy.max_detour'",
}
STARTS = """
import sys
from ambush_planner.ros.planner_node import main
for arguments in sys.stdin:
    print('exit code', main(['--ros-args', *arguments.split()]), file=sys.stderr)
"""


@pytest.fixture(scope='module')
def starts():
    """{arguments: (what the node says, its exit code)} of nodes that cannot start."""
    with free_domain() as domain:
        done = subprocess.run(
            [sys.executable, '-c', STARTS], input='\n'.join(map(' '.join, UNUSABLE)),
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)}, capture_output=True, text=True,
            timeout=TIMEOUT, check=False)
    assert (done.returncode, done.stdout) == (0, ''), done.stderr
    *words, end = re.split(r'^exit code (.*)\n', done.stderr, flags=re.MULTILINE)
    assert end == ''
    return dict(zip(UNUSABLE, zip(words[::2], words[1::2], strict=True), strict=True))


@pytest.mark.parametrize('arguments', UNUSABLE, ids=' '.join)
def test_what_is_unusable_stops_the_start_and_is_named(starts, arguments):
    output, code = starts[arguments]
    assert code == '1'
    *before, last = output.splitlines()
    assert last.startswith('ambush_planner: cannot start: ') and UNUSABLE[arguments] in last
    assert 'Traceback' not in output
    # Of arguments that are no parameters rcl may have said something, too.
    assert not before or arguments[0] != '-p'
