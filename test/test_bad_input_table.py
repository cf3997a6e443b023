"""Bad input: each row of the documented table, tried on one node, which survives them all."""

import math
import re
from pathlib import Path

import interfaces
import numpy as np
import pytest
from bad_maps import BAD_MAPS
from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter
from ros_harness import Stage, header, pose, risk_grid, stage, wait_until
from test_conversions import turned
from test_long_solves import NORTH, QUICK, solving, use

interfaces.install('map_msgs')
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402

REFERENCE = Path(__file__).resolve().parent.parent / 'docs/ros_interface.md'
START, GOAL, BLOCK = (1.5, 5.5), (8.5, 5.5), (5.0, 5.5)
NAN = math.nan


def table_of(heading):
    """Return {first cell: other cells} of the table below a heading of the reference."""
    section = REFERENCE.read_text().split(f'\n## {heading}\n')[1].split('\n#')[0]
    lines = [line.strip('|').split('|') for line in section.splitlines() if line.startswith('|')]
    return {first.strip(): [cell.strip() for cell in cells] for first, *cells in lines[2:]}


TABLE = table_of('Bad input')


@pytest.fixture(scope='module')
def running():
    with stage() as running:
        running.give()
        yield running


def refused_maps(*names):
    """Publish each map; the last good one stays."""
    def attempt(running: Stage):
        for name in names:
            message, words = BAD_MAPS[name]
            running.client.publish('alpha_map', message)
            report = running.client.diagnostics(code='INVALID_MAP')
            assert re.search(words, report['message'])
            assert running.client.call('new_route').success, 'the last good map stays'
            running.client.publish('alpha_map', risk_grid())
            running.client.diagnostics(code='NONE')
        return 'INVALID_MAP'
    return attempt


def plans(*trips):
    """Request impossible plans (start, goal, words of the reason), and return their codes."""
    def attempt(running: Stage):
        codes = set()
        for start, goal, words in trips:
            running.client.get_plan(pose(*START), pose(*GOAL))
            running.client.diagnostics(code='NONE')
            assert not running.client.get_plan(start, goal).poses
            codes.add(_error_code(running.client))
            assert words in running.client.diagnostics()['message']
        return ' or '.join(sorted(codes, reverse=True))
    return attempt


def at_the_goal(running):
    client = running.client
    assert len(client.get_plan(pose(*START), pose(*START)).poses) == 1
    client.publish('goal_pose', pose(*START))
    client.call_until('new_route', lambda answer: 'same position, (1.5, 5.5)' in answer.message)
    code = _error_code(client)
    client.publish('goal_pose', pose(*GOAL))
    client.call_until('new_route', lambda answer: answer.success)
    return code


def _error_code(client):
    return client.diagnostics(level=b'\2')['code']


def bad_stops(running):
    codes = []
    for *stops, words in (((50.0, 2.0), 'stop 1'), (BLOCK, 'stop 1'), (GOAL, 'goal are the same')):
        running.client.publish(
            'via_poses', PoseArray(header=header(), poses=[pose(*each).pose for each in stops]))
        running.client.call_until('new_route', lambda answer, words=words: words in answer.message)
        codes.append(_error_code(running.client))
        running.client.publish('via_poses', PoseArray())
        running.client.call_until('new_route', lambda answer: answer.success)
        running.client.diagnostics(code='NONE')
    return '{}, {} or {}'.format(*codes)


def all_unknown(running):
    running.client.publish('alpha_map', risk_grid(np.full((20, 20), -1, dtype=np.int8)))
    running.client.call_until('new_route', lambda answer: not answer.success)
    code = _error_code(running.client)
    running.client.publish('alpha_map', risk_grid())
    running.client.call_until('new_route', lambda answer: answer.success)
    return code


def no_map(_):
    with stage() as empty:
        assert 'no risk map yet' in empty.client.call('new_route').message
        return _error_code(empty.client)


def unreadable(running):
    kinds = {'alpha_map': OccupancyGrid, 'start_pose': PoseStamped, 'goal_pose': PoseStamped,
             'via_poses': PoseArray, 'initialpose': PoseWithCovarianceStamped,
             'alpha_map_updates': OccupancyGridUpdate}
    codes = set()
    for topic, kind in kinds.items():
        running.client.publish('alpha_map', risk_grid())
        running.client.call_until('new_route', lambda answer: answer.success)
        running.client.diagnostics(code='NONE')
        running.client.publish(topic, b'\x00\x01\x00\x00 no such message', kind)
        codes.add(_error_code(running.client))
    return ' or '.join(codes)


def two_maps(running):
    client = running.client
    blocked = np.zeros((20, 20), dtype=np.int8)
    blocked[:, 10] = 100
    for first, second, words in (
            (blocked, None, 'departure'), (None, blocked, 'no route from'), (blocked, None, 'dep')):
        client.publish('alpha_map', risk_grid(first))
        client.publish('alpha_map', risk_grid(second))
        client.call_until('new_route', lambda answer, words=words: words in answer.message)
    return ''


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
    with solving() as (slow, future):
        use(slow, {'queue.size': 1})
        slow.client.send('get_plan', GetPlan.Request(start=NORTH, goal=pose(5.0, 50.0)))
        wait_until(lambda: len(slow.planner._dispatcher._plans._pending) == 2, 'the request')
        assert not slow.client.get_plan(pose(5.0, 50.0), NORTH).poses
        code = _error_code(slow.client)
        assert slow.client.call('cancel').success
    return code


def new_goal_during_a_solve(_):
    with solving() as (slow, future):
        slow.client.publish('goal_pose', NORTH)
        use(slow, QUICK)
        assert slow.client.call('cancel').success
        wait_until(future.done, 'the answer')
        slow.client.call_until(
            'new_route', lambda _: slow.client.last('path').poses[-1].pose == NORTH.pose)
    return ''


def many_calls(_):
    """Some of the thousand calls of benchmarks/node_load.py."""
    with stage() as busy:
        client = busy.give()
        futures = [client.send('new_route') for _ in range(100)]
        wait_until(lambda: all(each.done() for each in futures), 'the answers')
        assert all(each.result().success for each in futures)
        client.diagnostics(departures='100')
    return ''


def refused_parameters(*changes):
    """Set parameters that are refused with a reason."""
    def attempt(running: Stage):
        for values, reason in changes:
            result = running.planner.set_parameters_atomically(
                [Parameter(name, value=value) for name, value in values.items()])
            assert not result.successful
            assert reason in result.reason
        assert running.client.call('new_route').success
        return ''
    return attempt


def unknown_parameter(running):
    with pytest.raises(ParameterNotDeclaredException, match='undeclared parameter'):
        running.planner.set_parameters([Parameter('network.no_such_thing', value=1)])
    return ''


ROWS = {
    'no map': no_map,
    'map without cells': refused_maps('no cells', 'no rows'),
    'data not width x height long': refused_maps('data too short', 'data too long'),
    'a claim of 30 000 x 30 000 cells': refused_maps('huge claim'),
    'resolution 0, negative or not finite': refused_maps(
        'resolution 0', 'resolution negative', 'resolution NaN', 'resolution infinite'),
    'cell values outside -1..100': refused_maps('value over 100', 'value under -1'),
    'origin not finite': refused_maps('origin NaN', 'origin infinite'),
    'origin not a unit quaternion, or tilted': refused_maps(
        'origin quaternion NaN', 'origin quaternion zero', 'origin quaternion long',
        'origin tilted'),
    'map without a frame': refused_maps('no frame'),
    'all cells unknown': all_unknown,
    'pose not finite': plans(
        (pose(NAN, 1), pose(*GOAL), 'start: position (nan, 1.0, 0.0)'),
        (pose(*START), pose(1, math.inf), 'goal: position (1.0, inf, 0.0)')),
    'orientation not a unit quaternion': plans(
        (turned(w=0.0), pose(*GOAL), 'start: orientation'),
        (pose(*START), pose(*GOAL, NAN), 'goal: orientation')),
    'start or goal outside the map': plans(
        (pose(-1, 5), pose(*GOAL), 'start (-1.000, 5.000) is outside the map, which is 10 m x'),
        (pose(*START), pose(5, 11), 'goal (5.000, 11.000) is outside the map, which is 10 m x')),
    'start or goal in an obstacle': plans(
        (pose(*BLOCK), pose(*GOAL), 'start (5.000, 5.500) lies in an obstacle'),
        (pose(*START), pose(*BLOCK), 'goal (5.000, 5.500) lies in an obstacle')),
    'start and goal at the same position': at_the_goal,
    'a stop outside the map, in an obstacle, or at the previous stop': bad_stops,
    'pose without a frame, or in one that TF does not know': plans(
        (pose(*START, frame='odom'), pose(*GOAL), "in the frame 'odom', the map in 'map'"),
        (pose(*START), pose(*GOAL, frame=''), "goal is given in the frame '', the map in 'map'")),
    'bytes that are not a message': unreadable,
    'parameters that contradict each other': refused_parameters(
        ({'map.alpha_min': 20.0, 'map.alpha_max': 10.0}, 'map.alpha_min'),
        ({'strategy.solver': 'simplex', 'strategy.max_exposure': 2.0}, 'strategy.max_exposure')),
    'a parameter out of its range or of another type': refused_parameters(
        ({'strategy.max_detour': 0.5}, 'out of range'), ({'network.spacing': 'wide'}, 'type')),
    'an unknown parameter': unknown_parameter,
    'two maps in quick succession': two_maps,
    'a map update that does not fit the map, or arrives before it': bad_updates,
    'more solves than may wait': full_queue,
    'another goal while a solve runs': new_goal_during_a_solve,
    '1000 calls at once from 4 clients': many_calls,
}


def test_the_table_has_the_rows_that_are_tried():
    assert list(TABLE) == list(ROWS)


@pytest.mark.parametrize('name', ROWS)
def test_row(running, name):
    code = TABLE[name][-1].strip('`')
    assert ROWS[name](running) == code
    assert running.client.call('new_route').success


def test_nothing_has_arrived():
    with stage() as running:
        client = running.client
        for service in ('new_route', 'replan'):
            answer = client.call(service)
            assert not answer.success
            assert answer.message == 'no risk map yet: publish one on alpha_map'
        assert not client.get_plan(pose(*START), pose(*GOAL)).poses
        client.diagnostics(code='NO_MAP', level=b'\2')
        client.publish('alpha_map', risk_grid())
        answer = client.call_until('new_route', lambda answer: 'map' not in answer.message)
        assert answer.message == (
            'no start yet: publish one on start_pose or initialpose, or set robot_base_frame')
        client.diagnostics(code='NO_START')
        client.publish('start_pose', pose(*START))
        answer = client.call_until('new_route', lambda answer: 'start' not in answer.message)
        assert answer.message == 'no goal yet: publish one on goal_pose'
        client.diagnostics(code='NO_GOAL')
        client.publish('goal_pose', pose(*GOAL))
        client.call_until('new_route', lambda answer: answer.success)


def test_a_bad_pose_on_a_topic_replaces_the_last_one(running):
    client = running.client
    for topic, good in (('start_pose', START), ('goal_pose', GOAL)):
        client.publish(topic, pose(NAN, 1))
        answer = client.call_until('new_route', lambda answer: '(nan, 1.0' in answer.message)
        assert not answer.success
        client.publish(topic, pose(*good))
        client.call_until('new_route', lambda answer: answer.success)


@pytest.mark.parametrize('tolerance', [-1.0, NAN, math.inf])
def test_bad_tolerance(running, tolerance):
    client = running.client
    assert not client.get_plan(pose(*START), pose(*GOAL), tolerance).poses
    words = f'tolerance must be finite and >= 0 [m], got {tolerance}'
    wait_until(lambda: words in client.diagnostics()['message'], words)
    client.diagnostics(code='INVALID_OPTION')
