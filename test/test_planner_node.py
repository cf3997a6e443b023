"""The node in this process: departures, the cache, secrets, and what goes on meanwhile."""

import math
import re
import threading

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import Parameter
from recording_samples import read_with_rosbags
from ros_harness import (
    FRAME,
    MARKER_TOPICS,
    TIMEOUT,
    header,
    pose,
    risk_grid,
    stage,
    wait_until,
)

from ambush_planner.core.obstacles import ObstacleField
from ambush_planner.core.risk_map import OccupancyOptions
from ambush_planner.ros import planning
from ambush_planner.ros.conversions import path_from_ros, pose_to_ros, risk_map_from_ros

START, GOAL = pose(1.5, 5.5, 0.3), pose(8.5, 5.5, -2.0)
KEYS = {
    'state', 'code', 'message', 'value', 'lower_bound', 'gap', 'edge_entropy', 'route_entropy',
    'expected_length', 'shortest_length', 'nodes', 'edges', 'deciding_sites',
    'deciding_sites_near_ends', 'secured_value', 'solve_seconds', 'departures', 'recording',
}


@pytest.fixture
def running():
    with stage() as running:
        running.give()
        yield running


@pytest.fixture
def client(running):
    return running.client


def departures(client, count):
    """The paths (L, 3) of some departures."""
    paths = []
    for _ in range(count):
        before = len(client.received['path'])
        assert client.call('new_route').success
        paths.append(path_from_ros(client.last('path', before + 1)))
    return paths


def differ(paths):
    return len({path.tobytes() for path in paths})


def test_path_is_dense_clear_and_ends_exactly(client):
    path = client.get_plan(START, GOAL)
    assert path.header.frame_id == FRAME
    assert (path.header.stamp.sec, path.header.stamp.nanosec) != (0, 0)
    assert path.poses[0].pose.position == START.pose.position
    assert path.poses[-1].pose == GOAL.pose
    rows = path_from_ros(path)
    steps = np.diff(rows[:, :2], axis=0)
    assert np.hypot(*steps.T).max() <= 1.0 + 1e-9, 'network.spacing is more than the resolution'
    np.testing.assert_allclose(rows[:-1, 2], np.arctan2(steps[:, 1], steps[:, 0]), atol=1e-9)
    field = ObstacleField(risk_map_from_ros(risk_grid(), OccupancyOptions()))
    assert field.clear_segments(rows[:-1, :2], rows[1:, :2], 0.0).all()


def test_path_spacing_is_a_parameter(running):
    running.planner.set_parameters([Parameter('route.path_spacing', value=0.1)])
    rows = path_from_ros(running.client.get_plan(START, GOAL))
    assert 0.05 < np.hypot(*np.diff(rows[:, :2], axis=0).T).max() <= 0.1 + 1e-9


def test_get_plan_publishes_what_it_answers(client):
    assert client.get_plan(START, GOAL) == client.last('path')


def test_departures_differ_and_solve_once(client):
    assert differ(departures(client, 5)) >= 4
    for topic in MARKER_TOPICS:
        assert len(client.received[topic]) == 1, topic
    client.diagnostics(departures='5', code='NONE', level=b'\0')


def test_a_new_goal_a_new_map_and_new_parameters_are_planned_anew(running):
    client = running.client
    departures(client, 1)
    client.publish('goal_pose', pose(8.5, 7.5))
    client.call_until(
        'new_route', lambda _: client.last('path').poses[-1].pose.position.y == 7.5)
    client.last('edge_probabilities', 2)
    client.publish('alpha_map', risk_grid(np.zeros((20, 20), dtype=np.int8)))
    client.call_until('new_route', lambda _: len(client.received['edge_probabilities']) == 3)
    running.planner.set_parameters([Parameter('strategy.max_detour', value=1.2)])
    departures(client, 1)
    client.last('edge_probabilities', 4)


def test_going_back_and_forth_shows_the_strategy_in_force_without_solving(client, monkeypatch):
    client.get_plan(START, GOAL)
    client.get_plan(GOAL, START)
    monkeypatch.setattr(planning, 'plan', None)
    assert client.get_plan(START, GOAL).poses
    client.last('edge_probabilities', 3)


def test_the_same_map_again_changes_nothing(client):
    departures(client, 1)
    client.publish('alpha_map', risk_grid())
    client.publish('goal_pose', pose(8.5, 5.5, 1.0))
    client.call_until('new_route', lambda _: client.last('path').poses[-1].pose != GOAL.pose)
    assert len(client.received['edge_probabilities']) == 1


def test_parameters_of_the_map_are_applied_to_the_map_in_force(running):
    running.planner.set_parameters([Parameter('map.obstacle_threshold', value=10)])
    answer = running.client.call('new_route')
    assert not answer.success
    assert 'start (1.500, 5.500) lies in an obstacle' in answer.message


def test_a_seed_gives_the_same_sequence_and_none_another_one():
    runs = []
    for seed in (11, 11, -1, -1):
        with stage(parameters={'seed': seed}) as running:
            runs.append(np.vstack(departures(running.give(), 4)).tobytes())
    assert runs[0] == runs[1]
    assert len(set(runs)) == 3


def test_replan_solves_without_a_departure(client):
    departures(client, 1)
    answer = client.call('replan')
    assert answer.success
    assert answer.message.startswith('solved in ')
    client.last('edge_probabilities', 2)
    assert client.diagnostics()['departures'] == '1'
    assert len(client.received['path']) == 1


def test_initialpose_sets_the_start(client):
    estimate = PoseWithCovarianceStamped(header=header())
    estimate.pose.pose = pose_to_ros(2.5, 1.5)
    client.publish('initialpose', estimate)
    client.call_until('new_route', lambda _: client.received['path'] and
                      client.last('path').poses[0].pose.position == estimate.pose.pose.position)


def test_rotated_map_in_its_own_frame():
    grid = risk_grid(origin=(100.0, -50.0, math.pi / 2), frame='site')
    with stage() as running:
        client = running.client
        client.publish('alpha_map', grid)
        client.diagnostics(message='waiting for start_pose, goal_pose')
        path = client.get_plan(
            pose(94.5, -48.5, frame='site'), pose(94.5, -41.5, frame='site'))
        assert path.header.frame_id == 'site'
        assert client.last('edge_probabilities').markers[0].header.frame_id == 'site'


def test_two_nodes_in_namespaces_of_their_own():
    with stage(namespace='/convoy') as running:
        assert running.give().call('new_route').message == (
            'departure 1 is published on /convoy/path')
        assert running.client.received['/diagnostics'][-1].status[0].name == (
            'convoy/ambush_planner')


def test_goal_moves_as_far_as_the_tolerance_and_no_further(client):
    blocked = pose(5.1, 5.6, 1.0)  # 0.9 m from the block's left edge, 0.9 m + to a free centre
    assert not client.get_plan(START, blocked, 0.5).poses
    client.diagnostics(code='GOAL_OCCUPIED')
    path = client.get_plan(START, blocked, 2.0)
    last = path.poses[-1].pose
    moved = math.dist((last.position.x, last.position.y), (5.1, 5.6))
    assert 1.0 < moved <= 2.0
    assert last.orientation == blocked.pose.orientation
    assert (last.position.x, last.position.y) == (6.25, 5.75), 'the nearest free centre'
    assert client.get_plan(START, GOAL, 2.0).poses[-1].pose == GOAL.pose, 'not blocked'


def test_recordings_hold_inputs_and_outputs(tmp_path):
    with stage(directory=tmp_path, parameters={'seed': 5}) as running:
        departures(running.give(), 2)
        wanted = running.client.last('path')
    files = sorted(tmp_path.rglob('*.mcap'))
    assert len(files) == 2
    rows = read_with_rosbags(files[1])
    topics = [topic for topic, _, _ in rows]
    assert sorted(set(topics)) == sorted(
        ['/alpha_map', '/start_pose', '/goal_pose', '/path', '/diagnostics',
         *(f'/{topic}' for topic in MARKER_TOPICS)])
    assert set(topics[:3]) == {'/alpha_map', '/start_pose', '/goal_pose'}
    (path,) = [message for topic, _, message in rows if topic == '/path']
    assert [(p.pose.position.x, p.pose.position.y) for p in path.poses] == [
        (p.pose.position.x, p.pose.position.y) for p in wanted.poses]
    times = [time for _, time, _ in rows]
    assert times[-1] - times[0] < 60e9


def test_a_failed_recording_does_not_fail_the_departure(tmp_path):
    file = tmp_path / 'file'
    file.write_text('')
    with stage(directory=file / 'below') as running:
        answer = running.give().call('new_route')
        assert answer.success
        assert 'recording failed' in answer.message
        report = running.client.diagnostics(code='RECORDING_FAILED', recording='failed')
        assert report['level'] == b'\2'
        running.planner.set_parameters(
            [Parameter('recording.directory', value=str(tmp_path / 'good'))])
        assert running.client.call('new_route').message == (
            'departure 2 is published on /path')
        running.client.diagnostics(code='NONE', recording='on')


def test_diagnostics_have_stable_keys_once_a_second():
    with stage() as running:
        client = running.client
        report = client.diagnostics(state='waiting')
        assert report['message'] == 'waiting for alpha_map, start_pose, goal_pose'
        assert set(report) == KEYS | {'level'}
        running.give()
        client.call('new_route')
        report = client.diagnostics(departures='1')
        assert set(report) == KEYS | {'level'}
        assert float(report['value']) >= float(report['lower_bound']) > 0.0
        client.last('/diagnostics', len(client.received['/diagnostics']) + 2)


def test_neither_seed_nor_route_is_told(capfd):
    with stage(parameters={'seed': 987654321}) as running:
        # An origin that gives nodes coordinates like no other number that is told.
        client = running.give(risk_grid(origin=(0.1234, 0.5678, 0.0)))
        path = departures(client, 1)[0]
        client.diagnostics(departures='1')
        assert not client.get_plan(START, pose(5.0, 5.5)).poses
        client.diagnostics(code='GOAL_OCCUPIED')
        said = str(client.received['/diagnostics']) + ''.join(capfd.readouterr())
    assert 'the parameter seed is fixed' in said
    assert '987654321' not in said
    assert len(path) > 5
    assert not re.search(r'\d\.(1234|5678|6234|0678)', said)


def test_everything_else_answers_during_a_solve(running, monkeypatch):
    client, solve, go_on = running.client, planning.plan, threading.Event()

    def slow(*arguments):
        assert go_on.wait(TIMEOUT)
        return solve(*arguments)

    monkeypatch.setattr(planning, 'plan', slow)
    future = client.send('new_route')
    try:
        client.diagnostics(state='solving')
        get = client.node.create_client(GetParameters, '/ambush_planner/get_parameters')
        assert get.wait_for_service(timeout_sec=TIMEOUT)
        values = get.call_async(GetParameters.Request(names=['strategy.solver']))
        wait_until(values.done, 'parameters during a solve')
        client.publish('alpha_map', risk_grid(np.array([[101]])))
        client.diagnostics(code='INVALID_MAP', state='solving')
        assert not future.done()
    finally:
        go_on.set()
    wait_until(future.done, 'the departure')
    assert future.result().success


def test_an_unknown_error_is_answered_and_keeps_its_words_to_itself(client, monkeypatch, capfd):
    def broken(*_):
        raise RuntimeError(f'went through ({math.pi}, {math.e})')

    with monkeypatch.context() as patch:
        patch.setattr(planning, 'plan', broken)
        answer = client.call('new_route')
    assert not answer.success
    assert answer.message == 'internal error (RuntimeError); the log says where'
    client.diagnostics(code='UNKNOWN', level=b'\2')
    log = capfd.readouterr().err
    assert 'in broken' in log
    assert '3.14159' not in log
    assert client.call('new_route').success
    client.diagnostics(code='NONE', level=b'\0')
