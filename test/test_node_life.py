# SPDX-License-Identifier: Apache-2.0
"""What the diagnostics report: errors, warnings, levels; and how work in order ends."""

from concurrent.futures import Future
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import pose, risk_grid, stage, wait_until
from waiting import stderr_in

from ambush_planner.errors import AmbushPlannerError
from ambush_planner.planning.changed_ground import Assessment
from ambush_planner.ros import planner_node
from ambush_planner.ros.diagnostics import Problem, Status, status_to_ros
from ambush_planner.ros.serial_executor import SerialExecutor
from ambush_planner.worker.solve_errors import SolveCancelled


def test_an_error_of_a_request_disappears_and_a_bad_map_stays(monkeypatch):
    monkeypatch.setattr('ambush_planner.ros.diagnostics._ERROR_HOLD', 0.5)
    with stage() as running:
        client = running.client
        assert not client.call('new_route').success
        report = client.diagnostics(code='NONE')
        assert report['level'] == DiagnosticStatus.WARN, 'the inputs are still missing'
        assert report['message'] == 'waiting for /alpha_map, /start_pose, /goal_pose'
        client.publish('alpha_map', risk_grid(resolution=0.0))
        client.diagnostics(code='INVALID_MAP')
        client.last('/diagnostics', len(client.received['/diagnostics']) + 1)
        client.diagnostics(code='INVALID_MAP', level=DiagnosticStatus.ERROR)
        client.publish('alpha_map', risk_grid())
        client.diagnostics(code='NONE')


def test_an_error_of_any_work_reaches_somebody_and_so_does_the_end():
    errors, future, late, cancelled = [], Future(), Future(), Future()
    executor = SerialExecutor('work', errors.append)
    cancelled.cancel()
    for each in (future, cancelled, None):
        executor.submit(lambda: 1 / 0, *[each] if each else [])
    executor.finish()
    executor.close()
    executor.submit(lambda: None, late)
    assert isinstance(future.exception(0.0), ZeroDivisionError) and cancelled.cancelled()
    assert [type(each) for each in errors] == [ZeroDivisionError]
    assert isinstance(late.exception(0.0), SolveCancelled)


@pytest.mark.parametrize('errors, level, code', [
    ({'request': SolveCancelled('x')}, DiagnosticStatus.WARN, 'CANCELLED'),
    ({'request': SolveCancelled('x'), 'alpha_map': AmbushPlannerError('y')}, DiagnosticStatus.ERROR,
     'CANCELLED'),
])
def test_the_level_is_that_of_the_worst(errors, level, code):
    status = Status(problems={concern: Problem.of(error) for concern, error in errors.items()})
    (reported,) = status_to_ros(status, 'name', pose(0, 0).header.stamp).status
    assert reported.level == level
    assert {each.key: each.value for each in reported.values}['code'] == code


def test_clear_routes_that_exceed_the_length_budget_are_a_warning():
    assessment = Assessment(2.0, 1.0, 0.5, expected_length=150.0, length_budget=120.0)
    status = Status(assessment=assessment, stale='the map has changed')
    (reported,) = status_to_ros(status, 'name', pose(0, 0).header.stamp).status
    assert reported.level == DiagnosticStatus.WARN
    assert all(word in reported.message for word in ('the map has changed', '150 m', '120 m'))
    assert {each.key: each.value for each in reported.values}['current_length'] == '150'


@pytest.mark.parametrize('worth, warned', [(0.9996, True), (0.54, False)])
def test_a_departure_that_is_worth_more_than_its_plan_is_a_warning(worth, warned):
    plan = SimpleNamespace(value=0.504)
    last = SimpleNamespace(number=1, id='x', assessment=Assessment(worth, 0.5, 1.0, 10.0),
                           tight_turns=0, held=SimpleNamespace(plan=plan),
                           trip=SimpleNamespace(parameters=SimpleNamespace(
                               planning=SimpleNamespace(max_gap=0.1))))
    (reported,) = status_to_ros(Status(last=last), 'name', pose(0, 0).header.stamp).status
    assert (reported.level == DiagnosticStatus.WARN) is warned
    assert ('0.9996, its plan had 0.504' in reported.message) is warned


VOLATILE, BEST_EFFORT = (QoSProfile(depth=1, reliability=each) for each in (
    ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT))


@pytest.mark.parametrize('topic, kind, qos', [
    ('alpha_map', OccupancyGrid, VOLATILE), ('costmap', OccupancyGrid, VOLATILE),
    ('goal_pose', PoseStamped, BEST_EFFORT)])
def test_warns_of_what_does_not_arrive_as_long_as_it_is_published(topic, kind, qos):
    with stage(parameters={'map.costmap': topic == 'costmap'}) as running:
        client = running.client
        # Of its own and not spun, so that it can be destroyed at any time.
        other = Node('mapper', context=client.node.context)
        other.create_publisher(kind, topic, qos)

        def message():
            return client.diagnostics(state='waiting')['message']

        words = f'/mapper publishes /{topic}, from where nothing arrives'
        wait_until(lambda: words in message(), 'a warning')
        assert client.diagnostics(state='waiting')['level'] == b'\1'
        other.destroy_node()
        wait_until(lambda: 'mapper' not in message(), 'no warning')


def test_a_missing_highspy_is_said_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(planner_node, 'HAS_HIGHSPY', False)
    with stderr_in(tmp_path / 'log') as said, stage() as running:
        assert 'highspy' not in running.client.diagnostics(state='waiting')['message']
    assert said().count('pip install highspy') == 1 and '[INFO]' in said()
