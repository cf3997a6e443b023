# SPDX-License-Identifier: Apache-2.0
"""Poses in other frames: transforms that travel over DDS, and clear errors without them."""

import math
import time
from contextlib import closing, nullcontext

import interfaces
import numpy as np
import pytest
from rclpy.node import Node
from robots import ROBOT, Robot, transform
from ros_harness import free_domain, pose, recorded, risk_grid, ros_context, stage
from waiting import wait_until

from ambush_planner.errors import InvalidPose
from ambush_planner.maps.ros_messages import path_from_ros, pose_from_ros
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros.errors import FrameMismatch
from ambush_planner.ros.listener import Listener
from ambush_planner.ros.topics import TF_STATIC
from ambush_planner.ros.transforms import FrameTransforms
from ambush_planner.worker.process import WorkerProcess

interfaces.install('tf2_msgs')
from tf2_msgs.msg import TFMessage  # noqa: E402


@pytest.fixture(scope='module')
def frames():
    with free_domain() as domain, ros_context(domain) as context:
        node = Node('planner', context=context)
        with (closing(Listener(node)) as listener,
              closing(FrameTransforms(node, listener)) as frames):
            yield frames
        node.destroy_node()


def x_of(frames, frame, max_age=2.0):
    """Where the origin of a frame is on the map."""
    given = pose(0.0, 0.0, frame=frame)
    return pose_from_ros(frames.to_frame(given, 'start', 'map', max_age).pose)[0]


def test_unknown_frames_and_invalid_orientations_are_errors(frames):
    given = pose(1.0, 2.0)
    assert frames.to_frame(given, 'start', 'map', math.inf) is given
    for frame, words in (('', 'goal .*header.frame_id is empty'), ('moon', 'does not exist')):
        with pytest.raises(FrameMismatch, match=words):
            frames.to_frame(pose(1.0, 2.0, frame=frame), 'goal', 'map', math.inf)
    frames.receive(True, TFMessage(transforms=[transform('map', 'odom')]))
    given = pose(1.0, 2.0, frame='odom')
    for number in (math.nan, 2.0):
        given.pose.orientation.w = number
        with pytest.raises(InvalidPose, match='goal: orientation'):
            frames.to_frame(given, 'goal', 'map', math.inf)


def test_a_moving_transform_far_from_now_is_an_error_with_its_age(frames):
    """Localisation post-dates map -> odom by about a second, which is fine."""
    now = time.time_ns() // 10**9
    for parent, frame, ahead, words in (
            ('map', 'late', -100, r'is 1\d\d s old, more than transform.max_age, 20 s'),
            ('map', 'right', 5, ''),
            ('map', 'early', 100, r'stamped (100|9\d\.?\d?) s ahead of now'),
            ('early', 'camera', 0, r'stamped (100|9\d\.?\d?) s ahead of now')):
        frames.receive(False, TFMessage(transforms=[
            transform(parent, frame, 3.0, sec=now + ahead)]))
        with pytest.raises(FrameMismatch, match=words) if words else nullcontext():
            x_of(frames, frame, 20.0)
    frames.receive(True, TFMessage(transforms=[transform('map', 'depot', 1.0, sec=1)]))
    assert x_of(frames, 'depot') == 1.0
    # One that is right counts at once, whatever came before.
    frames.receive(False, TFMessage(transforms=[transform('map', 'early', 5.0, sec=now + 1)]))
    assert x_of(frames, 'early', 60.0) == 5.0


def test_a_transform_from_before_1970_is_used_if_any_age_will_do(frames):
    frames.receive(False, TFMessage(transforms=[transform('map', 'old', 3.0, sec=-5)]))
    assert x_of(frames, 'old', math.inf) == 3.0


def test_a_place_in_a_frame_that_does_not_move_is_no_robot():
    """The same route each day would be published for it."""
    depot, answers = pose(0.5, 0.5, frame='depot'), []
    with stage(parameters={'transform.max_age': math.inf}) as running:
        client = running.give()
        fixed = client.node.create_publisher(TFMessage, '/tf_static', TF_STATIC)
        fixed.publish(TFMessage(transforms=[transform('map', 'depot', 1.0, 5.0)]))
        wait_until(lambda: client.get_plan(depot, pose(8.5, 5.5)).poses, 'the transform')
        for number in range(2, 5):
            answers.append(client.get_plan(depot, pose(8.5, 5.5)))
            client.diagnostics(departures=str(number), last_answer='new')
        robot = Robot(running)
        robot.is_at(1.5, 5.5)
        for answer in ('new', 'continued'):
            client.get_plan(pose(0.0, 0.0, frame='base_link'), pose(8.5, 5.5))
            client.diagnostics(departures='5', last_answer=answer)


def test_a_departure_starts_where_the_robot_is_now():
    with stage(parameters=ROBOT) as running:
        client = running.client
        robot = Robot(running)
        for data in (b'', b'\0\1\0\0\5\0\0\0', b'\0\7\0\0' + bytes(40)):
            client.publish('/tf', data, TFMessage)  # unreadable
        fixed = client.node.create_publisher(TFMessage, '/tf_static', TF_STATIC)
        fixed.publish(TFMessage(transforms=[transform('map', 'yard', 1.0)]))
        client.publish('alpha_map', risk_grid())
        client.publish('goal_pose', pose(8.5, 5.5))
        client.diagnostics(state='ready', level=b'\0')
        assert 'base_link' in client.call('new_route').message
        client.diagnostics(code='TF_ERROR')

        def departs_at(x):
            client.call('new_route')
            paths = client.received['path']
            return paths and path_from_ros(paths[-1])[0, :2] == pytest.approx((x, 5.5))

        for x, start in ((1.5, None), (2.5, 'base_link'), (3.5, '')):
            if start is not None:
                client.publish('start_pose', pose(0.0, 0.0, frame=start))
            robot.is_at(x, 5.5)
            wait_until(lambda x=x: departs_at(x), f'a departure at {x}')
        path = path_from_ros(client.get_plan(pose(0.0, 0.0, frame=''),
                                             pose(7.5, 5.5, frame='yard')))
        assert path[[0, -1], :2] == pytest.approx(np.array(((3.5, 5.5), (8.5, 5.5))))


def test_a_robot_that_drives_during_the_solve_departs_where_it_is_then(tmp_path, monkeypatch):
    """On the plan or within its region, after one solve; further away it takes another one."""
    solves, solve = [], WorkerProcess.solve
    places = [(1.6, 5.5), (2.5, 2.7), (1.5, 0.6), (1.5, 0.6)]
    asked_at = [(1.5, 5.5), (1.5, 2.5), (8.5, 8.5)]
    with stage(tmp_path, parameters={**ROBOT, 'strategy.max_gap': 1.0}) as running:
        client, robot = running.client, Robot(running)

        def drive(worker, request, *rest):
            plan = solve(worker, request, *rest)
            solves.append(request.start_xy)
            robot.is_at(*places[len(solves) - 1])
            return plan

        monkeypatch.setattr(WorkerProcess, 'solve', drive)
        client.publish('alpha_map', risk_grid(np.full((20, 20), 5)))
        for number, words in ((1, 'published on /path'),
                              (2, 'joins the routes of an earlier start: value'),
                              (3, 'published on /path')):
            robot.is_at(*asked_at[number - 1])
            client.publish('goal_pose', pose(8.5, 4.5 + number))
            # Earlier ones are for the last goal.
            answer = client.call_until('new_route', lambda _, number=number: len(solves) >= number)
            assert words in answer.message
            assert len(solves) == (number if number < 3 else 4)
            path = path_from_ros(client.received['path'][-1])
            assert path[0, :2] == pytest.approx(places[number - 1])
            report = client.diagnostics(departures=answer.message.split()[1])
            assert float(report['departure_value']) >= float(report['departure_gap']) >= 0.0
        files = recorded(tmp_path, int(report['departures']))
    assert not any(Verifier().verify(file).problems for file in files)
