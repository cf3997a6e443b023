# SPDX-License-Identifier: Apache-2.0
"""Every file in msg_examples does what its comment says, with a real node."""

import math
import re

import pytest
import yaml
from ros_harness import interface_of, stage
from ros_yaml import EXAMPLES, filled, type_of

from ambush_planner.maps.ros_messages import pose_from_ros

FILES = {path.stem: path for path in EXAMPLES.iterdir()}
# Interfaces of other packages that every node has, or that bring their own tools.
FOREIGN = (
    'action_msgs/', 'lifecycle_msgs/', 'map_msgs/', 'nav2_msgs/', 'rcl_interfaces/',
    'rosgraph_msgs/', 'tf2_msgs/', 'type_description_interfaces/',
)


def command_of(name):
    """Return the words of the ``ros2`` command line in an example's comment."""
    (line,) = re.findall(r'^# ros2 (.*)$', FILES[name].read_text(), flags=re.MULTILINE)
    *words, stdin, less, file = line.split()
    assert (stdin, less, file) == ('--stdin', '<', f'{name}.yaml')
    return words


COMMANDS = {name: command_of(name) for name in FILES}


def example(name):
    """Return what an example's command line sends: a message or a request."""
    kind = type_of(COMMANDS[name][-1])
    return filled(getattr(kind, 'Request', kind)(), yaml.safe_load(FILES[name].read_text()))


@pytest.fixture(scope='module')
def running():
    with stage() as running:
        for name in ('alpha_map', 'start_pose', 'goal_pose'):
            send(running.client, name)
        running.client.diagnostics(state='ready')
        yield running


@pytest.fixture
def client(running):
    return running.client


def send(client, name):
    """Publish an example with the durability of its command line, and return it."""
    assert ('transient_local' in COMMANDS[name]) == (name == 'alpha_map')
    message = example(name)
    client.publish(COMMANDS[name][-2], message)
    return message


def departs(client, condition):
    """Depart until the path is as wanted, and return its poses."""
    client.call_until('new_route', lambda answer: answer.success and condition(
        [each.pose for each in client.last('path').poses]))
    return client.last('path').poses


def test_every_subscription_and_service_has_an_example_and_every_request_an_answer(running):
    examples = {topic: kind for *_, topic, kind in COMMANDS.values()}
    interface = interface_of(running.planner)
    inputs = {**interface.subscribers, **interface.services}
    assert examples == {
        name: kind for name, kind in inputs.items() if not kind.startswith(FOREIGN)}
    for name, words in COMMANDS.items():
        assert words[-2] in (f'/{name}', f'/ambush_planner/{name}')
        if words[0] == 'service':
            assert running.client.call(name, example(name)) is not None
        else:
            assert '--once' in words


@pytest.mark.parametrize('start', ['start_pose', 'initialpose'])
def test_new_route(client, start):
    send(client, 'goal_pose')
    pose = send(client, start).pose
    position = getattr(pose, 'pose', pose).position
    poses = departs(client, lambda path: path[0].position == position)
    assert poses[-1].pose == example('goal_pose').pose


def test_via_poses(client):
    stops = send(client, 'via_poses').poses
    places = {(stop.position.x, stop.position.y) for stop in stops}
    departs(client, lambda path: places <= {(each.position.x, each.position.y) for each in path})


def test_get_plan_moves_the_goal_out_of_the_block(client):
    request = example('get_plan')
    path = client.call('get_plan', request).plan
    wanted, found = (pose_from_ros(stamped.pose) for stamped in (request.goal, path.poses[-1]))
    assert 0.0 < math.dist(wanted, found) <= request.tolerance
    assert not client.get_plan(request.start, request.goal, 0.0).poses
    client.diagnostics(code='GOAL_OCCUPIED')
