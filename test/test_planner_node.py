# SPDX-License-Identifier: Apache-2.0
"""The node: departures, the plan cache, secrets, diagnostics, and its arguments."""

import math
import re

import numpy as np
import pytest
from commands import table_under
from ros_harness import MARKER_TOPICS, pose, risk_grid, stage
from waiting import unstamped, wait_until

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.planning import changed_ground as ground
from ambush_planner.ros.planner_node import check_arguments, main

START, GOAL = pose(1.5, 5.5, 0.3), pose(8.5, 5.5, -2.0)


@pytest.fixture(scope='module')
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


def documented_keys():
    return {key for keys, _ in table_under('docs/ros_interface.md', 'Diagnostics')
            for key in re.findall(r'`(\w+)`', keys)}


def test_departures_are_solved_once_for_each_goal_map_and_choice_of_parameters():
    with stage() as running:
        client, shown = running.client, running.client.received['edge_probabilities']
        report = client.diagnostics(state='waiting')
        assert report['message'] == 'waiting for /alpha_map, /start_pose, /goal_pose'
        assert set(report) == documented_keys() | {'level'}
        paths = departures(running.give(), 20)
        # The most probable two of the 42 paths have 0.35 together: fewer than three, 1 in 10^8.
        assert len({path.tobytes() for path in paths}) >= 3
        report = client.diagnostics(departures='20', code='NONE')
        assert set(report) == documented_keys() | {'level'}
        assert float(report['value']) >= float(report['lower_bound']) > 0.0
        assert report['value_is'] == 'mean loss'
        assert all(len(client.received[topic]) == 1 for topic in MARKER_TOPICS)
        client.publish('alpha_map', risk_grid())  # the same again
        client.publish('goal_pose', pose(8.5, 5.5, 1.0))
        client.call_until(
            'new_route', lambda _: client.last('path').poses[-1].pose == pose(8.5, 5.5, 1.0).pose)
        assert len(shown) == 1
        client.publish('goal_pose', pose(8.5, 7.5))
        client.call_until(
            'new_route', lambda _: client.last('path').poses[-1].pose.position.y == 7.5)
        client.last('edge_probabilities', 2)
        client.publish('alpha_map', risk_grid(np.full((20, 20), 20, dtype=np.int8)))
        client.call_until('new_route', lambda _: len(shown) == 3)
        running.use({'strategy.max_detour': 1.3})
        departures(client, 1)
        client.last('edge_probabilities', 4)
        # A parameter of the map is applied to the map that is there.
        running.use({'map.obstacle_threshold': 10})
        assert 'lies in an obstacle' in client.call('new_route').message
        client.last('/diagnostics', len(client.received['/diagnostics']) + 2)


def test_a_path_stays_when_map_goal_and_parameters_change():
    with stage() as running:
        client = running.give()
        (gone,) = departures(client, 1)
        departure = client.diagnostics(departures='1')['departure_id']
        client.publish('alpha_map', risk_grid(np.full((20, 20), 7, dtype=np.int8)))
        client.publish('goal_pose', pose(2.5, 2.5))
        running.use({'game.secured_radius': 1.0})
        # The answer comes after whatever the changes have set off.
        client.publish('alpha_map', risk_grid(np.array([[101]])))
        client.diagnostics(code='INVALID_MAP', departure_id=departure)
        assert len(client.received['path']) == 1
        assert (path_from_ros(client.last('path')) == gone).all()


def test_a_seed_repeats_the_sequence_and_neither_seed_nor_route_is_told(capfd):
    runs = []
    for _ in range(2):
        with stage(parameters={'seed': 987654321}) as running:
            # An origin that gives the nodes distinctive coordinates.
            client = running.give(risk_grid(origin=(0.1234, 0.5678, 0.0)))
            runs.append(np.vstack(departures(client, 5)))
            client.diagnostics(departures='5')
            assert not client.get_plan(START, pose(5.0, 5.5)).poses
            client.diagnostics(code='GOAL_OCCUPIED')
            said = str(client.received['/diagnostics'])
    assert np.array_equal(*runs) and len(runs[0]) > 25
    said += unstamped(''.join(capfd.readouterr()))
    assert 'the parameter seed is set' in said
    assert '987654321' not in said
    assert not re.search(r'\d\.(1234|5678|6234|0678)', said)


def test_goal_moves_as_far_as_the_tolerance_and_no_further(client):
    blocked = pose(5.1, 5.6, 1.0)  # 0.9 m from the block's left edge, 0.9 m + to a free centre
    assert not client.get_plan(START, blocked, 0.5).poses
    client.diagnostics(code='GOAL_OCCUPIED')
    last = client.get_plan(START, blocked, 2.0).poses[-1].pose
    assert (last.position.x, last.position.y) == (6.25, 5.75), 'the nearest free centre'
    assert last.orientation == blocked.pose.orientation
    assert client.get_plan(START, GOAL, 2.0).poses[-1].pose == GOAL.pose, 'not blocked'


def test_a_goal_within_a_cell_of_the_start_is_a_path_of_one_pose():
    with stage() as running:
        client = running.give()
        for goal in (START, pose(1.6, 5.8, yaw=1.0)):
            (only,) = client.get_plan(START, goal).poses
            assert only.pose == goal.pose
        assert client.get_plan(START, GOAL).poses
        client.diagnostics(departures='1', code='NONE')
        assert not client.get_plan(pose(5.0, 5.5), pose(5.0, 5.5)).poses
        client.diagnostics(departures='1', code='START_OCCUPIED')


@pytest.mark.parametrize('name, value, counted, words', [
    ('game.secured_radius', 0.0, 'deciding_sites', 'game.secured_radius'),
    ('route.turning_radius', 50.0, 'tight_turns', 'route.turning_radius'),
])
def test_warns_of_a_bottleneck_at_the_ends_and_of_tight_turns(running, name, value, counted, words):
    client, before = running.client, running.planner.get_parameter(name).value
    running.use({name: value})
    assert client.call('new_route').success
    wait_until(lambda: words in client.diagnostics(code='NONE', level=b'\1')['message'], words)
    report = client.diagnostics(code='NONE', level=b'\1')
    assert re.search(rf'\b{report[counted]} ', report['message'])
    assert report['search_ended'] == 'complete'
    running.use({name: before})


def rows_with(running, spacing, path_spacing=0.0):
    """Poses (L, 3) of a path that the node plans with other spacings."""
    running.use({'network.spacing': spacing, 'route.path_spacing': path_spacing})
    return path_from_ros(running.client.get_plan(START, GOAL))


def steps(rows):
    return np.hypot(*np.diff(rows[:, :2], axis=0).T)


def test_poses_are_as_far_apart_as_nodes_or_cells_or_the_parameter_say(running):
    longest = steps(rows_with(running, 1.0)).max()
    assert 0.5 < longest <= 1.0 + 1e-9, 'nodes lie further apart than cells'
    longest = steps(rows_with(running, 0.25)).max()
    assert 0.25 <= longest <= 0.5 + 1e-9, 'cells are larger'
    longest = steps(rows_with(running, 1.0, 0.1)).max()
    assert 0.05 < longest <= 0.1 + 1e-9


@pytest.mark.parametrize('spacing', [1e-4, 5e-324])
def test_a_path_of_too_many_poses_is_refused(running, spacing):
    assert not len(rows_with(running, 1.0, spacing))
    report = running.client.diagnostics(code='INVALID_OPTION')
    assert 'route.path_spacing' in report['message']
    assert len(rows_with(running, 1.0))
    running.client.diagnostics(code='NONE')


def test_an_unexpected_error_is_answered_without_its_message(client, monkeypatch, capfd):
    def broken(*_):
        raise RuntimeError(f'went through ({math.pi}, {math.e})')

    with monkeypatch.context() as patch:
        patch.setattr(ground.ChangedGround, 'draw', broken)
        answer = client.call('new_route')
    assert not answer.success
    assert answer.message == 'internal error (RuntimeError); the log says where'
    client.diagnostics(code='UNKNOWN', level=b'\2')
    log = unstamped(capfd.readouterr().err)
    assert 'in broken' in log
    assert '3.14159' not in log
    assert client.call('new_route').success
    client.diagnostics(code='NONE')


def test_help_is_printed_and_a_stray_argument_is_an_error(capsys):
    check_arguments(['--ros-args', '-p', 'seed:=1', '-r', '__node:=planner'])
    with pytest.raises(SystemExit) as ended:
        check_arguments(['--ros-args', '-p', 'seed:=1', '--', '-h'])
    assert ended.value.code == 0 and 'usage: ros2 run' in capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        main(['--params-file', 'my.yaml'], [])
    assert ended.value.code == 2 and '--params-file my.yaml' in capsys.readouterr().err
