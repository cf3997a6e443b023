# SPDX-License-Identifier: Apache-2.0
"""The behaviour trees of config with a real node: a robot drives and asks as they say."""

import math
import re
import time
from contextlib import contextmanager
from importlib import import_module

import interfaces
import numpy as np
import pytest
from behaviour_trees import FAILURE, RUNNING, SUCCESS, Tree
from nav_msgs.msg import Path
from rclpy.action import ActionClient
from robots import ROBOT, Robot
from ros_harness import pose, risk_grid, stage, wait_until
from test_behaviour_trees import POSE, POSES, World
from waiting import TIMEOUT

pytestmark = pytest.mark.slow
SPEED, PERIOD, REACHED = 4.0, 0.02, 0.25  # m/s, s, m: Nav2's goal checker
FAR = np.full((40, 40), 10, dtype=np.int8)


class Drive(World):
    """A robot on the plane; the leaves that ask call the node, the others are as on a line."""

    def __init__(self, running, xy):
        super().__init__()
        self.running, self.node, self.robot = running, running.client.node, Robot(running)
        self.place, self.path_message, self.answers = np.array(xy), Path(), []
        nav2, services = import_module('nav2_msgs.action'), import_module('nav2_msgs.srv')
        self.actions = {name: (getattr(nav2, kind), ActionClient(
            self.node, getattr(nav2, kind), f'ambush_planner/{name}')) for name, kind in (
            ('compute_path_to_pose', 'ComputePathToPose'),
            ('compute_path_through_poses', 'ComputePathThroughPoses'))}
        self.validity = self.node.create_client(services.IsPathValid,
                                                'ambush_planner/is_path_valid')
        for _, client in self.actions.values():
            wait_until(client.server_is_ready, 'the action')
        wait_until(self.validity.service_is_ready, 'the service')
        running.client.publish('alpha_map', risk_grid(FAR))
        wait_until(lambda: running.planner._inputs._map is not None, 'the map')
        self.robot.is_at(*xy)

    def clock(self):
        return time.monotonic()

    def remove_passed_goals(self, ports):
        def work():
            while len(self.goals) > 1 and self.away(self.goals[0]) <= float(ports['radius']):
                self.goals.pop(0)
            return SUCCESS
        return work

    def away(self, goal):
        return math.dist(self.place, goal)

    def is_path_valid(self, ports):
        kind = self.validity.srv_type

        def work():
            asked = self.validity.call_async(kind.Request(path=self.path_message))
            wait_until(asked.done, 'whether the path is valid')
            return SUCCESS if asked.result().is_valid else FAILURE
        return work

    def compute_path_to_pose(self, ports):
        return self.compute('compute_path_to_pose', lambda poses: {'goal': poses[-1]})

    def compute_path_through_poses(self, ports):
        return self.compute('compute_path_through_poses', lambda poses: {'goals': poses})

    def compute(self, name, fields):
        kind, client = self.actions[name]
        goal = kind.Goal(**fields([pose(*each) for each in self.goals]))
        # From the executor's thread: rclpy loses answers that come before it has sent.
        sending = self.node.executor.create_task(client.send_goal_async, goal)
        state = {}

        def work():
            if 'handle' not in state and sending.done() and sending.result().done():
                state['handle'] = sending.result().result()
                state['asking'] = self.node.executor.create_task(state['handle'].get_result_async)
            if 'asking' not in state or not state['asking'].done():
                return RUNNING
            if not state['asking'].result().done():
                return RUNNING
            result = state['asking'].result().result().result
            self.codes['planner'] = result.error_code
            self.answers.append(next((kind for kind in ('continued', 'diverted', 'arrived')
                                      if kind in result.error_msg), 'new'))
            self.path_message = result.path
            self.path = [(each.pose.position.x, each.pose.position.y)
                         for each in result.path.poses]
            return SUCCESS if self.path else FAILURE

        def halt():
            self.path = []
            wait_until(lambda: work() != RUNNING or 'handle' in state, 'the goal being taken')
            if 'handle' in state:
                self.node.executor.create_task(state['handle'].cancel_goal_async)

        work.halt = halt
        return work

    def follow_path(self, ports):
        self.followed += 1
        followed, ahead, seen = [], [], self.clock()

        def work():
            nonlocal followed, ahead, seen
            if self.path and self.path is not followed:
                followed, ahead = self.path, [np.array(point) for point in self.path]
            now = self.clock()
            left, seen = SPEED * min(now - seen, 0.2), now
            while ahead and left > 0.0:
                step = math.dist(self.place, ahead[0])
                self.place = self.place + (ahead[0] - self.place) * min(1.0, left / max(step, 1e-9))
                left -= step
                if left >= 0.0:
                    ahead.pop(0)
            return RUNNING if sum(math.dist(*each) for each in zip(
                [self.place, *ahead], ahead, strict=False)) > REACHED else SUCCESS
        return work

    def drive(self, text, goals, then=lambda: None):
        """Navigate; ``then()`` may return new goals. Return the tree's status in the end."""
        self.goals = list(goals)
        tree, end = Tree(text, self.leaves, self.clock), time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            self.robot.moves_to(*self.place)
            self.goals = list(then() or self.goals)
            if (status := tree.tick()) != RUNNING:
                return status
            time.sleep(PERIOD)
        raise AssertionError(f'the tree still runs at {self.place}')


@pytest.fixture(scope='module', autouse=True)
def nav2():
    for package in ('nav2_msgs', 'tf2_msgs'):
        interfaces.install(package)
    yield
    interfaces.uninstall('nav2_msgs')


@contextmanager
def driving(start, **parameters):
    with stage(parameters={**ROBOT, **parameters}) as running:
        yield Drive(running, start)


def test_a_new_goal_shortly_before_the_old_one_is_driven_to():
    first, second = (11.5, 10.0), (18.0, 3.0)
    with driving((1.5, 10.0)) as drive:
        def just_before():
            return [second] if drive.away(first) < 1.0 else None

        assert drive.drive(POSE, [first], just_before) == SUCCESS
        assert drive.away(second) <= REACHED
        assert drive.answers[0] == 'new' and 'new' in drive.answers[1:]


# As in Nav2's tree: asked for every three seconds, stops being taken off only then.
TAKEN_OFF, CHECKED = (re.search(f'(?s)<{name}.*?</{name}>', POSES)[0]
                      for name in ('ForceSuccess', 'RateController'))
SELDOM = POSES.replace(TAKEN_OFF, '').replace(CHECKED, '<RateController hz="0.333"><Sequence>'
    '<RemovePassedGoals radius="0.7"/><Script code="planned := -1"/></Sequence></RateController>')


@pytest.mark.parametrize('tree', [POSES, SELDOM], ids=['ours', 'as in Nav2'])
def test_each_tour_is_one_departure(tree):
    """Also if the last requests still name stops, and if the next tour begins at once."""
    stops, ends = [(8.0, 16.0), (14.0, 8.0)], [(2.0, 6.0), (1.5, 12.0)]
    quick = {'network.spacing': 2.0, 'max_planning_time': 3.0, 'strategy.max_gap': 1.0}
    with driving((1.5, 12.0), **quick) as drive:
        for tour, end in enumerate(ends, 1):
            assert drive.drive(tree, [*stops, end]) == SUCCESS
            assert drive.away(end) <= REACHED
            drive.running.client.diagnostics(departures=str(tour))
        assert drive.answers.count('new') == len(ends), drive.answers
        if tree == POSES:
            assert drive.goals == [ends[-1]], 'the stops have been passed'


def test_a_goal_in_an_obstacle_fails_at_once():
    values = FAR.copy()
    values[20:24, 20:24] = 100
    with driving((1.5, 10.0)) as drive:
        drive.running.client.publish('alpha_map', risk_grid(values))
        wait_until(lambda: drive.running.planner._inputs.current_map().values.max() == 100,
                   'the map')
        for tree, goals in ((POSE, [(11.0, 11.0)]), (POSES, [(11.0, 11.0), (18.0, 3.0)])):
            assert drive.drive(tree, goals) == FAILURE
            assert drive.codes['planner'] % 100 == 6 and drive.helped == []
        drive.running.client.diagnostics(departures='0')
