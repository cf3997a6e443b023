# SPDX-License-Identifier: Apache-2.0
"""Changes of the map over DDS: the displayed plan is assessed, solved again, and departed on."""

import re
from contextlib import contextmanager

import interfaces
import numpy as np
import pytest
from rclpy.qos import QoSProfile
from robots import Robot
from ros_harness import (
    FLAT,
    GOAL,
    LONG,
    START,
    header,
    pose,
    recorded,
    risk_grid,
    stage,
    wait_until,
)
from waiting import TIMEOUT, held

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.parameters import values as parameter_values
from ambush_planner.recordings.recorded_departure import read_departure
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros import subscriptions
from ambush_planner.ros.transforms import FrameTransforms
from ambush_planner.worker.process import WorkerProcess

interfaces.install('map_msgs')
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402

WALL = np.full((14, 1), 100)


@pytest.fixture
def running():
    with stage() as running:
        running.give(risk_grid(FLAT))
        assert running.client.call('new_route').success
        running.client.diagnostics(departures='1', stale='no')
        yield running


def update(client, x, y, values, frame='map'):
    """Publish an update, which changes cells from column x and row y on."""
    values = np.asarray(values, dtype=np.int8)
    client.publish('alpha_map_updates', OccupancyGridUpdate(
        header=header(frame), x=x, y=y, width=values.shape[1], height=values.shape[0],
        data=values.ravel().tolist()))


def current_values(running):
    return running.planner._dispatcher.inputs.current_map().values


def displays(client):
    """How often a plan has been displayed."""
    return len(client.received['edge_probabilities'])


def test_an_update_far_from_the_routes_keeps_the_plan_and_an_obstacle_is_avoided_at_once(running):
    client = running.client
    update(client, 0, 0, [[100, 100, 100]])
    wait_until(lambda: current_values(running)[0, 2] == 100, 'the update')
    assert client.call('new_route').success
    client.diagnostics(departures='2', stale='no', level=b'\1')
    assert displays(client) == 1
    update(client, 10, 0, WALL)
    client.last('edge_probabilities', 2)
    blocked = np.zeros((20, 20), bool)
    blocked[:14, 10] = True
    for number in range(3, 6):
        path = path_from_ros(client.get_plan(START, GOAL))
        client.diagnostics(departures=str(number))
        cells = np.floor(path[:, :2] / 0.5).astype(int)
        assert not blocked[cells[:, 1], cells[:, 0]].any()
    assert displays(client) == 2
    client.diagnostics(stale='no')


def test_a_value_that_rises_is_reported_and_solved_again_from_the_last_plan(running, monkeypatch):
    warm, solve = [], WorkerProcess.solve
    monkeypatch.setattr(WorkerProcess, 'solve', lambda worker, request, *rest: (
        warm.append(request.warm is not None), solve(worker, request, *rest))[1])
    client = running.client
    running.use({'replan.tolerance': 1e9})
    before = client.diagnostics(departures='1')
    dear = FLAT.copy()
    dear[:, 8:12] = 80
    client.publish('alpha_map', risk_grid(dear))
    wait_until(lambda: client.diagnostics()['current_value'] != before['current_value'], 'a value')
    report = client.diagnostics(stale='no', departures='1', value=before['value'])
    assert float(report['current_value']) > 2 * float(before['value'])
    assert displays(client) == 1
    running.use({'replan.tolerance': 0.05})
    dear[0, 0] = 11
    client.publish('alpha_map', risk_grid(dear))
    client.last('edge_probabilities', 2)
    after = client.diagnostics(stale='no', departures='1')
    assert float(after['value']) <= float(report['current_value'])
    assert after['current_value'] == after['value']
    assert warm == [True]


@pytest.mark.parametrize('rows', [14, 20])
def test_a_map_that_is_good_again_while_the_plan_is_solved_leaves_nothing_stale(running, rows):
    """Also if there is no route on the map that is solved."""
    client = running.client
    with held(WorkerProcess, 'solve'):
        update(client, 10, 0, np.full((rows, 1), 100))
        client.diagnostics(stale='yes', state='solving')
        update(client, 10, 0, FLAT[:rows, :1])
        client.diagnostics(stale='no', state='solving')
    if rows < 20:
        client.last('edge_probabilities', 2)
    client.diagnostics(state='ready')
    assert client.call('new_route').success
    client.diagnostics(stale='no', departures='2')


def test_a_background_solve_that_fails_is_reported_as_long_as_it_lasts(running, monkeypatch):
    client = running.client
    monkeypatch.setattr('ambush_planner.ros.diagnostics._ERROR_HOLD', 0.0)
    update(client, 10, 0, np.full((20, 1), 100))
    client.diagnostics(stale='yes', state='ready', level=b'\1', code='NONE')
    wait_until(lambda: 'the new solve failed' in client.diagnostics()['message'], 'the reason')
    assert not client.call('new_route').success
    update(client, 10, 0, np.full((20, 1), 10))
    client.diagnostics(stale='no')
    assert client.call('new_route').success


@contextmanager
def maps_read_slowly(running):
    """Hold up the thread that reads maps once it has begun; more arrives meanwhile."""
    inputs = running.planner._dispatcher.inputs
    with held(inputs, 'accept_map') as (reads, go_on):
        running.client.publish('alpha_map', risk_grid(FLAT + 1))
        wait_until(reads.is_set, 'a map')
        yield
        go_on.set()


def waiting(running, count):
    """Wait until as many messages wait for the thread that reads them."""
    listening = running.planner._listening
    wait_until(lambda: len(listening._unread['alpha_map']) == count, 'messages')


@pytest.mark.parametrize('newest', ['map', 'update'])
def test_maps_and_updates_count_in_the_order_in_which_they_were_sent(running, newest):
    """rclpy hands over the map first, whichever was sent first."""
    client = running.client
    send = {'map': lambda: client.publish('alpha_map', risk_grid(FLAT)),
            'update': lambda: update(client, 10, 0, WALL)}
    first = 'update' if newest == 'map' else 'map'
    with maps_read_slowly(running):
        send[first]()
        waiting(running, 1)
        send[newest]()
        waiting(running, 2)
    wanted = FLAT.copy()
    if newest == 'update':
        wanted[:14, 10:11] = WALL
    wait_until(lambda: np.array_equal(current_values(running), wanted), 'the newest cells')


def test_updates_that_were_lost_are_said_until_the_next_whole_map(monkeypatch):
    monkeypatch.setattr(subscriptions, 'UPDATES', QoSProfile(depth=5))
    with stage() as running:
        client = running.give(risk_grid(FLAT))
        update(client, 0, 0, [[1]])
        wait_until(lambda: current_values(running)[0, 0] == 1, 'the first update')
        with held(FrameTransforms, 'receive') as (received, _):  # the thread that receives
            Robot(running).moves_to(1.0, 1.0)
            wait_until(received.is_set, 'a transform')
            for number in range(20):
                update(client, number, 0, [[number]])
        wait_until(lambda: '15 messages on /alpha_map_updates were lost'
                   in client.diagnostics()['message'], 'the warning')
        client.publish('alpha_map', risk_grid(FLAT))
        wait_until(lambda: 'were lost' not in client.diagnostics()['message'], 'its end')


def test_recordings_hold_the_updated_map_and_what_has_changed_since_the_plan(tmp_path):
    with stage(tmp_path) as running:
        client = running.give(risk_grid(FLAT))
        update(client, 3, 4, [[20, 30], [40, -1]])
        wait_until(lambda: current_values(running)[4, 3] == 20, 'the update')
        assert client.get_plan(START, GOAL).poses
        update(client, 0, 0, [[100, 90]])
        wait_until(lambda: current_values(running)[0, 0] == 100, 'the update')
        assert client.get_plan(pose(1.6, 5.4), pose(8.5, 5.6)).poses
    first, second = map(read_departure, recorded(tmp_path, 2))
    wanted = FLAT.copy()
    wanted[4:6, 3:5] = [[20, 30], [40, -1]]
    assert np.array_equal(first.planned_on.values, wanted) and first.newest is first.planned_on
    assert np.array_equal(second.planned_on.values, wanted)
    assert second.metadata.trip == first.metadata.trip
    assert first.metadata.ends == ((1.5, 5.5), (8.5, 5.5))
    assert second.metadata.ends == ((1.6, 5.4), (8.5, 5.6))
    wanted[0, :2] = [100, 90]
    assert np.array_equal(second.newest.values, wanted)


def test_a_refinement_that_was_cancelled_begins_again_with_the_next_departure():
    fine = np.repeat(np.linspace(60, 10, 100).astype(np.int8)[:, None], 100, axis=1)
    with stage(parameters={**LONG, 'network.refine': -1}) as running:
        client = running.give(risk_grid(fine, 0.1))
        for _ in range(2):
            assert client.call('new_route').success
            client.diagnostics(refining='yes')
            assert client.call('cancel').success
            client.diagnostics(refining='no', state='ready')


def test_a_first_plan_is_refined_while_its_departure_leaves(tmp_path, monkeypatch):
    """Each departure is recorded with the network that it was drawn on."""
    monkeypatch.setattr(parameter_values, '_PLAIN_NODES', 50)
    values = {'network.spacing': 0.0, 'network.target_nodes': 100, 'network.refine': -1,
              'game.ambush_radius': 0.6}
    with stage(tmp_path, values) as running:
        client = running.client
        running.give(risk_grid())
        assert client.call('new_route').success
        first = client.diagnostics(departures='1')
        assert first['refined'] == ''
        wait_until(lambda: client.diagnostics()['refined'], 'a refined plan',
                   3.0 * TIMEOUT)  # at low priority, on a busy machine
        refined = client.diagnostics(refining='no', state='ready')
        assert float(refined['value']) < float(first['value'])
        assert client.call('new_route').success
        last = client.diagnostics(departures='2', refining='no')
        assert last['value'] == refined['value'] == last['departure_value']
        nodes = re.search(r'(\d+) nodes', client.call('replan').message)[1]
        assert int(nodes) > 100, 'not a first plan again'
    files = recorded(tmp_path, 2)
    nodes = [len(read_departure(each).trip.legs[0].network.points) for each in files]
    assert nodes[0] < 70 and nodes[1] > 100
    verifier = Verifier()
    assert not any(verifier.verify(each).problems for each in files)
