"""A node that is killed while it records leaves only whole files."""

import faulthandler
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from mcap.reader import make_reader
from nav_msgs.srv import GetPlan
from recording_samples import read_with_mcap_ros2, read_with_rosbags
from ros_harness import free_domain, pose, risk_grid, wait_until
from test_node_process import client_in, node_process

START, GOAL = pose(1.5, 5.5), pose(8.5, 5.5)
SIDE_BY_SIDE = 2


@pytest.mark.slow
def test_a_killed_node_leaves_whole_files(tmp_path, request):
    kills = max(1, request.config.getoption('--kills') // SIDE_BY_SIDE)
    lanes = [tmp_path / str(number) for number in range(SIDE_BY_SIDE)]
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        list(pool.map(kill_one_after_another, lanes, [kills] * SIDE_BY_SIDE))
    for lane in lanes:
        sessions = list((lane / 'runs').iterdir())
        assert len(sessions) == kills
        for session in sessions:
            assert_whole(session)


def kill_one_after_another(folder, kills):
    """Each node starts in the folder in which the previous one was killed."""
    folder.mkdir()
    for _ in range(kills):
        # A process of its own, since a client of a killed node may crash.
        done = subprocess.run(
            [sys.executable, __file__, str(folder)], capture_output=True, text=True, timeout=110,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, sys.path))},
            check=False)
        assert done.returncode == 0, f'exit code {done.returncode}\n{done.stderr}'


def assert_whole(session):
    for path in session.glob('*.mcap'):
        with path.open('rb') as file:
            assert make_reader(file, validate_crcs=True).get_summary().statistics
        assert read_with_mcap_ros2(path)
        assert read_with_rosbags(path)
    if (session / 'metadata.yaml').exists():
        assert read_with_rosbags(session)


def kill_while_recording(folder, seconds):
    """Start a node, ask it for departures, and kill it that long after its first recording."""
    directory = folder / 'runs'
    before = set(directory.glob('*'))
    parameters = (f'recording.directory:={directory}', 'network.spacing:=2.0')
    with free_domain() as domain, node_process(domain, folder, *parameters) as process, client_in(
            domain) as client:
        client.publish('alpha_map', risk_grid())
        client.diagnostics(message='waiting for start_pose, goal_pose')
        assert client.get_plan(START, GOAL).poses
        assert '/dev/shm/fastrtps' not in Path('/proc/self/maps').read_text()
        wait_until(lambda: set(directory.glob('*')) - before, 'a recording')
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            client.send('get_plan', GetPlan.Request(start=START, goal=GOAL))
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()


if __name__ == '__main__':
    faulthandler.enable()
    kill_while_recording(Path(sys.argv[1]), random.uniform(0.0, 0.2))
