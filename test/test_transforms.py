# SPDX-License-Identifier: Apache-2.0
"""Poses in other frames: transforms that travel over DDS, and clear errors without them."""

import math
from contextlib import ExitStack, closing, contextmanager, nullcontext

import interfaces
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from robots import ROBOT, Robot, transform
from ros_harness import free_domain, pose, recorded, risk_grid, ros_context, spinning, stage
from rosgraph_msgs.msg import Clock
from waiting import wait_until

from ambush_planner.errors import InvalidPose
from ambush_planner.maps.ros_messages import path_from_ros, pose_from_ros
from ambush_planner.recordings.verify import Verifier
from ambush_planner.ros.error_codes import FrameMismatch
from ambush_planner.ros.topics import TF, TF_STATIC
from ambush_planner.ros.transforms import FrameTransforms
from ambush_planner.worker.process import WorkerProcess

interfaces.install('tf2_msgs')
from tf2_msgs.msg import TFMessage  # noqa: E402


@contextmanager
def node_in(domain, name, **arguments):
    with ros_context(domain) as context:
        node = Node(name, context=context, **arguments)
        with spinning(node, MultiThreadedExecutor(2, context=context)):
            yield node


class Tf:
    """A node that listens to TF, and another one that publishes it."""

    def __init__(self, listener, sender):
        self.listener, self.sender = listener, sender
        self.frames = FrameTransforms(listener)
        self.close = self.frames.close
        self.moving = sender.create_publisher(TFMessage, '/tf', TF)
        self._static = sender.create_publisher(TFMessage, '/tf_static', TF_STATIC)

    def send(self, *sent):
        """Publish moving transforms, once, as soon as somebody listens."""
        wait_until(self.moving.get_subscription_count, 'a listener to /tf')
        self.moving.publish(TFMessage(transforms=sent))

    def fix(self, *sent):
        self._static.publish(TFMessage(transforms=sent))

    def position(self, given, frame='map'):
        """The transformed (x, y), or None before the transform is known."""
        try:
            return pose_from_ros(self.frames.to_frame(given, 'goal', frame, math.inf).pose)[:2]
        except FrameMismatch:
            return None

    def wait_for(self, given, wanted, frame='map'):
        """Wait until the transformed position is as wanted."""

        def is_there():
            found = self.position(given, frame)
            return found is not None and np.allclose(found, wanted, rtol=0.0, atol=1e-9)

        wait_until(is_there, f'{given.header.frame_id} at {wanted} in {frame}')


@contextmanager
def running_tf(**arguments):
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        listener = stack.enter_context(node_in(domain, 'planner', **arguments))
        sender = stack.enter_context(node_in(domain, 'robot'))
        yield stack.enter_context(closing(Tf(listener, sender)))


@pytest.fixture(scope='module')
def tf():
    with running_tf() as tf:
        yield tf


def test_unknown_frames_and_invalid_orientations_are_errors(tf):
    given = pose(1.0, 2.0)
    assert tf.frames.to_frame(given, 'start', 'map', math.inf) is given
    for frame, words in (('', 'goal .*header.frame_id is empty'), ('moon', 'does not exist')):
        with pytest.raises(FrameMismatch, match=words):
            tf.frames.to_frame(pose(1.0, 2.0, frame=frame), 'goal', 'map', math.inf)
    tf.fix(transform('map', 'odom'))
    given = pose(1.0, 2.0, frame='odom')
    tf.wait_for(given, (1.0, 2.0))
    for number in (math.nan, 2.0):
        given.pose.orientation.w = number
        with pytest.raises(InvalidPose, match='goal: orientation'):
            tf.frames.to_frame(given, 'goal', 'map', math.inf)


def test_invalid_transforms_and_unreadable_bytes_are_survived(tf):
    wait_until(tf.moving.get_subscription_count, 'a listener to /tf')
    for data in (b'', b'\0\1\0\0\5\0\0\0', b'\0\7\0\0' + bytes(40)):
        tf.moving.publish(data)
    tf.send(transform('map', 'cart', math.nan), transform('map', 'cart', 3.0))
    tf.wait_for(pose(1.0, 0.0, frame='cart'), (4.0, 0.0))


def test_a_simulation_that_restarts_clears_the_buffer():
    with running_tf(parameter_overrides=[Parameter('use_sim_time', value=True)]) as tf:
        clock = tf.sender.create_publisher(Clock, '/clock', 1)
        for sec, x in ((1000, 7.0), (1, 3.0)):
            def time_is(sec=sec):
                clock.publish(Clock(clock=Time(sec=sec)))
                return tf.listener.get_clock().now().nanoseconds == sec * 10**9

            wait_until(time_is, f'{sec} s')
            tf.send(transform('map', 'base_link', x, sec=sec))
            tf.wait_for(pose(0.0, 0.0, frame='base_link'), (x, 0.0))


def test_a_moving_transform_far_from_now_is_an_error_with_its_age(tf):
    """Localisation post-dates map -> odom by about a second, which is fine."""
    now = tf.listener.get_clock().now().nanoseconds // 10**9
    for frame, ahead, words in (('late', -100, r'is 10\d s old, more than transform.max_age, 2 s'),
                                ('right', 2, ''),
                                ('early', 100, r'stamped (100|9\d\.?\d?) s ahead of now'),
                                ('camera', 0, r'stamped (100|9\d\.?\d?) s ahead of now')):
        given, parent = pose(0.0, 0.0, frame=frame), 'early' if frame == 'camera' else 'map'
        tf.send(transform(parent, frame, 3.0, sec=now + ahead))
        tf.wait_for(given, (6.0 if frame == 'camera' else 3.0, 0.0))
        with pytest.raises(FrameMismatch, match=words) if words else nullcontext():
            tf.frames.to_frame(given, 'start', 'map', 2.0)
    tf.fix(transform('map', 'depot', 1.0, sec=1))
    tf.wait_for(pose(0.0, 0.0, frame='depot'), (1.0, 0.0))
    tf.frames.to_frame(pose(0.0, 0.0, frame='depot'), 'start', 'map', 2.0)
    # One that is right counts at once, whatever came before.
    tf.send(transform('map', 'early', 5.0, sec=now + 1))
    wait_until(lambda: _x(tf, 'early') == 5.0, 'the right transform')


def _x(tf, frame):
    try:
        return tf.frames.to_frame(pose(0.0, 0.0, frame=frame), 'start', 'map', 60.0).pose.position.x
    except FrameMismatch:
        return None


def test_a_departure_starts_where_the_robot_is_now():
    with stage(parameters=ROBOT) as running:
        client = running.client
        robot = Robot(running)
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
        path = client.get_plan(pose(0.0, 0.0, frame=''), pose(8.5, 5.5))
        assert path_from_ros(path)[0, :2] == pytest.approx((3.5, 5.5))


def test_a_robot_that_drives_during_the_solve_departs_where_it_is_then(tmp_path, monkeypatch):
    """On the plan or within its region, after one solve; further away it takes another one."""
    solves, solve = [], WorkerProcess.solve
    places = [(1.6, 5.5), (3.2, 2.9), (1.5, 0.6), (1.5, 0.6)]
    asked_at = [(1.5, 5.5), (1.5, 2.5), (8.5, 8.5)]
    with stage(tmp_path, parameters=ROBOT) as running:
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
