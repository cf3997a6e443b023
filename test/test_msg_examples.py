"""Every file in msg_examples does what its comment says, with a real node."""

import math

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from ros_harness import stage, wait_until
from ros_yaml import EXAMPLES, command_of, message_from_yaml
from std_srvs.srv import Trigger

from ambush_planner.ros.conversions import pose_from_ros

KINDS = {
    'nav_msgs/msg/OccupancyGrid': OccupancyGrid,
    'geometry_msgs/msg/PoseStamped': PoseStamped,
    'std_srvs/srv/Trigger': Trigger.Request,
    'nav_msgs/srv/GetPlan': GetPlan.Request,
}
MESSAGES = ('alpha_map', 'start_pose', 'goal_pose')
REQUESTS = ('new_route', 'get_plan')


def example(name):
    """The message in an example, of the type that its command line names."""
    path = EXAMPLES / f'{name}.yaml'
    (kind,) = [KINDS[word] for word in command_of(path) if word in KINDS]
    return message_from_yaml(kind, path)


@pytest.fixture(scope='module')
def given():
    with stage(parameters={'network.spacing': 0.0}) as running:
        for name in MESSAGES:
            running.client.publish(name, example(name))
        running.client.diagnostics(state='ready')
        yield running.client


def test_every_file_is_used():
    assert {path.stem for path in EXAMPLES.iterdir()} == {*MESSAGES, *REQUESTS}


@pytest.mark.parametrize('name', [*MESSAGES, *REQUESTS])
def test_command_line_names_the_topic_and_the_file(name):
    words = command_of(EXAMPLES / f'{name}.yaml')
    assert words[-3:] == ['--stdin', '<', f'{name}.yaml']
    assert (f'/{name}' if name in MESSAGES else f'/ambush_planner/{name}') in words
    assert ('transient_local' in words) == (name == 'alpha_map')


def test_new_route(given):
    assert given.call('new_route', example('new_route')).success
    path = given.last('path')
    assert path.header.frame_id == 'map'
    assert path.poses[0].pose.position == example('start_pose').pose.position
    assert path.poses[-1].pose == example('goal_pose').pose


def test_get_plan_moves_the_goal_out_of_the_block(given):
    request = example('get_plan')
    path = given.call('get_plan', request).plan
    wanted, got = (pose_from_ros(stamped.pose) for stamped in (request.goal, path.poses[-1]))
    assert 0.0 < math.dist(wanted, got) <= request.tolerance
    request.tolerance = 0.0
    assert not given.call('get_plan', request).plan.poses
    wait_until(lambda: given.diagnostics()['code'] == 'GOAL_OCCUPIED', 'the reason')
