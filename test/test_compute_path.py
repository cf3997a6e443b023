"""Nav2's action, built from its definition, and called as Nav2 calls it."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from importlib import invalidate_caches
from pathlib import Path

import interfaces
import pytest
from action_msgs.msg import GoalStatus
from handed_on import halt_workers
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from recording_samples import read_with_rosbags
from ros_harness import (
    Client,
    Stage,
    free_domain,
    pose,
    risk_grid,
    ros_context,
    spinning,
    stage,
    wait_until,
)
from test_guarded_routes import Profile
from waiting import TIMEOUT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(interfaces.missing()), reason=interfaces.missing()),
]
# The fields of Nav2's for Jazzy; what stands in comments there makes no difference.
DEFINITION = """
geometry_msgs/PoseStamped goal
geometry_msgs/PoseStamped start
string planner_id
bool use_start
---
uint16 NONE=0
uint16 UNKNOWN=200
uint16 INVALID_PLANNER=201
uint16 TF_ERROR=202
uint16 START_OUTSIDE_MAP=203
uint16 GOAL_OUTSIDE_MAP=204
uint16 START_OCCUPIED=205
uint16 GOAL_OCCUPIED=206
uint16 TIMEOUT=207
uint16 NO_VALID_PATH=208
nav_msgs/Path path
builtin_interfaces/Duration planning_time
uint16 error_code
string error_msg
---
"""
START, GOAL = pose(1.5, 5.5), pose(8.5, 5.5)
# Minutes: nobody waits for its end here.
LONG = {'network.spacing': 0.0, 'network.target_nodes': 40_000, 'game.ambush_radius': 0.4}
# What the parts of Nav2 read, with their numbers there.
CODES = {
    'UNKNOWN': 200, 'INVALID_PLANNER': 201, 'TF_ERROR': 202, 'GOAL_OUTSIDE_MAP': 204,
    'START_OCCUPIED': 205,
}


@pytest.fixture(scope='module')
def action(tmp_path_factory):
    """The action's type, installed for this file's tests; Nav2's own where it is installed."""
    try:
        from nav2_msgs.action import ComputePathToPose
    except ImportError:
        folder = interfaces.build_interface(
            tmp_path_factory.mktemp('nav2'), 'nav2_msgs', 'action/ComputePathToPose.action',
            DEFINITION)
        sys.path.insert(0, str(folder))
        invalidate_caches()
        from nav2_msgs.action import ComputePathToPose
        yield ComputePathToPose
        sys.path.remove(str(folder))
        for name in [name for name in sys.modules if name.split('.')[0] == 'nav2_msgs']:
            del sys.modules[name]
    else:
        yield ComputePathToPose


class Goals:
    """Sends goals as BasicNavigator does, but waits for nothing."""

    def __init__(self, action, running):
        self.action, self.planner, self.client = action, running.planner, running.client
        # It ends with its node: to destroy it while that spins would end the executor.
        self._client = ActionClient(
            running.client.node, action, 'ambush_planner/compute_path_to_pose')
        wait_until(self._client.server_is_ready, 'the action')

    def send(self, start=START, goal=GOAL, **fields):
        """Return the goal's handle, once it is accepted."""
        fields = {'use_start': start is not None, **fields}
        if start is not None:
            fields['start'] = start
        wish = self.action.Goal(goal=goal, **fields)
        handle = self._answer('the goal being taken', self._client.send_goal_async, wish)
        assert handle.accepted
        return handle

    def result(self, handle):
        """Return the status and the result of a goal, once it is there."""
        answer = self._answer('a result', handle.get_result_async)
        return answer.status, answer.result

    def cancel(self, handle):
        """Return how many goals are being cancelled."""
        answer = self._answer('an answer to the wish to cancel', handle.cancel_goal_async)
        return len(answer.goals_canceling)

    def _answer(self, what, send, *arguments):
        """Send from the executor's thread: rclpy loses answers that come before it is done."""
        sent = self.client.node.executor.create_task(send, *arguments)
        wait_until(sent.done, 'the sending')
        wait_until(sent.result().done, what)
        return sent.result().result()

    def refused(self, **fields):
        """Return the code and the message of a goal that is given up."""
        status, result = self.result(self.send(**fields))
        assert status == GoalStatus.STATUS_ABORTED
        assert not result.path.poses
        return result.error_code, result.error_msg


@contextmanager
def asking(action, *arguments, **options):
    with stage(*arguments, **options) as running:
        running.give()
        yield Goals(action, running)


def test_a_goal_is_a_departure(action, tmp_path):
    with asking(action, tmp_path) as goals:
        status, result = goals.result(goals.send())
        assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0)
        assert (result.path.poses[0].pose, result.path.poses[-1].pose) == (START.pose, GOAL.pose)
        assert result.path == goals.client.last('path')
        spent = result.planning_time
        assert spent.sec + 1e-9 * spent.nanosec > 0.0
        goals.client.diagnostics(departures='1', code='NONE')
        again = goals.result(goals.send(planner_id='ambush_planner'))[1]
        assert goals.client.last('path', 2) == again.path
        wait_until(lambda: len(list(tmp_path.rglob('*.mcap'))) == 2, 'the recordings')
    for file in tmp_path.rglob('*.mcap'):
        assert read_with_rosbags(file)


def test_a_path_that_is_not_published_is_in_the_result(action):
    with asking(action, None, {'path.publish': False}) as goals:
        status, result = goals.result(goals.send())
        assert status == GoalStatus.STATUS_SUCCEEDED
        assert result.path.poses[-1].pose == GOAL.pose
        goals.client.diagnostics(departures='1')
        assert not any(path.poses for path in goals.client.received['path'])


def test_the_policy_knows_the_action(action):
    with asking(action) as goals:
        served = goals.planner.get_service_names_and_types_by_node('ambush_planner', '/')
    goal = '/_action/send_goal'
    actions = {name.removesuffix(goal) for name, _ in served if name.endswith(goal)}
    assert actions == Profile('/ambush_planner').listed('action', 'execute')


def test_a_drive_from_where_the_robot_is_needs_its_frame(action):
    with asking(action) as goals:
        code, message = goals.refused(start=None)
        assert code == CODES['TF_ERROR']
        assert 'robot_base_frame' in message
    with asking(action, None, {'robot_base_frame': 'base_link'}) as goals:
        code, message = goals.refused(start=None)
        assert code == CODES['TF_ERROR']
        assert "'base_link'" in message


def test_what_cannot_be_done_has_nav2s_code_and_says_why(action):
    with asking(action) as goals:
        for code, part, fields in (
            ('INVALID_PLANNER', "'GridBased'", {'planner_id': 'GridBased'}),
            ('TF_ERROR', 'frame_id', {'start': pose(1.5, 5.5, frame='')}),
            ('START_OCCUPIED', 'obstacle', {'start': pose(5.0, 5.5)}),
            ('GOAL_OUTSIDE_MAP', 'outside', {'goal': pose(99.0, 5.5)}),
            ('UNKNOWN', 'position', {'goal': pose(float('nan'), 5.5)}),
        ):
            got, message = goals.refused(**fields)
            assert got == CODES[code], message
            assert part in message
        assert not goals.client.received['path']
        goals.client.diagnostics(code='INVALID_POSE')
        assert goals.result(goals.send())[0] == GoalStatus.STATUS_SUCCEEDED


def test_cancelling_takes_one_goal_back_and_leaves_the_others(action, submitted):
    with asking(action, None, LONG) as goals:
        one, other = goals.send(), goals.send()
        asked = goals.client.send('new_route')
        wait_until(lambda: len(submitted) == 3, 'the requests')
        goals.client.diagnostics(state='solving')
        halt_workers()
        assert goals.cancel(one) == 1
        assert goals.result(one)[0] == GoalStatus.STATUS_CANCELED
        assert goals.client.diagnostics()['state'] == 'solving', 'the others wait for this solve'
        assert not asked.done()
        assert goals.client.call('cancel').message == 'the solve was cancelled'
        assert goals.result(other)[0] == GoalStatus.STATUS_ABORTED
        wait_until(asked.done, 'the answer of new_route')
        assert not goals.client.received['path']


def test_a_solve_that_nobody_waits_for_any_more_ends(action):
    with asking(action, None, LONG) as goals:
        handle = goals.send()
        goals.client.diagnostics(state='solving')
        halt_workers()
        assert goals.cancel(handle) == 1
        goals.client.diagnostics(state='ready')
        assert goals.result(handle)[0] == GoalStatus.STATUS_CANCELED
        assert goals.client.call('cancel').message == 'no solve is running'


def test_it_is_too_late_to_cancel_once_the_route_is_drawn(action):
    with asking(action) as goals:
        handle = goals.send()
        status, result = goals.result(handle)
        assert goals.cancel(handle) == 0
        assert status == GoalStatus.STATUS_SUCCEEDED
        assert result.path == goals.client.last('path')


def test_whoever_waits_is_told_when_the_node_ends(action, tmp_path):
    parameters = [f'{name}:={value}' for name, value in LONG.items()]
    command = [sys.executable, '-m', 'ambush_planner.ros.planner_node', '--ros-args', '-p',
               'recording.enabled:=false', *(w for each in parameters for w in ('-p', each))]
    with free_domain() as domain, ros_context(domain) as context:
        node = Node('client', context=context)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain),
                       'PYTHONPATH': str(Path(sys.modules['nav2_msgs'].__file__).parents[1])}
        with (tmp_path / 'output').open('w') as output:
            process = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
        with spinning(node, SingleThreadedExecutor(context=context)):
            client = Client(node)
            client.publish('alpha_map', risk_grid())
            client.diagnostics(message='waiting for start_pose, goal_pose')
            goals = Goals(action, Stage(None, client))
            waiting = [goals.send().get_result_async() for _ in range(3)]
            client.diagnostics(state='solving')
            process.send_signal(signal.SIGINT)
            assert process.wait(TIMEOUT) == 0
            # A client that stands still for longer than the node stays may miss its result.
            told = {each.result().result.error_msg for each in waiting if each.done()}
    assert told <= {'the planner is shutting down'}
    said = (tmp_path / 'output').read_text()
    assert said.count('compute_path_to_pose: the planner is shutting down') == len(waiting)


def test_many_goals_at_once(action):
    with asking(action) as goals:
        results = [goals.result(each) for each in [goals.send() for _ in range(20)]]
        assert {status for status, _ in results} == {GoalStatus.STATUS_SUCCEEDED}
        goals.client.last('path')
        goals.client.diagnostics(departures='20')
