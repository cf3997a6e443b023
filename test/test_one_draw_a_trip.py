# SPDX-License-Identifier: Apache-2.0
"""A robot that asks again on its way gets the rest of its path: one departure a trip."""

import json
import math
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from unittest import mock

import numpy as np
import pytest
from commands import run_here
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from robots import ROBOT, Robot
from ros_harness import FLAT, GOAL, pose, recorded, risk_grid, stage, wait_until
from test_compute_path import Goals
from waiting import TIMEOUT, answer_of, held

from ambush_planner.commands import audit
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.recordings import durable_files
from ambush_planner.recordings.recorded_departures import read_departures, together
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros import recordings as recordings_module
from ambush_planner.worker.process import WorkerProcess

pytestmark = pytest.mark.usefixtures('nav2')
HERE = pose(0.0, 0.0, frame='base_link')
BY_CHANCE = 'far more or less often'  # a finding of one honest audit in a thousand


class Drive:
    """A robot that asks the planner for paths from where it is."""

    def __init__(self, running, frame='base_link'):
        self.running, self.client = running, running.client
        self.robot, self.here = Robot(running, frame), pose(0.0, 0.0, frame=frame)

    def arrive(self):
        """Be at the start, and let the planner know the map."""
        self.robot.is_at(1.5, 5.5)
        self.running.know(FLAT)

    def begin(self):
        self.arrive()
        return self.ask('new')

    def ask(self, answer, goal=GOAL):
        """The path (L, 3) of a request, once the diagnostics call it ``answer``."""
        path = self.client.get_plan(self.here, goal)
        self.client.diagnostics(last_answer=answer)
        return path_from_ros(path)

    @cached_property
    def through_poses(self):
        return Goals(self.running, 'poses')

    def ask_through(self, *poses):
        """The path (L, 3) of the action through poses, and its message."""
        goals = self.through_poses
        result = goals.result(goals.send(start=None, goals=list(poses)))[1]
        return path_from_ros(result.path), result.error_msg

    def block(self, row, column):
        """Put an obstacle into cells of the map, and wait until the planner knows it."""
        values = FLAT.copy()
        values[row, column] = 100
        self.running.know(values)

    def departures(self, count):
        return self.client.diagnostics(departures=str(count))


@pytest.fixture
def drive():
    with stage(parameters=ROBOT) as running:
        yield Drive(running)


def assert_rest(rest, whole, at):
    assert tuple(rest[0, :2]) == tuple(whole[at, :2])
    np.testing.assert_allclose(rest[1:], whole[at + 1:], atol=1e-12)


def cell(path, at):
    column, row = np.floor(path[at, :2] / 0.5).astype(int)
    return row, column


def test_a_trip_that_is_continued_is_one_departure(tmp_path):
    with stage(tmp_path, parameters=ROBOT) as running:
        drive, client = Drive(running), running.client
        assert 'goal_pose' in client.diagnostics(state='waiting')['message']
        whole = drive.begin()
        assert 'goal_pose' not in client.diagnostics(state='ready')['message'], 'requests have it'
        for trip in range(1, 6):
            for at in (0, int(0.3 * len(whole)), int(0.8 * len(whole))):
                drive.robot.is_at(*whole[at, :2])
                assert_rest(drive.ask('continued'), whole, at)
            drive.departures(trip)
            drive.robot.is_at(8.4, 5.4)
            assert len(client.get_plan(HERE, GOAL).poses) == 1, 'arrived'
            drive.robot.is_at(1.5, 5.5)
            whole = drive.ask('new')
        assert len(client.received['path']) == 6
        files = recorded(tmp_path, 6)
    seen = json.loads(run_here(audit, tmp_path, '--json').out)
    assert seen['departures'] == 6
    assert [each for each in seen['findings'] if BY_CHANCE not in each] == []
    assert not any(Verifier().verify(file).problems for file in files)


@contextmanager
def slow_disk():
    """A disk that does not answer until the second of the yielded events is set."""
    with (mock.patch.object(recordings_module, '_MAX_WAIT', 10 * TIMEOUT),
          held(durable_files.os, 'fsync') as events):
        yield events


def test_a_robot_that_asks_again_while_its_departure_is_recorded_departs_once(tmp_path):
    request = GetPlan.Request(start=HERE, goal=GOAL)
    with stage(tmp_path, parameters={**ROBOT, 'recording.required': True}) as running:
        drive, client = Drive(running), running.client
        drive.arrive()
        with slow_disk() as (asked, go_on):
            answers = [client.send('get_plan', request) for _ in range(5)]
            wait_until(asked.is_set, 'a recording')
            answers.append(client.send('get_plan', request))
            assert not client.get_plan(pose(math.nan, 0.0), GOAL).poses, 'answered after it'
            assert not client.received['path'] and not any(each.done() for each in answers)
            drive.robot.is_at(3.0, 7.5)  # on another path
            answers.append(client.send('get_plan', request))
            assert not client.get_plan(pose(math.nan, 0.0), GOAL).poses, 'answered after it'
            go_on.set()
            wait_until(lambda: all(each.done() for each in answers), 'the answers')
        drawn, *rests = [path_from_ros(each.result().plan) for each in answers]
        assert all(tuple(each[0, :2]) == (3.0, 7.5) for each in rests), 'from where it is by now'
        assert all(np.isin(each[1:-1, 0], drawn[:, 0]).all() for each in rests)
        drive.departures(1)
        assert len(client.received['path']) == 1 == len(recorded(tmp_path, 1))


def test_new_routes_and_robots_elsewhere_are_departures_and_each_robot_has_its_own(drive):
    client, van = drive.client, Drive(drive.running, 'van')
    wholes = drive.begin(), van.begin()
    drive.departures(2)
    for each, whole in zip((drive, van), wholes, strict=True):
        each.robot.is_at(*whole[3, :2])
        assert_rest(each.ask('continued'), whole, 3)
    drive.departures(2)
    drive.robot.is_at(8.0, 1.0)
    assert tuple(drive.ask('new')[0, :2]) == (8.0, 1.0)
    client.publish('goal_pose', GOAL)
    client.call_until('new_route', lambda answer: answer.success)
    assert client.call('new_route').success
    drive.departures(5)
    drive.ask('continued')
    drive.departures(5)


def test_a_goal_that_is_looked_up_ends_no_trip(drive):
    whole, van = drive.begin(), Drive(drive.running, 'van')
    van_whole = van.begin()
    drive.robot.is_at(*whole[3, :2])
    for number, goal in enumerate((pose(8.5, 1.5), pose(1.5, 1.5), pose(8.5, 8.5)), 3):
        drive.ask('new', goal)
        drive.departures(number)
        drive.robot.is_at(*whole[3 + number, :2])
        assert_rest(drive.ask('continued'), whole, 3 + number)
    van.robot.is_at(*van_whole[3, :2])
    assert_rest(van.ask('continued'), van_whole, 3)
    drive.departures(5)


def diverted(drive, whole, share, paths):
    """The rest of the path (L, 3), once an obstacle has come up halfway along what remains."""
    at = int(share * len(whole))
    drive.robot.is_at(*whole[at, :2])
    blocked = cell(whole, (at + len(whole)) // 2)
    drive.block(*blocked)
    rest = drive.ask('diverted')
    assert tuple(rest[0, :2]) == tuple(whole[at, :2])
    assert tuple(rest[-1, :2]) == (8.5, 5.5)
    assert blocked not in [cell(rest, at) for at in range(len(rest))]
    assert path_from_ros(drive.client.last('path', paths)).shape == rest.shape, 'it is published'
    return rest


@pytest.mark.parametrize('required', [False, True])
def test_a_diversion_stays_within_the_plan_and_is_recorded_verified_and_audited_as_driven(
        required, tmp_path, submitted):
    parameters = {**ROBOT, 'recording.required': required, 'replan.tolerance': 1e9}
    with stage(tmp_path, parameters=parameters) as running:
        drive = Drive(running)
        whole, before = drive.begin(), len(submitted)
        once = diverted(drive, whole, 0.25, 2)
        twice = diverted(drive, once, 0.3, 3)
        drive.robot.is_at(*twice[len(twice) // 2, :2])
        assert_rest(drive.ask('continued'), twice, len(twice) // 2)
        drive.departures(1)
        assert len(submitted) == before
        drive.client.publish('alpha_map', risk_grid(FLAT))
        for count in range(2, 6):
            drive.robot.is_at(8.4, 5.4)
            assert len(drive.client.get_plan(HERE, GOAL).poses) == 1, 'arrived'
            drive.robot.is_at(1.5, 5.5)
            drive.ask('new')
            drive.departures(count)
        files = recorded(tmp_path, 7)
    verdicts = list(map(Verifier().verify, files))
    assert [each.problems for each in verdicts] == [[]] * 7
    assert together(verdicts) == ([], [])
    found = read_departures(files, pytest.fail)
    assert [each.metadata.departure for each in found] == [1, 2, 3, 4, 5]
    driven, leg = found[0], found[0].drawn_from.legs[0]
    assert [len(each.parts) for each in found] == [3, 1, 1, 1, 1]
    parts = [whole[:int(0.25 * len(whole)) + 1], once[:int(0.3 * len(once)) + 1], twice]
    np.testing.assert_allclose(driven.path_poses[:, :2], np.vstack(parts)[:, :2], atol=1e-9)
    chances = dict(zip(map(tuple, leg.network.edges.tolist()),
                       leg.edge_probability.tolist(), strict=True))
    assert all(chances[step] > 0.0 for step in pairwise(driven.route[0].tolist()))
    seen = json.loads(run_here(audit, tmp_path, '--json').out)
    assert (seen['departures'], seen['impossible']) == (5, 0)
    assert [each for each in seen['findings'] if BY_CHANCE not in each] == []
    assert len(together(verdicts[1:])[0]) == 1, 'the departure is missing'
    (missing,), _ = together([*verdicts[:1], *verdicts[2:]])
    assert missing == f'missing: what {files[2].name} was diverted from'


def test_a_wall_across_all_routes_of_the_plan_makes_a_new_one(drive):
    drive.begin()
    drive.block(np.s_[:19], 10)
    assert drive.ask('new')[:, 1].max() > 9.5, 'round the wall'
    drive.departures(2)


def test_a_robot_in_the_inflation_of_a_costmap_drives_out_straight(tmp_path):
    values = np.zeros((40, 40), np.int8)
    values[:, :8] = 99  # its own cell, too: 0.5 m from the free ones
    values[20:22, 20:22] = 100
    parameters = {**ROBOT, 'map.preset': 'costmap', 'game.ambush_radius': 0.5}
    with stage(tmp_path, parameters=parameters) as running:
        drive, client = Drive(running), running.client
        drive.robot.is_at(1.5, 5.5)
        client.publish('alpha_map', risk_grid(values, 0.25))
        wait_until(lambda: running.planner._dispatcher.inputs.map, 'the map')
        path = drive.ask('new')
        assert tuple(path[0, :2]) == (1.5, 5.5)
        assert path[1, 0] > 2.0 and abs(path[1, 1] - 5.5) < 0.5
        assert (np.hypot(*np.diff(path[:2, :2], axis=0).T) <= 1.0).all()
        client.publish('start_pose', HERE)
        client.publish('goal_pose', GOAL)
        client.call_until('replan', lambda answer: answer.success)
        drive.ask('continued')
        drive.robot.is_at(1.5, 5.0)  # off its path, within the plan's tolerance
        wanted = pose(8.5, 5.5, 1.0)
        client.publish('goal_pose', wanted)
        inputs = running.planner._dispatcher.inputs
        wait_until(lambda: inputs.goal == wanted, 'the goal')
        assert client.get_plan(HERE, GOAL).poses
        drive.robot.is_at(0.5, 5.5)
        assert not client.get_plan(HERE, GOAL).poses, 'more than a metre from free ground'
        client.diagnostics(code='START_OCCUPIED', value_is='probability of being hit')
        files = recorded(tmp_path, 2)
    assert not any(Verifier().verify(file).problems for file in files)


def test_a_trip_with_stops_is_continued_through_those_that_remain():
    """As Nav2's trees ask: the goals that have been passed are left out."""
    stops = [pose(3.0, 8.0), pose(6.0, 8.5)]
    with stage(parameters={**ROBOT, 'route.path_spacing': 0.25}) as running:
        drive = Drive(running)
        drive.begin()
        whole, said = drive.ask_through(*stops, GOAL)
        assert said == ''
        met = [int(np.hypot(*(whole[:, :2] - place).T).argmin())
               for place in ((3.0, 8.0), (6.0, 8.5))]
        for at, rest in ((met[0] // 2, stops), (met[0] + 3, stops), (met[0] + 3, stops[1:]),
                         (met[1] + 3, [])):
            drive.robot.is_at(*whole[at, :2])
            path, said = drive.ask_through(*rest, GOAL)
            assert said == 'departure 2 continued'
            assert_rest(path, whole, at)
        drive.block(*cell(whole, (met[1] + len(whole)) // 2))
        path, said = drive.ask_through(GOAL)
        assert 'departure 2 diverted' in said
        drive.robot.is_at(*path[len(path) // 2, :2])
        for poses in ((GOAL,), (*stops, GOAL)):
            assert drive.ask_through(*poses)[1] == 'departure 2 continued'


def test_a_tour_is_drawn_again_for_a_robot_that_has_stood_at_its_end():
    """The last requests of Nav2's trees still name stops."""
    with stage(parameters=ROBOT) as running:
        drive, tour = Drive(running), (pose(5.0, 8.0), GOAL)
        drive.arrive()
        whole, _ = drive.ask_through(*tour)
        for at in (len(whole) // 4, len(whole) // 2, 3 * len(whole) // 4):
            drive.robot.is_at(*whole[at, :2])
            assert drive.ask_through(*tour)[1] == 'departure 1 continued'
        drive.robot.is_at(7.95, 5.9)
        assert drive.ask_through(*tour)[1] == 'departure 1 continued', 'it still drives'
        (trip,) = running.planner._dispatcher._departures.trips._trips
        wait_until(lambda: drive.robot.moves_to(7.95, 5.9) or trip.track.arrived, 'standing')
        path, said = drive.ask_through(*tour)
        assert 'continued' not in said and tuple(path[0, :2]) == (7.95, 5.9)
        drive.departures(2)


def test_a_path_that_comes_back_past_the_robot_is_looked_at_from_where_it_is_now():
    there = [pose(0.5 * x, 5.5) for x in range(3, 18)]
    with stage(parameters=ROBOT) as running:
        drive, kind = Drive(running), import_module('nav2_msgs.srv').IsPathValid
        drive.arrive()
        drive.robot.is_at(3.0, 5.4)
        drive.block(11, 16)
        path = Path(header=GOAL.header, poses=[*there, *(
            pose(each.pose.position.x, 5.35) for each in reversed(there))])
        service = drive.client.node.create_client(kind, 'ambush_planner/is_path_valid')
        assert not answer_of(service, kind.Request(path=path)).is_valid


def test_robots_have_a_goal_each_and_requests_from_fixed_places_replace_none(drive):
    """Nobody knows who sends the latter: the map's frame is no robot."""
    van = Robot(drive.running, 'van')
    drive.arrive()
    van.is_at(1.5, 2.5)
    goals = Goals(drive.running)
    with held(WorkerProcess, 'solve'):
        sent = [goals.send(start=start, goal=pose(8.5, y)) for start, y in (
            (HERE, 5.5), (pose(0.0, 0.0, frame='van'), 2.5), (pose(1.5, 4.5), 3.5),
            (pose(1.5, 4.5), 8.5))]
    assert [goals.result(each)[1].error_msg for each in sent] == [''] * 4
