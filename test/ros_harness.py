# SPDX-License-Identifier: Apache-2.0
"""A running planner node with a client, isolated from all other tests and processes."""

import itertools
import random
import threading
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from unittest import mock

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from handed_on import HandedOn
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray
from waiting import TIMEOUT, wait_until

from ambush_planner.recordings.messages import type_name
from ambush_planner.ros import planner_node
from ambush_planner.ros.conversions import occupancy_to_ros, pose_to_ros
from ambush_planner.ros.planner_node import PlannerNode
from ambush_planner.ros.topics import REQUESTS
from ambush_planner.worker import solve_queue
from examples.demo.node_process import lock_domain

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# A client that is slow for a moment keeps each message all the same.
ALL_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FRAME = 'map'
MARKER_TOPICS = ('edge_probabilities', 'mean_direction', 'ambush_sites', 'network', 'stops')
# About 100 nodes, which are not refined: a solve takes milliseconds.
SMALL = {'network.spacing': 1.0, 'network.refine': 0}
# A solve of minutes, which the tests cancel.
LONG = {'network.spacing': 0.0, 'network.target_nodes': 40_000, 'game.ambush_radius': 0.4}
# Higher ones are the demo's (examples/demo/node_process.py). The graph shows the node of an earlier
# test until Python has freed it, so tests do not use the same domain one after the other.
DOMAINS = itertools.cycle(random.sample(range(1, 51), 50))


def threads():
    """Names of the running threads of planner nodes."""
    names = ('solves', 'departures', 'recordings', 'maps', '_ambush_planner_listener')
    return [each.name for each in threading.enumerate() if each.name.startswith(names)]


@contextmanager
def free_domain():
    """A domain id that no other test on this machine uses at the same time."""
    for domain in itertools.islice(DOMAINS, 50):
        if (lock := lock_domain(domain)) is not None:
            with lock:
                yield domain
            return
    raise RuntimeError('all domain ids from 1 to 50 are taken')


@contextmanager
def spinning(node, executor):
    """Spin the node in a thread that is joined in the end: a thread left would abort Python."""
    stop, failed, name = threading.Event(), [], node.get_name()

    def spin():
        try:
            while not stop.is_set():
                executor.spin_once(timeout_sec=0.1)
        except BaseException as error:
            failed.append(error)

    executor.add_node(node)
    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
        if failed:
            raise AssertionError(f'{name} stopped spinning') from failed[0]


@contextmanager
def ros_context(domain):
    """A context of its own in a domain."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


class Client:
    """Publishes inputs, calls services and keeps all that the planner publishes."""

    def __init__(self, node, planner='ambush_planner'):
        self.node = node
        self.name = planner.lstrip('/')
        self.received = {}
        self._publishers = {}
        # First, so that a planner whose reports come knows that answers are listened for.
        self._services = {
            name: node.create_client(kind, f'{planner}/{name}', qos_profile=REQUESTS)
            for name, kind in (('new_route', Trigger), ('replan', Trigger), ('cancel', Trigger),
                               ('get_plan', GetPlan))
        }
        self._keep(PathMessage, 'path', ALL_LATCHED)
        self._keep(PathMessage, 'plan', ALL_LATCHED)
        self._keep(DiagnosticArray, '/diagnostics', 100)
        for topic in MARKER_TOPICS:
            self._keep(MarkerArray, topic, ALL_LATCHED, f'{planner}/')

    def _keep(self, kind, topic, qos, prefix=''):
        self.received[topic] = []
        self.node.create_subscription(kind, prefix + topic, self.received[topic].append, qos)

    def publish(self, topic, message, kind=None):
        """Publish once the planner listens; maps are latched. Bytes need their ``kind``."""
        kind = kind or type(message)
        if topic not in self._publishers:
            qos = LATCHED if kind is OccupancyGrid else 1
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        publisher = self._publishers[topic]
        wait_until(publisher.get_subscription_count, f'a subscription of {topic}')
        publisher.publish(message)

    def send(self, name, request=None):
        """Call a service of the planner and return the future of its answer."""
        client = self._services[name]
        assert client.wait_for_service(timeout_sec=TIMEOUT), name
        self.last('/diagnostics')
        return client.call_async(request or client.srv_type.Request())

    def call(self, name, request=None):
        """Call a service of the planner and return its answer."""
        future = self.send(name, request)
        wait_until(future.done, f'an answer of {name}')
        return future.result()

    def call_until(self, name, condition):
        """Call a Trigger until its answer is as wanted: inputs on their way are in no order."""
        answers = []

        def wanted():
            answers.append(self.call(name))
            return condition(answers[-1])

        wait_until(wanted, f'a wanted answer of {name}')
        return answers[-1]

    def give(self, grid=None, start=(1.5, 5.5), goal=(8.5, 5.5), **wanted):
        """Give the planner all inputs, and wait until its diagnostics are as wanted."""
        self.publish('alpha_map', risk_grid() if grid is None else grid)
        self.publish('start_pose', pose(*start))
        self.publish('goal_pose', pose(*goal))
        self.diagnostics(**(wanted or {'state': 'ready'}))

    def get_plan(self, start, goal, tolerance=0.0):
        """Ask for a plan between two stamped poses."""
        request = GetPlan.Request(start=start, goal=goal, tolerance=float(tolerance))
        return self.call('get_plan', request).plan

    def last(self, topic, count=1):
        """Return the latest message of a topic, once ``count`` have come."""
        wait_until(lambda: len(self.received[topic]) >= count, f'{count} messages on {topic}')
        return self.received[topic][-1]

    def diagnostics(self, **wanted):
        """Return the values of the latest report, once it has those wanted, and its level."""
        found = {}

        def matches():
            for report in reversed(self.received['/diagnostics']):
                if report.status[0].hardware_id == self.name:
                    values = {v.key: v.value for v in report.status[0].values}
                    found.update(values, level=report.status[0].level)
                    break
            return found and all(found[key] == value for key, value in wanted.items())

        try:
            wait_until(matches, f'diagnostics with {wanted}')
        except AssertionError as error:
            raise AssertionError(f'{error}; the last one: {found}') from None
        return found


def interface_of(planner):
    """Return what a planner publishes, subscribes to and serves: types by name.

    Maps, transforms and paths to check arrive at a hidden node.
    """
    nodes = planner, planner._listener.node

    def made(kind, name, type_):
        return {getattr(each, name): type_name(getattr(each, type_))
                for node in nodes for each in getattr(node, kind)}

    return SimpleNamespace(publishers=made('publishers', 'topic_name', 'msg_type'),
                           subscribers=made('subscriptions', 'topic_name', 'msg_type'),
                           services=made('services', 'service_name', 'srv_type'))


class Stage:
    """A planner node in this process, with a client in a context of its own."""

    def __init__(self, planner, client):
        self.planner, self.client = planner, client

    def use(self, values):
        """Set parameters, by name, together."""
        done = self.planner.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in values.items()])
        assert done.successful, done.reason

    def know(self, values):
        """Give the planner a map of cell values, and wait until it has it."""
        self.client.publish('alpha_map', risk_grid(values))
        inputs = self.planner._dispatcher.inputs
        wait_until(lambda: inputs.map and np.array_equal(inputs.map.values, values), 'the map')

    def give(self, *inputs, **wanted):
        """Give the planner all inputs, and return the client once it has them."""
        self.client.give(*inputs, **wanted)
        return self.client


@contextmanager
def stage(directory=None, parameters=None, domain=None, **planner_arguments):
    """A running planner (recording to ``directory``, if given) and its client.

    They have a domain of their own unless one is given.
    """
    values = {**SMALL, 'recording.enabled': directory is not None, **(parameters or {})}
    if directory is not None:
        values['recording.directory'] = str(directory)
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain()) if domain is None else domain
        own, other = (stack.enter_context(ros_context(domain)) for _ in range(2))
        stack.enter_context(mock.patch.object(solve_queue, 'WorkerProcess', HandedOn.take))
        stack.enter_context(mock.patch.object(planner_node, '_LAST_RECORDINGS_TIME', TIMEOUT))
        planner = PlannerNode(context=own, parameter_overrides=overrides, **planner_arguments)
        stack.enter_context(spinning(planner, SingleThreadedExecutor(context=own)))
        node = Node('client', context=other, namespace=planner.get_namespace())
        client = Client(node, planner.get_fully_qualified_name())
        stack.enter_context(spinning(node, SingleThreadedExecutor(context=other)))
        yield Stage(planner, client)


def recorded(folder, count):
    """The recordings below a folder, once there are as many."""
    wait_until(lambda: len(list(folder.rglob('*.mcap'))) >= count, f'{count} recordings')
    files = sorted(folder.rglob('*.mcap'))
    assert len(files) == count
    return files


def header(frame=FRAME):
    return Header(frame_id=frame)


def risk_grid(values=None, resolution=0.5, origin=(0.0, 0.0, 0.0), frame=FRAME):
    """A map, by default 10 m x 10 m with a block in the middle and more risk in the south."""
    if values is None:
        values = np.repeat(np.linspace(60, 10, 20).astype(np.int8)[:, None], 20, axis=1)
        values[8:14, 8:12] = 100
    return occupancy_to_ros(values, resolution, origin, header(frame))


def pose(x, y, yaw=0.0, frame=FRAME):
    return PoseStamped(header=header(frame), pose=pose_to_ros(x, y, yaw))


# Ends of most tests' trips on maps of 10 m x 10 m, and such a map without obstacles.
START, GOAL = pose(1.5, 5.5), pose(8.5, 5.5)
FLAT = np.full((20, 20), 10, dtype=np.int8)
