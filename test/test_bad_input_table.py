# SPDX-License-Identifier: Apache-2.0
"""Bad input: the documented rows that have a code, tried on one node, which survives them all."""

import math
import re

import interfaces
import numpy as np
import pytest
from commands import table_under
from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from ros_harness import header, pose, risk_grid, stage, wait_until
from test_conversions import BAD_MAPS
from test_long_solves import NORTH, solving

from ambush_planner.ros.inputs import MAX_STOPS

interfaces.install('map_msgs')
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402

START, GOAL, BLOCK = (1.5, 5.5), (8.5, 5.5), (5.0, 5.5)
NAN = math.nan
TABLE = {given: code.strip('`')
         for given, _, code in table_under('docs/ros_interface.md', 'Bad input')}


@pytest.fixture(scope='module')
def client():
    with stage() as running:
        yield running.give()


def _error_code(client):
    return client.diagnostics(level=b'\2')['code']


def _goes_on(client, **inputs):
    """Good inputs are followed by a departure and no error."""
    for topic, message in inputs.items():
        client.publish(topic, message)
    client.call_until('new_route', lambda answer: answer.success)
    client.diagnostics(code='NONE')


def refused_map(name):
    """Publish a map; the last good one stays."""
    def attempt(client):
        message, words = BAD_MAPS[name]
        client.publish('alpha_map', message)
        report = client.diagnostics(code='INVALID_MAP')
        assert re.search(words, report['message'])
        assert client.call('new_route').success, 'the last good map stays'
        client.publish('alpha_map', risk_grid())
        client.diagnostics(code='NONE')
        return 'INVALID_MAP'
    return attempt


def turned(**orientation):
    """A start with an orientation."""
    message = pose(*START)
    message.pose.orientation = Quaternion(**orientation)
    return message


def plans(*trips):
    """Request impossible plans (start, goal, words of the reason), and return their codes."""
    def attempt(client):
        codes = set()
        for start, goal, words in trips:
            client.get_plan(pose(*START), pose(*GOAL))
            client.diagnostics(code='NONE')
            assert not client.get_plan(start, goal).poses
            codes.add(_error_code(client))
            assert words in client.diagnostics()['message']
        return ' or '.join(sorted(codes, reverse=True))
    return attempt


def at_the_goal(client):
    client.publish('goal_pose', pose(*START))
    client.call_until('new_route', lambda answer: 'same position, (1.500, 5.500)' in answer.message)
    code = _error_code(client)
    _goes_on(client, goal_pose=pose(*GOAL))
    return code


def via(stops=(), frame='map'):
    return PoseArray(header=header(frame), poses=[pose(*stop).pose for stop in stops])


def bad_stops(client):
    codes = []
    for *stops, words in (((50.0, 2.0), 'stop 1'), (BLOCK, 'stop 1'), (GOAL, 'goal are the same')):
        client.publish('via_poses', via(stops))
        client.call_until('new_route', lambda answer, words=words: words in answer.message)
        codes.append(_error_code(client))
        _goes_on(client, via_poses=via())
    return '{}, {} or {}'.format(*codes)


def all_unknown(client):
    client.publish('alpha_map', risk_grid(np.full((20, 20), -1, dtype=np.int8)))
    client.call_until('new_route', lambda answer: not answer.success)
    code = _error_code(client)
    _goes_on(client, alpha_map=risk_grid())
    return code


def unreadable(client):
    kinds = {'alpha_map': OccupancyGrid, 'start_pose': PoseStamped, 'goal_pose': PoseStamped,
             'via_poses': PoseArray, 'initialpose': PoseWithCovarianceStamped,
             'alpha_map_updates': OccupancyGridUpdate}
    codes = set()
    for topic, kind in kinds.items():
        client.publish(topic, b'\x00\x01\x00\x00 no such message', kind)
        codes.add(_error_code(client))
        _goes_on(client, alpha_map=risk_grid())
    return ' or '.join(codes)


def nothing_has_arrived(_):
    with stage() as running:
        client = running.client
        code = None
        for missing, topic, message in (('risk map', 'alpha_map', risk_grid()),
                                        ('start', 'start_pose', pose(*START)),
                                        ('goal', 'goal_pose', pose(*GOAL))):
            said = f'no {missing} yet: publish one on /{topic}'
            client.call_until('new_route', lambda answer, said=said: said in answer.message)
            code = code or _error_code(client)
            client.publish(topic, message)
        client.diagnostics(code='NO_GOAL')
        client.call_until('new_route', lambda answer: answer.success)
    return code


def bad_updates(_):
    codes = set()
    with stage() as fresh:
        for x, code in ((0, 'NO_MAP'), (19, 'INVALID_MAP')):
            fresh.client.publish('alpha_map_updates', OccupancyGridUpdate(
                header=header(), x=x, width=2, height=1, data=[1, 2]))
            codes.add(fresh.client.diagnostics(code=code, level=b'\2')['code'])
            fresh.give()
            fresh.client.diagnostics(code='NONE')
    return ' or '.join(sorted(codes))


def full_queue(_):
    with solving() as (slow, _), pytest.MonkeyPatch.context() as patch:
        patch.setattr('ambush_planner.worker.solve_queue._MAX_WAITING', 1)
        slow.client.send('get_plan', GetPlan.Request(start=NORTH, goal=pose(5.0, 50.0)))
        queue = slow.planner._dispatcher._plans.queue
        wait_until(lambda: len(queue.keys) == 2, 'the request')
        assert not slow.client.get_plan(pose(5.0, 50.0), NORTH).poses
        code = _error_code(slow.client)
        assert slow.client.call('cancel').success
    return code


ROWS = {
    'no map': nothing_has_arrived,
    'map without cells': refused_map('no cells'),
    'data not width x height long': refused_map('data too short'),
    'a claim of 30 000 x 30 000 cells': refused_map('huge claim'),
    'resolution 0, negative or not finite': refused_map('resolution NaN'),
    'cell values outside -1..100': refused_map('value over 100'),
    'origin not finite': refused_map('origin NaN'),
    'origin not a unit quaternion, or tilted': refused_map('origin tilted'),
    'map without a frame': refused_map('no frame'),
    'all cells unknown': all_unknown,
    'pose not finite': plans(
        (pose(NAN, 1), pose(*GOAL), 'start: position (nan, 1.0, 0.0)'),
        (pose(*START), pose(1, math.inf), 'goal: position (1.0, inf, 0.0)')),
    'orientation not a unit quaternion': plans(
        (turned(w=0.0), pose(*GOAL), 'start: orientation')),
    'start or goal outside the map': plans(
        (pose(-1, 5), pose(*GOAL), 'start (-1.000, 5.000) is outside the map, which has x from 0'),
        (pose(*START), pose(5, 11), 'goal (5.000, 11.000) is outside the map, which has x from 0')),
    'start or goal in an obstacle': plans(
        (pose(*BLOCK), pose(*GOAL), 'start (5.000, 5.500) lies in an obstacle'),
        (pose(*START), pose(*BLOCK), 'goal (5.000, 5.500) lies in an obstacle')),
    'start and goal at the same position': at_the_goal,
    'a stop outside the map, in an obstacle, or at the previous stop': bad_stops,
    'pose without a frame, or in one that TF does not know': plans(
        (pose(*START, frame='odom'), pose(*GOAL), "in the frame 'odom', the map in 'map'"),
        (pose(*START), pose(*GOAL, frame=''), "goal is given in the frame '', the map in 'map'")),
    'bytes that are not a message': unreadable,
    'a map update that does not fit the map, or arrives before it': bad_updates,
    'more solves than may wait': full_queue,
}


@pytest.mark.parametrize('name', [name for name in TABLE if TABLE[name]])
def test_row(client, name):
    assert ROWS[name](client) == TABLE[name]
    assert client.call('new_route').success


def test_a_bad_pose_on_a_topic_replaces_the_last_one(client):
    for topic, good in (('start_pose', START), ('goal_pose', GOAL)):
        client.publish(topic, pose(NAN, 1))
        client.call_until('new_route', lambda answer: '(nan, 1.0' in answer.message)
        _goes_on(client, **{topic: pose(*good)})


@pytest.mark.parametrize(('stops', 'frame', 'code', 'words'), [
    ([(2.0, 2.0)], 'moon', 'TF_ERROR', 'stop 1'),
    ([(2.0, NAN)], 'map', 'INVALID_POSE', 'stop 1'),
    ([(2.0, 2.0)] * (MAX_STOPS + 1), 'map', 'INVALID_POSE', 'via_poses'),
])
def test_bad_stops(client, stops, frame, code, words):
    client.publish('via_poses', via(stops, frame))
    client.call_until('new_route', lambda answer: words in answer.message)
    client.diagnostics(code=code)
    _goes_on(client, via_poses=via())


@pytest.mark.parametrize('tolerance', [-1.0, math.inf])
def test_bad_tolerance(client, tolerance):
    assert not client.get_plan(pose(*START), pose(*GOAL), tolerance).poses
    words = f'tolerance must be finite and >= 0 [m], got {tolerance}'
    wait_until(lambda: words in client.diagnostics()['message'], words)
    client.diagnostics(code='INVALID_OPTION')
