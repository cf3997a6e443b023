"""A robot that asks again on its way gets the rest of its path: one departure a trip."""

import json
from importlib import import_module

import interfaces
import numpy as np
import pytest
from commands import run_here
from robots import ROBOT, Robot
from ros_harness import pose, risk_grid, stage, wait_until
from test_compute_path import Goals

from ambush_planner.commands import audit
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.recordings.verify import Verifier

FLAT = np.full((20, 20), 10, dtype=np.int8)
HERE, GOAL = pose(0.0, 0.0, frame='base_link'), pose(8.5, 5.5)


def answered(client, answer):
    """The path (L, 3) of a request from the robot, once the diagnostics call it ``answer``."""
    path = client.get_plan(HERE, GOAL)
    client.diagnostics(last_answer=answer)
    return path_from_ros(path)


def test_a_trip_that_is_continued_is_one_departure(tmp_path):
    with stage(tmp_path, parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        client.publish('alpha_map', risk_grid(FLAT))
        robot.is_at(1.5, 5.5)
        wait_until(lambda: running.planner._inputs._map is not None, 'the map')
        for trip in range(1, 6):
            robot.is_at(1.5, 5.5)
            whole = answered(client, 'new')
            for share in (0.0, 0.3, 0.5, 0.8):
                at = int(share * len(whole))
                robot.is_at(*whole[at, :2])
                rest = answered(client, 'continued')
                assert tuple(rest[0, :2]) == tuple(whole[at, :2])
                np.testing.assert_allclose(rest[1:], whole[at + 1:], atol=1e-12)
            assert client.diagnostics()['departures'] == str(trip)
            robot.is_at(8.4, 5.4)
            assert len(client.get_plan(HERE, GOAL).poses) == 1, 'arrived'
        assert len(client.received['path']) == 5
        wait_until(lambda: len(list(tmp_path.rglob('*.mcap'))) == 5, 'the recordings')
    seen = run_here(audit, tmp_path, '--json')
    assert seen.code == 0 and json.loads(seen.out)['departures'] == 5
    assert all(Verifier().verify(file).problems == [] for file in tmp_path.rglob('*.mcap'))


def test_a_new_route_is_always_drawn():
    with stage(parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        robot.is_at(1.5, 5.5)
        client.publish('alpha_map', risk_grid(FLAT))
        client.publish('goal_pose', GOAL)
        client.call_until('new_route', lambda answer: answer.success)
        assert client.call('new_route').success
        client.diagnostics(departures='2')
        answered(client, 'continued')
        client.diagnostics(departures='2')


def test_an_obstacle_on_the_path_diverts_the_robot_within_its_plan(monkeypatch):
    solves = []
    with stage(parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        robot.is_at(1.5, 5.5)
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: client.get_plan(HERE, GOAL).poses, 'a path')
        whole = path_from_ros(client.last('path'))
        solve = running.planner._dispatcher._plans.solve
        monkeypatch.setattr(running.planner._dispatcher._plans, 'solve',
                            lambda *given, **more: (solves.append(given), solve(*given, **more))[1])
        robot.is_at(*whole[len(whole) // 4, :2])
        blocked = FLAT.copy()
        column, row = np.floor(whole[len(whole) // 2, :2] / 0.5).astype(int)
        blocked[row, column] = 100
        client.publish('alpha_map', risk_grid(blocked))
        wait_until(lambda: running.planner._inputs.current_map().values[row, column] == 100, 'it')
        rest = answered(client, 'diverted')
        assert tuple(rest[0, :2]) == tuple(whole[len(whole) // 4, :2])
        assert tuple(rest[-1, :2]) == (8.5, 5.5)
        cells = np.floor(rest[:, :2] / 0.5).astype(int)
        assert not (cells == (column, row)).all(axis=1).any()
        assert path_from_ros(client.last('path', 2)).shape == rest.shape, 'it is published'
        robot.is_at(*rest[len(rest) // 2, :2])
        again = answered(client, 'continued')
        np.testing.assert_allclose(again[1:], rest[len(rest) // 2 + 1:], atol=1e-12)
        assert client.diagnostics()['departures'] == '1'
        assert not solves


def test_a_wall_across_all_routes_of_the_plan_makes_a_new_one():
    with stage(parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        robot.is_at(1.5, 5.5)
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: client.get_plan(HERE, GOAL).poses, 'a path')
        wall = FLAT.copy()
        wall[:19, 10] = 100
        client.publish('alpha_map', risk_grid(wall))
        wait_until(lambda: running.planner._inputs.current_map().values[0, 10] == 100, 'the wall')
        rest = answered(client, 'new')
        client.diagnostics(departures='2')
        assert rest[:, 1].max() > 9.5, 'round the wall'


@pytest.mark.parametrize('place', [(1.5, 8.5), (8.0, 1.0)])
def test_a_robot_that_stands_elsewhere_begins_a_new_trip(place):
    with stage(parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        robot.is_at(1.5, 5.5)
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: client.get_plan(HERE, GOAL).poses, 'a path')
        robot.is_at(*place)
        path = path_from_ros(client.get_plan(HERE, GOAL))
        assert tuple(path[0, :2]) == place
        client.diagnostics(departures='2', last_answer='new')


def test_a_robot_in_the_inflation_of_a_costmap_drives_out_straight(tmp_path):
    values = np.zeros((40, 40), np.int8)
    values[:, :8] = 99  # its own cell, too: 0.5 m from the free ones
    values[20:22, 20:22] = 100
    parameters = {**ROBOT, 'map.preset': 'costmap', 'game.ambush_radius': 0.5}
    with stage(tmp_path, parameters=parameters) as running:
        client, robot = running.client, Robot(running)
        client.publish('alpha_map', risk_grid(values, 0.25))
        wait_until(lambda: running.planner._inputs._map is not None, 'the map')
        robot.is_at(1.5, 5.1)
        path = answered(client, 'new')
        assert tuple(path[0, :2]) == (1.5, 5.1)
        assert path[1, 0] > 2.0 and abs(path[1, 1] - 5.1) < 0.5
        assert (np.hypot(*np.diff(path[:2, :2], axis=0).T) <= 1.0).all()
        robot.is_at(1.7, 5.1)
        answered(client, 'continued')
        robot.is_at(0.5, 5.1)
        assert not client.get_plan(HERE, GOAL).poses, 'more than a metre from free ground'
        client.diagnostics(code='START_OCCUPIED')
        wait_until(lambda: len(list(tmp_path.rglob('*.mcap'))) == 1, 'the recording')
    (file,) = tmp_path.rglob('*.mcap')
    assert Verifier().verify(file).problems == []


def test_a_missing_goal_pose_is_no_fault_once_a_request_brought_its_own():
    with stage(parameters=ROBOT) as running:
        client, robot = running.client, Robot(running)
        robot.is_at(1.5, 5.5)
        assert 'goal_pose' in client.diagnostics(state='waiting')['message']
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: client.get_plan(HERE, GOAL).poses, 'a path')
        assert 'goal_pose' not in client.diagnostics(state='ready')['message']


def test_a_trip_with_stops_is_continued_through_those_that_remain():
    """As Nav2's trees ask: the goals that have been passed are left out."""
    interfaces.install('nav2_msgs')
    action = import_module('nav2_msgs.action').ComputePathThroughPoses
    stops = [pose(3.0, 8.0), pose(6.0, 8.5)]
    try:
        with stage(parameters={**ROBOT, 'route.path_spacing': 0.25}) as running:
            client, robot = running.client, Robot(running)
            goals = Goals(action, running, 'compute_path_through_poses')
            robot.is_at(1.5, 5.5)
            client.publish('alpha_map', risk_grid(FLAT))
            wait_until(lambda: running.planner._inputs._map is not None, 'the map')

            def asked(*poses):
                result = goals.result(goals.send(start=None, goals=list(poses)))[1]
                return path_from_ros(result.path), result.error_msg

            whole, said = asked(*stops, GOAL)
            assert said == ''
            met = [int(np.hypot(*(whole[:, :2] - place).T).argmin())
                   for place in ((3.0, 8.0), (6.0, 8.5))]
            for at, rest in ((met[0] // 2, stops), (met[0] + 3, stops), (met[0] + 3, stops[1:]),
                             (met[1] + 3, stops[1:]), (met[1] + 3, [])):
                robot.is_at(*whole[at, :2])
                path, said = asked(*rest, GOAL)
                assert said == 'departure 1 continued'
                np.testing.assert_allclose(path[1:], whole[at + 1:], atol=1e-12)
            client.diagnostics(departures='1')
            blocked = FLAT.copy()
            column, row = np.floor(whole[(met[1] + len(whole)) // 2, :2] / 0.5).astype(int)
            blocked[row, column] = 100
            client.publish('alpha_map', risk_grid(blocked))
            wait_until(lambda: running.planner._inputs._map.values[row, column] == 100, 'it')
            path, said = asked(GOAL)
            assert 'departure 1 diverted' in said
            robot.is_at(*path[len(path) // 2, :2])
            assert asked(GOAL)[1] == asked(*stops, GOAL)[1] == 'departure 1 continued'
    finally:
        interfaces.uninstall('nav2_msgs')


def test_each_of_two_robots_continues_its_own_trip():
    with stage(parameters=ROBOT) as running:
        client = running.client
        robots = {frame: Robot(running, frame) for frame in ('base_link', 'van')}
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: running.planner._inputs._map is not None, 'the map')
        wholes = {}
        for frame, robot in robots.items():
            robot.is_at(1.5, 5.5)
            wholes[frame] = path_from_ros(client.get_plan(pose(0.0, 0.0, frame=frame), GOAL))
        client.diagnostics(departures='2')
        for frame, robot in robots.items():
            robot.is_at(*wholes[frame][3, :2])
            rest = path_from_ros(client.get_plan(pose(0.0, 0.0, frame=frame), GOAL))
            np.testing.assert_allclose(rest[1:], wholes[frame][4:], atol=1e-12)
        client.diagnostics(departures='2', last_answer='continued')


def test_a_robot_that_asks_again_while_its_plan_is_solved_departs_once():
    interfaces.install('nav2_msgs')
    action = import_module('nav2_msgs.action').ComputePathToPose
    try:
        with stage(parameters=ROBOT) as running:
            client, robot = running.client, Robot(running)
            goals = Goals(action, running, 'compute_path_to_pose')
            robot.is_at(1.5, 5.5)
            client.publish('alpha_map', risk_grid(FLAT))
            wait_until(lambda: running.planner._inputs._map is not None, 'the map')
            handles = [goals.send(start=None) for _ in range(3)]
            said = [goals.result(each)[1].error_msg for each in handles]
            assert sorted(said) == ['', 'departure 1 continued', 'departure 1 continued']
            client.diagnostics(departures='1')
    finally:
        interfaces.uninstall('nav2_msgs')
