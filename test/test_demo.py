"""``ambush_demo`` as a user starts it, and what it leaves."""

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='the demo draws pictures')

import rclpy
from commands import documented_keys, run_here
from matplotlib.image import imread
from rclpy.context import Context
from rosbags.highlevel import AnyReader

from ambush_planner import StrategyOptions
from ambush_planner.commands import demo, node_process
from ambush_planner.commands.demo_client import DemoClient
from ambush_planner.commands.demo_ground import GOAL, START
from ambush_planner.commands.node_process import NodeFailed, NodeProcess, free_domain, is_free
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.maps.occupancy import risk_map_from_occupancy

DEPARTURES = 5
# The node promises to record what a route was drawn from and what was told about it.
TYPES = {
    '/alpha_map': 'nav_msgs/msg/OccupancyGrid',
    '/start_pose': 'geometry_msgs/msg/PoseStamped',
    '/goal_pose': 'geometry_msgs/msg/PoseStamped',
    '/path': 'nav_msgs/msg/Path',
    '/edge_probabilities': 'visualization_msgs/msg/MarkerArray',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
}


# The command on a quarter of its nodes, with one budget instead of four: test_frontier has more.
# What --json says comes last.
COMMAND = """
import sys
from ambush_planner.commands import demo, node_process
demo.SPACING, demo.DETOURS, demo.SLACKS = 720.0, (1.2,), (0.01,)
finish = demo.cli.Console.finish

def with_json(console, code):
    console._json = True
    finish(console, code)

demo.cli.Console.finish = with_json
sys.exit(demo.main())
"""


@pytest.fixture(scope='module')
def done(tmp_path_factory):
    """The demo's folder and what it printed."""
    folder = tmp_path_factory.mktemp('demo') / 'new folder: 1'
    process = subprocess.run(
        [sys.executable, '-c', COMMAND, '--output', folder, '--departures', str(DEPARTURES)],
        env={**os.environ, 'ROS_PYTHON_CHECK_FIELDS': '1'},
        capture_output=True, text=True, timeout=280.0, check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    assert 'Traceback' not in process.stderr
    return folder, process.stdout, process.stderr


@pytest.fixture(scope='module')
def recordings(done):
    """The messages of each recording by topic; paths as positions (L, 2)."""
    files = sorted(done[0].rglob('*.mcap'))
    assert len(files) == DEPARTURES
    return [read(file) for file in files]


def read(file: Path) -> dict[str, list]:
    with AnyReader([file]) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        assert types.items() >= TYPES.items()
        messages: dict[str, list] = {topic: [] for topic in types}
        for connection, _, data in reader.messages():
            messages[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return messages


def positions(recording: dict[str, list]) -> np.ndarray:
    (path,) = recording['/path']
    return np.array([(p.pose.position.x, p.pose.position.y) for p in path.poses])


def test_routes_lead_from_start_to_goal(recordings):
    for recording in recordings:
        route = positions(recording)
        assert tuple(route[0]) == START and tuple(route[-1]) == GOAL
        (goal,) = recording['/goal_pose']
        assert recording['/path'][0].poses[-1].pose == goal.pose


def test_routes_are_simple(recordings):
    for recording in recordings:
        route = np.round(positions(recording), 3)
        # A turn that has no room is several poses at one place.
        route = route[np.append(True, (np.diff(route, axis=0) != 0.0).any(axis=1))]
        assert len(np.unique(route, axis=0)) == len(route)


def test_routes_meet_no_obstacle(recordings):
    for recording in recordings:
        (grid,) = recording['/alpha_map']
        values = np.asarray(grid.data).reshape(grid.info.height, grid.info.width)
        field = ObstacleField(risk_map_from_occupancy(values, grid.info.resolution))
        route = positions(recording)
        assert field.clear_segments(route[:-1], route[1:], 0.0).all()


def test_routes_differ(recordings):
    assert len({positions(recording).tobytes() for recording in recordings}) >= DEPARTURES - 1


def test_recordings_and_pictures_are_private(done):
    for file in (*done[0].rglob('*.mcap'), *done[0].glob('*.png')):
        assert file.stat().st_mode & 0o777 == 0o600


def test_pictures_are_large_and_not_blank(done):
    for name in ('routes.png',):
        picture = imread(done[0] / name)
        assert picture.shape[0] > 700 and picture.shape[1] > 1500
        assert picture.std() > 0.1


def test_the_frontier_goes_through_the_demos_own_strategy(done):
    with (done[0] / 'frontier.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    (own,) = [row for row in rows if row['max_detour'] == '1.2' and row['swept'] == 'max_detour']
    value = next(line for line in done[1].splitlines() if line.startswith('value')).split()[2]
    assert float(own['value']) == pytest.approx(float(value), rel=0.01)
    assert (done[0] / 'frontier.png').read_bytes().startswith(b'\x89PNG')


def test_the_table_names_what_was_found(done):
    rows = {line[:37].strip(): line[38:] for line in done[1].splitlines() if line}
    value, bound = float(rows['value z']), float(rows['lower bound'])
    assert 0.0 < bound <= value <= bound * (1.0 + StrategyOptions().risk_slack + 1e-5)
    assert value < float(rows['always the route of least risk'].split()[2])
    route, edge = (float(rows[f'{name} entropy'].split()[0]) for name in ('route', 'edge'))
    assert 0.0 < route < edge
    different, total = map(int, rows['different routes'].split(' of '))
    assert DEPARTURES - 1 <= different <= total == DEPARTURES
    assert float(rows['seconds'].split(';')[0]) > 0.0


def test_lines_are_short_and_json_is_the_object_in_the_help(done):
    told, begin, result = done[1].rpartition('\n{\n')
    lines = [*told.splitlines(), *done[2].splitlines()]
    assert max(len(line) for line in lines if str(done[0]) not in line) < 100
    result = json.loads(begin + result)
    assert set(result) == documented_keys(demo) and result['verdict'] == 'holds'
    assert result['departures'] == DEPARTURES and result['folder'] == str(done[0])


def test_progress_is_shown_step_by_step(done):
    times = [float(line.split()[0]) for line in done[2].splitlines() if line[5:9] == ' s  ']
    assert len(times) >= DEPARTURES + 4
    assert times == sorted(times)


def test_an_output_that_is_a_file_is_refused(tmp_path):
    (tmp_path / 'file').write_text('')
    done = run_here(demo, '-o', tmp_path / 'file')
    assert done.code == 3
    assert done.err.startswith('ambush_demo: ') and 'Traceback' not in done.err


@pytest.mark.parametrize(
    'missing, argument, code, words',
    [
        ('rclpy', '-n1', 3, 'rclpy is not installed; try: pip install'),
        ('matplotlib', '-n1', 3, 'matplotlib is not installed; try: pip install'),
    ],
)
def test_what_is_not_installed_is_named(missing, argument, code, words):
    program = (
        f"import sys; sys.modules['{missing}'] = None\n"
        f"from ambush_planner.commands.cli import main; sys.exit(main(['demo', '{argument}']))"
    )
    process = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, timeout=60, check=False
    )
    assert process.returncode == code
    assert words in process.stdout + process.stderr
    assert 'Traceback' not in process.stderr


@pytest.mark.parametrize('count', ['0', '-1', '1.5', 'many'])
def test_a_wrong_number_of_departures_is_refused(count, capsys):
    with pytest.raises(SystemExit) as exit_:
        demo.main([f'--departures={count}'])
    assert exit_.value.code == 2
    assert repr(count) in capsys.readouterr().err


def test_a_node_that_cannot_start_is_told_with_its_words(tmp_path):
    with free_domain() as domain:
        node = NodeProcess({'network.spacing': -1.0}, domain, tmp_path / 'log')
        with pytest.raises(NodeFailed, match=r'(?s)exit code 1.*network\.spacing'):
            with node, DemoClient(domain, node.check) as client:
                client.wait_for_node()


def test_an_interrupted_demo_takes_its_node_along(tmp_path):
    process = subprocess.Popen(
        # More departures than it will get to.
        [sys.executable, '-m', 'ambush_planner.commands.cli', 'demo', '-o', str(tmp_path),
         '-n', '100000'],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while 'publishing' not in process.stderr.readline():
        assert process.poll() is None
    assert nodes_of(tmp_path)
    process.send_signal(signal.SIGTERM)  # as Ctrl-C, which it is turned into
    _, errors = process.communicate(timeout=120.0)
    assert (process.returncode, errors.splitlines()[-1]) == (130, 'ambush_demo: interrupted')
    assert not nodes_of(tmp_path)


def test_interrupts_of_the_demo_wait_for_the_next_check():
    checks, passed = [], []
    with pytest.raises(KeyboardInterrupt), demo._interrupts_held(lambda: checks.append(1)) as check:
        check()
        for number in signal.SIGINT, signal.SIGTERM:
            signal.raise_signal(number)
        passed.append(True)  # neither interrupts here
        check()
        passed.append(False)
    assert (len(checks), passed) == (1, [True])
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(KeyboardInterrupt), demo._interrupts_held(lambda: None):
        signal.raise_signal(signal.SIGINT)  # after the last check


def nodes_of(folder: Path) -> list[str]:
    """Process ids of the nodes that record into ``folder``."""
    found = []
    for entry in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            words = entry.read_bytes()
        except OSError:  # it has just ended
            continue
        if b'planner_node' in words and str(folder).encode() in words:
            found.append(entry.parent.name)
    return found


def test_a_domain_that_somebody_is_in_is_not_free():
    context = Context()
    with free_domain() as domain:
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node('somebody', context=context)
        try:
            assert not is_free(domain)
        finally:
            node.destroy_node()
            rclpy.try_shutdown(context=context)


def test_a_domain_that_somebody_has_chosen_is_not_chosen_again(monkeypatch):
    with free_domain() as ours:
        monkeypatch.setattr(node_process, 'DOMAINS', [ours])
        with pytest.raises(NodeFailed, match='no ROS domain id is free'), free_domain():
            pass
    with free_domain() as again:
        assert again == ours
