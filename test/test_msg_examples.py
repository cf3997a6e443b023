"""Every file in msg_examples does what its comment says, with a real node."""

import math
import re

import pytest
import yaml
from ros_harness import interface_of, stage, wait_until
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
REQUESTS = [name for name, words in COMMANDS.items() if words[0] == 'service']


def example(name):
    """Return what an example's command line sends: a message or a request."""
    kind = type_of(COMMANDS[name][-1])
    return filled(getattr(kind, 'Request', kind)(), yaml.safe_load(FILES[name].read_text()))


class Sender:
    """Sends examples as their command lines do."""

    def __init__(self, running):
        self.client, self.planner = running.client, running.planner

    def publish(self, name):
        """Publish an example with the durability of its command line, and return it."""
        message = example(name)
        assert ('transient_local' in COMMANDS[name]) == (name == 'alpha_map')
        self.client.publish(COMMANDS[name][-2], message)
        return message

    def call(self, name):
        """Call a service with an example, and return the answer."""
        return self.client.call(name, example(name))


@pytest.fixture(scope='module')
def sender():
    with stage() as running:
        sender = Sender(running)
        for name in ('alpha_map', 'start_pose', 'goal_pose'):
            sender.publish(name)
        running.client.diagnostics(state='ready')
        yield sender


def test_every_subscription_and_service_has_an_example(sender):
    examples = {topic: kind for *_, topic, kind in COMMANDS.values()}
    interface = interface_of(sender.planner)
    inputs = {**interface.subscribers, **interface.services}
    assert examples == {
        name: kind for name, kind in inputs.items() if not kind.startswith(FOREIGN)}
    for name, words in COMMANDS.items():
        assert words[-2] in (f'/{name}', f'/ambush_planner/{name}')
        assert name in REQUESTS or '--once' in words


@pytest.mark.parametrize('start', ['start_pose', 'initialpose'])
def test_new_route(sender, start):
    assert all(sender.call(name) is not None for name in REQUESTS)
    sender.publish('goal_pose')
    pose = sender.publish(start).pose
    position = getattr(pose, 'pose', pose).position

    def departs_there():
        assert sender.call('new_route').success
        paths = sender.client.received['path']
        return paths and paths[-1].poses[0].pose.position == position

    wait_until(departs_there, 'a path from the start of the example')
    path = sender.client.received['path'][-1]
    assert path.poses[-1].pose == example('goal_pose').pose


def test_via_poses(sender):
    stops = sender.publish('via_poses').poses

    def visits_stops():
        assert sender.call('new_route').success
        path = sender.client.received['path'][-1]
        places = [(each.pose.position.x, each.pose.position.y) for each in path.poses]
        return all((stop.position.x, stop.position.y) in places for stop in stops)

    wait_until(visits_stops, 'a path via the stops')


def test_get_plan_moves_the_goal_out_of_the_block(sender):
    request = example('get_plan')
    path = sender.call('get_plan').plan
    wanted, found = (pose_from_ros(stamped.pose) for stamped in (request.goal, path.poses[-1]))
    assert 0.0 < math.dist(wanted, found) <= request.tolerance
    assert not sender.client.get_plan(request.start, request.goal, 0.0).poses
    sender.client.diagnostics(code='GOAL_OCCUPIED')
