# SPDX-License-Identifier: Apache-2.0
"""Nav2's action, called as Nav2 calls it."""

from contextlib import contextmanager
from importlib import import_module

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from handed_on import halt_workers
from rclpy.action import ActionClient
from recording_samples import read_with_rosbags
from robots import ROBOT, Robot
from ros_harness import GOAL, LONG, START, pose, recorded, risk_grid, stage, wait_until
from waiting import answer_of, held

from ambush_planner.planning.clear_ground import ClearGround
from ambush_planner.ros.compute_path import ACTIONS

pytestmark = pytest.mark.usefixtures('nav2')


class Goals:
    """Sends goals as BasicNavigator does, without waiting for results."""

    def __init__(self, running, to='pose'):
        name = f'compute_path_{"through" if to == "poses" else "to"}_{to}'
        kind = getattr(import_module('nav2_msgs.action'), ACTIONS[f'~/{name}'])
        self.action, self.client, self.running = kind, running.client, running
        # It ends with its node: to destroy it while that spins would end the executor.
        self._client = ActionClient(
            running.client.node, kind, f'ambush_planner/{name}')
        wait_until(self._client.server_is_ready, 'the action')

    def send(self, start=START, **fields):
        """Return the goal's handle, once it is accepted."""
        goal = {} if 'goals' in fields else {'goal': GOAL}
        fields = {'use_start': start is not None, **goal, **fields}
        if start is not None:
            fields['start'] = start
        wish = self.action.Goal(**fields)
        handle = self._answer('the goal being taken', self._client.send_goal_async, wish)
        assert handle.accepted
        return handle

    def result(self, handle):
        """Return the status and the result of a goal, once it is there."""
        answer = self.result_of(handle)
        wait_until(answer.done, 'a result')
        return answer.result().status, answer.result().result

    def result_of(self, handle):
        """The future of a goal's status and result."""
        return self._sent(handle.get_result_async)

    def cancel(self, handle):
        """Return how many goals are being cancelled."""
        answer = self._answer('an answer to the wish to cancel', handle.cancel_goal_async)
        return len(answer.goals_canceling)

    def _answer(self, what, send, *arguments):
        answer = self._sent(send, *arguments)
        wait_until(answer.done, what)
        return answer.result()

    def _sent(self, send, *arguments):
        """Send from the executor's thread: rclpy loses answers that come before it is done."""
        sent = self.client.node.executor.create_task(send, *arguments)
        wait_until(sent.done, 'the sending')
        return sent.result()

    def refused(self, **fields):
        """Return the code and the message of a goal that is given up."""
        status, result = self.result(self.send(**fields))
        assert status == GoalStatus.STATUS_ABORTED
        assert not result.path.poses
        return result.error_code, result.error_msg


@contextmanager
def asking(*arguments, to='pose'):
    with stage(*arguments) as running:
        running.give()
        yield Goals(running, to)


@pytest.fixture(scope='module')
def goals(nav2, tmp_path_factory):
    """Goals of a node that records, and answers for another planner."""
    folder = tmp_path_factory.mktemp('runs')
    with asking(folder, {'planner_ids': ['', 'GridBased']}) as goals:
        goals.folder = folder
        yield goals


def test_a_goal_is_a_departure_for_each_of_the_planner_ids(goals):
    for number, name in enumerate(('', 'GridBased', 'ambush_planner'), 1):
        last = goals.send(planner_id=name)
        status, result = goals.result(last)
        assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
        assert (result.path.poses[0].pose, result.path.poses[-1].pose) == (START.pose, GOAL.pose)
        assert result.path == goals.client.last('path', number)
        assert result.planning_time.sec + result.planning_time.nanosec > 0
        goals.client.diagnostics(departures=str(number), code='NONE')
    assert goals.cancel(last) == 0, 'the route is drawn'
    assert all(map(read_with_rosbags, recorded(goals.folder, 3)))


def test_a_goal_that_fails_has_nav2s_code_and_a_reason(goals):
    before = len(goals.client.received['path'])
    for code, part, fields in (
        (201, "'Smac'", {'planner_id': 'Smac'}),
        (202, 'frame_id', {'start': pose(1.5, 5.5, frame='')}),
        (205, 'obstacle', {'start': pose(5.0, 5.5)}),
        (204, 'outside', {'goal': pose(99.0, 5.5)}),
        (200, 'position', {'goal': pose(float('nan'), 5.5)}),
        (202, 'robot_base_frame', {'start': None}),
    ):
        got, message = goals.refused(**fields)
        assert (got, part in message) == (code, True), message
    assert len(goals.client.received['path']) == before
    goals.client.diagnostics(code='NO_START')
    assert goals.result(goals.send())[0] == GoalStatus.STATUS_SUCCEEDED


def test_a_goal_through_poses_is_a_trip():
    with asking(to='poses') as goals:
        stops = [pose(3.0, 8.0), pose(6.0, 8.5)]
        status, result = goals.result(goals.send(goals=[*stops, GOAL]))
        assert status == GoalStatus.STATUS_SUCCEEDED, result.error_msg
        met = [each.pose.position for each in result.path.poses]
        assert [stop.pose.position in met for stop in stops] == [True, True]
        assert met[-1] == GOAL.pose.position
        goals.client.diagnostics(stops='2')
        for code, words, poses in ((309, 'goals is empty', []),
                                   (306, 'stop 1', [pose(5.0, 5.5), GOAL]),
                                   (304, 'stop 2', [stops[0], pose(99.0, 5.5), GOAL]),
                                   (302, 'in one', [pose(3.0, 8.0, frame='odom'), *stops, GOAL])):
            got, message = goals.refused(goals=poses)
            assert (got, words in message) == (code, True), message


def test_the_newest_goal_wins_and_one_that_is_cancelled_leaves_the_others(submitted):
    with asking(None, {**LONG, **ROBOT}) as goals:
        Robot(goals.running).is_at(1.5, 5.5)
        old, one = goals.send(None, goal=pose(8.0, 1.0)), goals.send(None)
        asked = goals.client.send('new_route')  # another client's
        newest = goals.send(None)
        status, result = goals.result(old)
        assert status == GoalStatus.STATUS_ABORTED and 'a newer request' in result.error_msg
        wait_until(lambda: len(submitted) == 4, 'the requests')
        goals.client.diagnostics(state='solving')
        halt_workers()
        assert goals.cancel(one) == 1
        assert goals.result(one)[0] == GoalStatus.STATUS_CANCELED
        assert goals.client.diagnostics()['state'] == 'solving', 'the others wait for this solve'
        assert not asked.done()
        assert goals.client.call('cancel').success
        assert goals.result(newest)[0] == GoalStatus.STATUS_ABORTED
        wait_until(asked.done, 'the answer of new_route')
        only = goals.send(None)
        goals.client.diagnostics(state='solving')
        halt_workers()
        assert goals.cancel(only) == 1
        goals.client.diagnostics(state='ready')
        assert goals.result(only)[0] == GoalStatus.STATUS_CANCELED
        assert goals.client.call('cancel').message == 'no solve is running'
        assert not goals.client.received['path']


def test_a_path_is_valid_as_long_as_the_newest_map_is_clear_along_it(goals):
    kind = import_module('nav2_msgs.srv').IsPathValid
    client, flat = goals.client, np.full((20, 20), 10)
    client.publish('alpha_map', risk_grid(flat))
    service = client.node.create_client(kind, 'ambush_planner/is_path_valid')
    path = client.get_plan(START, GOAL)

    def validity(path):
        answer = answer_of(service, kind.Request(path=path))
        return answer.is_valid, list(answer.invalid_pose_indices)

    assert validity(path) == (True, [])
    middle = path.poses[len(path.poses) // 2].pose.position
    flat[int(middle.y / 0.5), int(middle.x / 0.5)] = 100
    client.publish('alpha_map', risk_grid(flat))
    wait_until(lambda: not validity(path)[0], 'the new map')
    assert len(path.poses) // 2 in validity(path)[1]
    blocked, path.poses = path.poses, path.poses[len(path.poses) // 2:][:1]
    assert validity(path) == (False, [0]), 'one pose, in an obstacle'
    path.poses = blocked[:1]
    assert validity(path) == (True, [])
    assert validity(type(path)(header=path.header)) == (False, [])
    client.diagnostics(code='NONE')
    with held(ClearGround, 'drivable_steps') as (checked, _):
        path.poses = blocked
        asked = service.call_async(kind.Request(path=path))
        wait_until(checked.is_set, 'the check of the path')
        assert client.get_plan(START, GOAL).poses and not asked.done(), 'nobody waits for it'
    wait_until(asked.done, 'the answer')
    path.poses = [*path.poses, pose(float('nan'), 5.5)]
    assert validity(path) == (False, [])
    assert 'path: ' in client.diagnostics(code='INVALID_POSE')['message']
    path.header.frame_id = 'odom'
    assert validity(path) == (False, [])
    client.diagnostics(code='TF_ERROR')
