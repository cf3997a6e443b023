"""Bad requests: the answer names the input and its numbers, and the node goes on."""

import math

import pytest
from ros_harness import pose, risk_grid, stage

NAN = math.nan
START, GOAL = (1.5, 5.5), (8.5, 5.5)


@pytest.fixture(scope='module')
def client():
    """One node for all requests, which it has to survive."""
    with stage() as running:
        yield running.give()


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


def test_a_bad_pose_on_a_topic_replaces_the_last_one(client):
    for topic, good in (('start_pose', START), ('goal_pose', GOAL)):
        client.publish(topic, pose(NAN, 1))
        answer = client.call_until('new_route', lambda answer: '(nan, 1.0' in answer.message)
        assert not answer.success
        client.publish(topic, pose(*good))
        client.call_until('new_route', lambda answer: answer.success)


@pytest.mark.parametrize('tolerance', [-1.0, NAN, math.inf])
def test_bad_tolerance(client, tolerance):
    assert not client.get_plan(pose(*START), pose(*GOAL), tolerance).poses
    client.diagnostics(
        code='INVALID_OPTION', message=f'tolerance must be finite and >= 0 [m], got {tolerance}')


def test_a_cached_plan_does_not_answer_for_a_goal_at_the_start(client):
    x, y = START
    assert client.get_plan(pose(x, y), pose(x + 0.01, y)).poses
    assert not client.get_plan(pose(x, y), pose(x, y)).poses
    client.diagnostics(
        code='INVALID_NETWORK', message=f'start and goal are the same position, {START}')
