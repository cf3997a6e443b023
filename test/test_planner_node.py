"""The node: departures, the plan cache, secrets, diagnostics, and its arguments."""

import math
import re

import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_harness import MARKER_TOPICS, pose, risk_grid, stage
from waiting import unstamped

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.planning import changed_ground as ground
from ambush_planner.ros.planner_node import check_arguments, main

START, GOAL = pose(1.5, 5.5, 0.3), pose(8.5, 5.5, -2.0)
KEYS = {
    'state', 'code', 'message', 'value', 'lower_bound', 'gap', 'edge_entropy', 'route_entropy',
    'entropy_gap', 'value_holds_at', 'held_radius',
    'expected_length', 'shortest_length', 'nodes', 'edges', 'deciding_sites',
    'deciding_sites_near_ends', 'secured_value', 'stops', 'order', 'solve_seconds', 'departures',
    'departure_id', 'departure_value', 'departure_gap', 'recording', 'current_value', 'current_gap',
    'current_length', 'stale', 'last_answer', 'tight_turns', 'different_paths_of_1000', 'value_is',
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


def test_departures_differ_and_solve_once(client):
    # The most probable two of the 42 paths have 0.35 together: fewer than three, 1 in 10^8.
    assert differ(departures(client, 20)) >= 3
    for topic in MARKER_TOPICS:
        assert len(client.received[topic]) == 1, topic
    client.diagnostics(departures='20', code='NONE')


def test_a_new_goal_a_new_map_and_new_parameters_are_solved_again(running):
    client = running.client
    departures(client, 1)
    client.publish('goal_pose', pose(8.5, 7.5))
    client.call_until('new_route', lambda _: client.last('path').poses[-1].pose.position.y == 7.5)
    client.last('edge_probabilities', 2)
    client.publish('alpha_map', risk_grid(np.zeros((20, 20), dtype=np.int8)))
    client.call_until('new_route', lambda _: len(client.received['edge_probabilities']) == 3)
    running.planner.set_parameters([Parameter('strategy.max_detour', value=1.3)])
    departures(client, 1)
    client.last('edge_probabilities', 4)


def test_the_same_map_again_changes_nothing(client):
    departures(client, 1)
    client.publish('alpha_map', risk_grid())
    client.publish('goal_pose', pose(8.5, 5.5, 1.0))
    client.call_until('new_route', lambda _: client.last('path').poses[-1].pose != GOAL.pose)
    assert len(client.received['edge_probabilities']) == 1


def test_parameters_of_the_map_are_applied_to_the_current_map(running):
    running.planner.set_parameters([Parameter('map.obstacle_threshold', value=10)])
    answer = running.client.call('new_route')
    assert not answer.success
    assert 'start (1.500, 5.500) lies in an obstacle' in answer.message


def test_a_seed_gives_the_same_sequence_and_none_another_one():
    runs = []
    for seed in (11, 11, -1, -1):
        with stage(parameters={'seed': seed}) as running:
            runs.append(np.vstack(departures(running.give(), 10)).tobytes())
    assert runs[0] == runs[1]
    assert len(set(runs)) == 3


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


def test_a_goal_within_a_cell_of_the_start_is_a_path_of_one_pose(client):
    assert client.get_plan(START, GOAL).poses
    for goal in (START, pose(1.6, 5.8, yaw=1.0)):
        (only,) = client.get_plan(START, goal).poses
        assert only.pose == goal.pose
    assert client.diagnostics(departures='1', code='NONE')
    assert len(client.received['path']) == 1, 'no departure'
    assert not client.get_plan(START, pose(5.0, 5.5)).poses
    assert not client.get_plan(pose(5.0, 5.5), pose(5.0, 5.5)).poses
    client.diagnostics(code='START_OCCUPIED')


def test_a_path_stays_when_map_goal_and_parameters_change(running):
    client = running.client
    (gone,) = departures(client, 1)
    departure = client.diagnostics(departures='1')['departure_id']
    client.publish('alpha_map', risk_grid(np.full((20, 20), 7, dtype=np.int8)))
    client.publish('goal_pose', pose(2.5, 2.5))
    running.planner.set_parameters([Parameter('game.secured_radius', value=1.0)])
    # The answer comes after whatever the changes have set off.
    client.publish('alpha_map', risk_grid(np.array([[101]])))
    client.diagnostics(code='INVALID_MAP', departure_id=departure)
    assert len(client.received['path']) == 1
    assert (path_from_ros(client.last('path')) == gone).all()


def test_warns_of_a_bottleneck_at_the_ends():
    with stage(parameters={'game.secured_radius': 0.0}) as running:
        assert running.give().call('new_route').success
        report = running.client.diagnostics(departures='1', level=b'\1')
        assert re.fullmatch(
            r'ready; (\d+) nodes decide the value [\d.]+, \d+ of them within [\d.]+ m of start or '
            r'goal; if that ground were held \(game.secured_radius\), the value would be [\d.]+',
            report['message'])
        assert report['deciding_sites'] in report['message']
        assert float(report['secured_value']) < float(report['value'])


def test_turns_tighter_than_the_turning_radius_are_counted():
    values = np.zeros((20, 20), np.int8)
    values[3:, 9] = 100  # the only way is round its lower end
    with stage(parameters={'route.turning_radius': 50.0}) as running:
        assert running.give(risk_grid(values)).call('new_route').success
        report = running.client.diagnostics(departures='1', level=b'\1')
        assert int(report['tight_turns']) > 0
        assert 'tighter than route.turning_radius' in report['message']
        assert 1 <= int(report['different_paths_of_1000']) <= 1000


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


def test_neither_seed_nor_route_is_logged_or_reported(capfd):
    with stage(parameters={'seed': 987654321}) as running:
        # An origin that gives the nodes distinctive coordinates.
        client = running.give(risk_grid(origin=(0.1234, 0.5678, 0.0)))
        path = departures(client, 1)[0]
        client.diagnostics(departures='1')
        assert not client.get_plan(START, pose(5.0, 5.5)).poses
        client.diagnostics(code='GOAL_OCCUPIED')
        said = str(client.received['/diagnostics']) + unstamped(''.join(capfd.readouterr()))
    assert 'the parameter seed is set' in said
    assert '987654321' not in said
    assert len(path) > 5
    assert not re.search(r'\d\.(1234|5678|6234|0678)', said)


def test_an_unexpected_error_is_answered_without_its_message(client, monkeypatch, capfd):
    def broken(*_):
        raise RuntimeError(f'went through ({math.pi}, {math.e})')

    with monkeypatch.context() as patch:
        patch.setattr(ground, 'depart', broken)
        answer = client.call('new_route')
    assert not answer.success
    assert answer.message == 'internal error (RuntimeError); the log says where'
    client.diagnostics(code='UNKNOWN', level=b'\2')
    log = unstamped(capfd.readouterr().err)
    assert 'in broken' in log
    assert '3.14159' not in log
    assert client.call('new_route').success
    client.diagnostics(code='NONE')


def test_help_is_printed_and_arguments_of_ros_are_accepted(capsys):
    check_arguments(['--ros-args', '-p', 'seed:=1', '-r', '__node:=planner'])
    with pytest.raises(SystemExit) as ended:
        check_arguments(['--ros-args', '-p', 'seed:=1', '--', '-h'])
    assert ended.value.code == 0
    assert 'usage: ros2 run' in capsys.readouterr().out


@pytest.mark.parametrize('arguments', [('my.yaml',), ('--params-file', 'my.yaml')])
def test_a_stray_argument_is_an_error(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f'ambush_planner: error: unrecognized arguments: {" ".join(arguments)}'


def test_a_patrol_of_five_legs_is_solved_once(client, submitted):
    places = [(1.5, 5.5), (3.0, 8.5), (8.5, 8.5), (8.5, 1.5), (2.5, 1.5)]
    for _ in range(2):
        for start, goal in zip(places, places[1:] + places[:1], strict=True):
            assert client.get_plan(pose(*start), pose(*goal)).poses
    client.diagnostics(departures='10')
    assert len(submitted) == 5
