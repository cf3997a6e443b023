# SPDX-License-Identifier: Apache-2.0
"""The lifecycle states, changed by the services that Nav2's lifecycle manager calls."""

import warnings
from collections import Counter
from unittest.mock import Mock

import interfaces
from handed_on import halt_workers
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Path
from rclpy.service import Service
from ros_harness import GOAL, LATCHED, LONG, START, recorded, stage, threads, wait_until
from waiting import answer_of

from ambush_planner.errors import AmbushPlannerError
from ambush_planner.ros import planner_node

WAITING = {'autostart': False}


class Manager:
    """Changes the state as Nav2's lifecycle manager does: by id, without a label."""

    def __init__(self, client):
        self.client = client
        self._change, self._state = (
            client.node.create_client(kind, f'/{client.name}/{name}')
            for kind, name in ((ChangeState, 'change_state'), (GetState, 'get_state')))
        nothing = Transition(label='no such transition')
        answer_of(self._change, ChangeState.Request(transition=nothing))
        answer_of(self._state, GetState.Request())

    def call(self, client, request):
        asked = client.call_async(request)
        wait_until(asked.done, f'an answer of {client.srv_name}')
        return asked.result()

    def change(self, name):
        """Return whether the transition succeeded."""
        number = getattr(Transition, f'TRANSITION_{name.upper()}')
        request = ChangeState.Request(transition=Transition(id=number))
        return self.call(self._change, request).success

    @property
    def state(self):
        return self.call(self._state, GetState.Request()).current_state.label

    def go(self, **states):
        """Make transitions, and check the state after each."""
        for transition, state in states.items():
            assert self.change(transition), transition
            assert self.state == state
            if state != 'active':
                self.client.diagnostics(state=state)


def start(running):
    manager = Manager(running.client)
    manager.go(configure='inactive', activate='active')
    return manager


def test_answers_are_sent_again_to_a_client_that_is_not_known_yet(monkeypatch):
    """As rclpy warns when the middleware has discovered only half of a client that calls."""
    send, tries = Service.send_response, Counter()

    def late(service, response, header):
        tries[service.srv_name] += 1
        if tries[service.srv_name] % 3:
            warnings.warn('failed to send response (timeout): client', RuntimeWarning, stacklevel=1)
        else:
            send(service, response, header)

    monkeypatch.setattr(Service, 'send_response', late)
    with stage(parameters=WAITING) as running:
        start(running)
        assert 'no risk map' in running.client.call('new_route').message
    assert {'change_state', 'new_route'} <= {name.rpartition('/')[2] for name in tries}


def test_without_autostart_it_waits_and_refuses_in_each_state():
    before = threads()
    with stage(parameters=WAITING) as running:
        client, manager = running.client, Manager(running.client)
        assert manager.state == 'unconfigured'
        assert threads() == before
        for name in ('activate', 'deactivate', 'cleanup', 'active_shutdown'):
            assert not manager.change(name), name
        for name in ('new_route', 'replan', 'cancel'):
            assert 'not configured' in client.call(name).message
        assert not client.get_plan(START, GOAL).poses
        client.diagnostics(state='unconfigured', code='INACTIVE')
        manager.go(configure='inactive')
        client.give(state='inactive')
        client.call_until('new_route', lambda answer: 'is inactive' in answer.message)
        assert not client.get_plan(START, GOAL).poses
        client.diagnostics(state='inactive', code='INACTIVE')
        assert not client.received['path']
        manager.go(activate='active')
        client.call_until('new_route', lambda answer: answer.success)
        client.diagnostics(state='ready', code='NONE')
        assert not manager.change('configure')


def test_plans_are_kept_while_it_is_inactive_unless_the_map_changes():
    with stage() as running:
        client, manager = running.give(), Manager(running.client)
        assert client.call('new_route').success
        manager.go(deactivate='inactive')
        assert 'inactive' in client.call('new_route').message
        manager.go(activate='active')
        assert client.call('new_route').success
        assert len(client.received['edge_probabilities']) == 1
        client.last('path', 2)
        client.diagnostics(departures='2')
        manager.go(deactivate='inactive')
        values = running.planner._dispatcher.inputs.map.values.copy()
        values[4, 2:18] = 100
        running.know(values)
        assert not any(running.planner._dispatcher.activity)
        manager.go(activate='active')
        client.last('edge_probabilities', 2)


def test_deactivation_answers_waiting_requests():
    with stage(parameters=LONG) as running:
        client, manager = running.give(), Manager(running.client)
        waiting = [client.send('new_route'), client.send('replan')]
        client.diagnostics(state='solving')
        halt_workers()
        manager.go(deactivate='inactive')
        wait_until(lambda: all(each.done() for each in waiting), 'the answers')
        assert not any(each.result().success for each in waiting)
        assert not any(running.planner._dispatcher.activity)
        assert client.call('cancel').message == 'no solve is running'
        assert not client.received['path']


def test_cleanup_forgets_everything_except_the_parameters(tmp_path):
    with stage(tmp_path) as running:
        client, manager = running.give(), Manager(running.client)
        assert client.call('new_route').success
        running.use({'strategy.max_detour': 1.4})
        others = threads()
        manager.go(deactivate='inactive', cleanup='unconfigured')
        wait_until(lambda: not set(threads()) & set(others), 'the end of worker, recordings and TF')
        recorded(tmp_path, 1)
        # A late subscriber gets no earlier path; the planner gets the latched map.
        late = []
        client.node.create_subscription(Path, 'path', late.append, LATCHED)
        manager.go(configure='inactive', activate='active')
        client.diagnostics(message='waiting for /start_pose, /goal_pose', departures='0')
        running.give()
        assert client.call('new_route').success
        wait_until(lambda: late, 'the path')
        assert late == client.received['path'][1:]
        assert running.planner.get_parameter('strategy.max_detour').value == 1.4
    recorded(tmp_path, 2)


def test_after_shutdown_it_refuses_requests():
    with stage() as running:
        manager = Manager(running.client)
        manager.go(active_shutdown='finalized')
        assert not running.client.call('new_route').success
        assert not manager.change('configure')
        assert manager.state == 'finalized'


def test_a_failed_configuration_says_why_and_leaves_nothing(monkeypatch):
    def broken(*_):
        raise AmbushPlannerError('no room')

    with stage(parameters=WAITING) as running:
        manager = Manager(running.client)
        before = threads()
        monkeypatch.setattr(planner_node, 'Subscriptions', broken)
        assert not manager.change('configure')
        assert manager.state == 'unconfigured'
        assert 'no room' in running.client.diagnostics(state='unconfigured')['message']
        assert threads() == before
        monkeypatch.undo()
        start(running)
        assert running.give().call('new_route').success


def test_a_manager_hears_the_heartbeat_of_an_active_node():
    """As nav2_util's nodes do it: the id is the node's name, and the end is announced."""
    interfaces.install('bond')
    from bond.msg import Status
    heard = []
    try:
        with stage(parameters=WAITING) as running:
            running.client.node.create_subscription(Status, 'bond', heard.append, 10)
            manager = start(running)
            wait_until(lambda: len(heard) > 3, 'heartbeats')
            assert all(each.active and each.id == 'ambush_planner' for each in heard)
            assert len({each.instance_id for each in heard}) == 1
            assert heard[0].heartbeat_timeout == 4.0
            manager.go(deactivate='inactive')
            wait_until(lambda: not heard[-1].active, 'the end')
            count = len(heard)
            manager.go(activate='active')
            wait_until(lambda: len(heard) > count and heard[-1].active, 'heartbeats again')
            running.planner.stop_solving(Mock())
            wait_until(lambda: not heard[-1].active, 'the end of the node')
    finally:
        interfaces.uninstall('bond')
