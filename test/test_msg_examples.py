"""Every file in msg_examples does what its comment says, with a real node."""

import math

import pytest
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from ros_harness import stage, wait_until
from ros_yaml import EXAMPLES, command_of, example

from ambush_planner.maps.ros_messages import pose_from_ros

FILES = {path.stem: path for path in EXAMPLES.iterdir()}
COMMANDS = {name: command_of(path) for name, path in FILES.items()}
MESSAGES = [name for name, command in COMMANDS.items() if command.verb == 'topic pub']
REQUESTS = [name for name, command in COMMANDS.items() if command.verb == 'service call']
# What other packages give to each node: parameters, clock, transforms, changes of maps.
FOREIGN = (
    'lifecycle_msgs/', 'map_msgs/', 'rcl_interfaces/', 'rosgraph_msgs/', 'tf2_msgs/',
    'type_description_interfaces/',
)


class Sender:
    """Sends examples the way their command lines do."""

    def __init__(self, running):
        self.client, self.planner = running.client, running.planner
        self._publishers, self._clients = {}, {}

    def publish(self, name):
        """Publish an example and return it."""
        command, message = COMMANDS[name], example(FILES[name])
        if name not in self._publishers:
            self._publishers[name] = self.client.node.create_publisher(
                command.type, command.name, command.qos)
        publisher = self._publishers[name]
        wait_until(publisher.get_subscription_count, f'a subscription of {command.name}')
        publisher.publish(message)
        return message

    def call(self, name, request=None):
        """Call a service with an example, or with another request, and return the answer."""
        command = COMMANDS[name]
        if name not in self._clients:
            known = self.planner.count_clients(command.name)
            self._clients[name] = self.client.node.create_client(command.type, command.name)
            wait_until(lambda: self.planner.count_clients(command.name) > known, 'the client')
        client = self._clients[name]
        wait_until(client.service_is_ready, command.name)
        future = client.call_async(request or example(FILES[name]))
        wait_until(future.done, f'an answer of {command.name}')
        return future.result()

    def path_from(self, start):
        """Depart until the path begins at ``start``: messages may still be on their way."""
        def wanted():
            assert self.call('new_route').success
            path = self.client.received['path']
            return path and path[-1].poses[0].pose.position == start.position and path[-1]

        return wait_until(wanted, 'a path from the start of the example')

    def interface(self):
        """The names of the planner's own subscriptions and services, with their types."""
        who = self.planner.get_name(), self.planner.get_namespace()
        found = [
            *self.planner.get_subscriber_names_and_types_by_node(*who),
            *self.planner.get_service_names_and_types_by_node(*who),
        ]
        return {name: kind for name, (kind,) in found if not kind.startswith(FOREIGN)}


@pytest.fixture(scope='module')
def sender():
    with stage(parameters={'network.spacing': 0.0}) as running:
        sender = Sender(running)
        for name in ('alpha_map', 'start_pose', 'goal_pose'):
            sender.publish(name)
        running.client.diagnostics(state='ready')
        yield sender


def test_every_subscription_and_service_has_an_example(sender):
    assert {command.name: command.type_name for command in COMMANDS.values()} == sender.interface()


@pytest.mark.parametrize('name', sorted(FILES))
def test_the_command_line_names_the_file(name):
    assert FILES[name].name == f'{name}.yaml' == COMMANDS[name].file
    assert COMMANDS[name].name in (f'/{name}', f'/ambush_planner/{name}')


@pytest.mark.parametrize('name', MESSAGES)
def test_the_command_lines_qos_reaches_the_node(sender, name):
    (info,) = sender.planner.get_subscriptions_info_by_topic(COMMANDS[name].name)
    demanded = QoSProfile(
        depth=1, reliability=info.qos_profile.reliability, durability=info.qos_profile.durability)
    verdict, reason = qos_check_compatible(COMMANDS[name].qos, demanded)
    assert verdict != QoSCompatibility.ERROR, reason
    assert '--once' in COMMANDS[name].flags


@pytest.mark.parametrize('name', REQUESTS)
def test_every_request_is_answered(sender, name):
    assert sender.call(name) is not None


@pytest.mark.parametrize('start', ['start_pose', 'initialpose'])
def test_new_route(sender, start):
    sender.publish('goal_pose')
    pose = sender.publish(start).pose
    path = sender.path_from(getattr(pose, 'pose', pose))
    assert path.header.frame_id == 'map'
    assert path.poses[-1].pose == example(FILES['goal_pose']).pose


def test_via_poses(sender):
    stops = sender.publish('via_poses').poses

    def met():
        assert sender.call('new_route').success
        path = sender.client.received['path']
        places = [(each.pose.position.x, each.pose.position.y) for each in path[-1].poses]
        return all((stop.position.x, stop.position.y) in places for stop in stops)

    wait_until(met, 'a path by the stops')


def test_get_plan_moves_the_goal_out_of_the_block(sender):
    request = example(FILES['get_plan'])
    path = sender.call('get_plan', request).plan
    wanted, got = (pose_from_ros(stamped.pose) for stamped in (request.goal, path.poses[-1]))
    assert 0.0 < math.dist(wanted, got) <= request.tolerance
    request.tolerance = 0.0
    assert not sender.call('get_plan', request).plan.poses
    wait_until(lambda: sender.client.diagnostics()['code'] == 'GOAL_OCCUPIED', 'the reason')


def test_replan_tells_the_value(sender):
    answer = sender.call('replan')
    assert answer.success
    assert 'value' in answer.message


def test_cancel_without_a_solve_fails(sender):
    answer = sender.call('cancel')
    assert not answer.success
    assert answer.message
