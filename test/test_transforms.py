"""Poses in other frames: with real TF where it is installed, clear errors where it is not."""

import math
import threading
from contextlib import ExitStack, closing, contextmanager

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_harness import free_domain, header, pose, risk_grid, ros_context, spinning, stage
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from waiting import wait_until

from ambush_planner.ros import transforms
from ambush_planner.ros.conversions import path_from_ros, pose_from_ros
from ambush_planner.ros.errors import FrameMismatch, InvalidPose
from ambush_planner.ros.transforms import FrameTransforms

NOT_HERE = 'tf2_ros is not installed; it comes with ROS, not from PyPI'
HALF_TURN = (0.0, 0.0, math.pi)


@contextmanager
def node_in(domain, name, **arguments):
    with ros_context(domain) as context:
        node = Node(name, context=context, **arguments)
        with spinning(node, MultiThreadedExecutor(2, context=context)):
            yield node


@pytest.fixture
def node():
    with free_domain() as domain, node_in(domain, 'planner') as node:
        yield node


class Tf:
    """A node that listens to TF, and another one that tells it transforms."""

    def __init__(self, listener, sender):
        import tf2_ros

        self.listener, self.sender = listener, sender
        self.frames = FrameTransforms(listener)
        self.close = self.frames.close
        self._moving = tf2_ros.TransformBroadcaster(sender)
        self._static = tf2_ros.StaticTransformBroadcaster(sender)

    def send(self, *sent):
        """Tell moving transforms, once, and only when somebody listens."""
        wait_until(self._moving.pub_tf.get_subscription_count, 'a listener to /tf')
        self._moving.sendTransform(list(sent))

    def fix(self, *sent):
        self._static.sendTransform(list(sent))

    def position(self, given, frame='map'):
        """The transformed (x, y), or None as long as it is not known how the frames lie."""
        try:
            return pose_from_ros(self.frames.to_frame(given, 'goal', frame).pose)[:2]
        except FrameMismatch:
            return None

    def wait_for(self, given, wanted, frame='map'):
        """Wait until a pose is there."""

        def there():
            found = self.position(given, frame)
            return found is not None and np.allclose(found, wanted, rtol=0.0, atol=1e-9)

        wait_until(there, f'{given.header.frame_id} at {wanted} in {frame}')


@contextmanager
def running_tf(**arguments):
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        listener = stack.enter_context(node_in(domain, 'planner', **arguments))
        sender = stack.enter_context(node_in(domain, 'robot'))
        yield stack.enter_context(closing(Tf(listener, sender)))


@pytest.fixture
def tf():
    pytest.importorskip('tf2_ros', reason=NOT_HERE)
    with running_tf() as tf:
        yield tf


def transform(parent, child, x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0), sec=1):
    """A transform at time ``sec`` [s]; turn = (roll, pitch, yaw) [rad]."""
    result = TransformStamped(header=header(parent), child_frame_id=child)
    result.header.stamp = Time(sec=sec)
    result.transform.translation = Vector3(x=x, y=y, z=z)
    result.transform.rotation = quaternion(Rotation.from_euler('xyz', turn))
    return result


def quaternion(rotation):
    return Quaternion(**dict(zip('xyzw', rotation.as_quat().tolist(), strict=True)))


def place(given):
    p = given.pose.position
    return np.array((p.x, p.y, p.z))


def test_a_pose_in_the_frame_is_returned_as_it_is(node):
    given = pose(1.0, 2.0)
    with closing(FrameTransforms(node)) as frames:
        assert frames.to_frame(given, 'start', 'map') is given


def test_without_tf_another_frame_is_an_error_that_says_what_to_do(node, monkeypatch):
    monkeypatch.setattr(transforms, 'tf2_ros', None)
    with pytest.raises(FrameMismatch) as error:
        FrameTransforms(node).to_frame(pose(1.0, 2.0, frame='odom'), 'start', 'map')
    assert str(error.value) == (
        "start is given in the frame 'odom', the map in 'map'; give it in the map's frame, or "
        'install tf2_ros to have it transformed'
    )


@pytest.mark.parametrize('frame', ['map', ''])
def test_no_frame_is_an_error_even_where_the_other_has_none(node, frame):
    with closing(FrameTransforms(node)) as frames:
        with pytest.raises(FrameMismatch, match='goal .*header.frame_id is empty'):
            frames.to_frame(pose(1.0, 2.0, frame=''), 'goal', frame)


def test_a_pose_is_turned_and_moved(tf):
    tf.fix(transform('map', 'odom', 1.0, 2.0, turn=(0.0, 0.0, math.pi / 2)))
    given = pose(3.0, 4.0, 0.3, frame='odom')
    tf.wait_for(given, (-3.0, 5.0))
    result = tf.frames.to_frame(given, 'goal', 'map')
    assert result.header.frame_id == 'map'
    assert pose_from_ros(result.pose) == pytest.approx((-3.0, 5.0, 0.3 + math.pi / 2))
    assert given == pose(3.0, 4.0, 0.3, frame='odom')


def test_what_lies_ahead_of_a_pose_in_space_stays_ahead_of_it(tf):
    turn, ahead = Rotation.from_euler('xyz', (0.9, 0.2, -1.3)), np.array((2.0, -0.5, 1.0))
    there = pose(3.0, 4.0, frame='arm')
    there.pose.orientation = quaternion(turn)
    beyond = pose(0.0, 0.0, frame='arm')
    beyond.pose.position = Point(**dict(zip('xyz', place(there) + turn.apply(ahead), strict=True)))
    tf.fix(transform('map', 'arm', 1.0, -2.0, 3.0, turn=(0.4, -0.7, 2.1)))
    wait_until(lambda: tf.position(there), 'the transform')
    there, beyond = (tf.frames.to_frame(each, 'goal', 'map') for each in (there, beyond))
    q = there.pose.orientation
    seen = Rotation.from_quat((q.x, q.y, q.z, q.w)).inv().apply(place(beyond) - place(there))
    assert seen == pytest.approx(ahead)


def test_frames_are_followed_up_and_down_the_tree(tf):
    tf.fix(transform('map', 'odom', 10.0, turn=HALF_TURN), transform('map', 'depot', y=100.0))
    tf.send(transform('odom', 'base_link', 1.0, turn=HALF_TURN))
    given = pose(0.5, 0.25, frame='base_link')
    tf.wait_for(given, (9.5, 0.25))
    tf.wait_for(given, (9.5, -99.75), frame='depot')


def test_the_latest_transform_counts_whatever_the_stamps(tf):
    tf.send(*(transform('map', 'base_link', float(sec), sec=sec) for sec in (4, 5, 3)))
    tf.wait_for(pose(0.0, 0.0, frame='base_link'), (5.0, 0.0))
    for sec in (0, 1, 3, 4, 2_000_000_000):
        given = pose(0.5, 0.0, frame='base_link')
        given.header.stamp = Time(sec=sec)
        result = tf.frames.to_frame(given, 'start', 'map')
        assert pose_from_ros(result.pose)[0] == pytest.approx(5.5)
        assert result.header.stamp == Time(sec=5)


def test_an_unknown_frame_is_an_error_with_the_reason(tf):
    tf.fix(transform('map', 'odom'))
    tf.wait_for(pose(1.0, 2.0, frame='odom'), (1.0, 2.0))
    with pytest.raises(FrameMismatch) as error:
        tf.frames.to_frame(pose(1.0, 2.0, frame='base_link'), 'start', 'map')
    assert str(error.value).startswith(
        "start is given in the frame 'base_link', the map in 'map'; give it in the map's frame, "
        'or publish the transform between the two on /tf: '
    )
    assert 'does not exist' in str(error.value)


@pytest.mark.parametrize('number', [math.nan, math.inf, 0.0, 2.0])
def test_an_orientation_that_is_none_stays_an_error(tf, number):
    tf.fix(transform('map', 'odom', turn=HALF_TURN))
    given = pose(1.0, 2.0, frame='odom')
    wait_until(lambda: tf.position(given), 'the transform')
    given.pose.orientation.w = number
    with pytest.raises(InvalidPose, match='goal: orientation'):
        tf.frames.to_frame(given, 'goal', 'map')


def test_transforms_arrive_while_a_callback_runs(tf):
    begun, done = threading.Event(), threading.Event()

    def hold():
        begun.set()
        done.wait()

    timer = tf.listener.create_timer(0.001, hold)
    wait_until(begun.is_set, 'the callback')
    try:
        tf.send(transform('map', 'odom', 3.0))
        tf.wait_for(pose(1.0, 0.0, frame='odom'), (4.0, 0.0))
    finally:
        timer.cancel()
        done.set()


def tf_threads():
    return [thread for thread in threading.enumerate() if thread.name == '_planner_tf']


def test_nothing_is_left_after_the_end(tf):
    assert len(tf_threads()) == 1
    tf.close()
    assert not tf_threads()


def test_listening_ends_with_the_context():
    pytest.importorskip('tf2_ros', reason=NOT_HERE)
    with free_domain() as domain, node_in(domain, 'planner') as node:
        frames = FrameTransforms(node)
    with closing(frames):
        wait_until(lambda: not tf_threads(), 'the end of the thread')


def test_the_listener_is_remapped_like_the_node_but_keeps_its_name():
    pytest.importorskip('tf2_ros', reason=NOT_HERE)
    arguments = ['--ros-args', '-r', '__node:=convoy', '-r', '__ns:=/lead', '-r', '/tf:=tf']
    context = Context()
    with free_domain() as domain:
        rclpy.init(args=arguments, context=context, domain_id=domain)
        node = Node('planner', context=context)
        with closing(FrameTransforms(node)):
            wait_until(lambda: node.count_subscribers('/lead/tf'), 'the remapped subscription')
            names = node.get_node_names()
            assert names.count('convoy') == names.count('_convoy_tf') == 1
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_broken_transforms_end_nothing(tf):
    broken = [
        transform('map', 'odom', math.nan),
        transform('map', 'map'),
        transform('', 'odom'),
        transform('map', ''),
        TransformStamped(header=header('map'), child_frame_id='odom'),
    ]
    broken[-1].transform.rotation.w = 0.0
    tf.send(*broken, transform('map', 'odom', 3.0))
    tf.wait_for(pose(1.0, 0.0, frame='odom'), (4.0, 0.0))


def test_a_simulation_that_starts_anew_forgets_the_old_one():
    pytest.importorskip('tf2_ros', reason=NOT_HERE)
    with running_tf(parameter_overrides=[Parameter('use_sim_time', value=True)]) as tf:
        clock = tf.sender.create_publisher(Clock, '/clock', 1)
        for sec, x in ((1000, 7.0), (1, 3.0)):
            def time_is(sec=sec):
                clock.publish(Clock(clock=Time(sec=sec)))
                return tf.listener.get_clock().now().nanoseconds == sec * 10**9

            wait_until(time_is, f'{sec} s')
            tf.send(transform('map', 'base_link', x, sec=sec))
            tf.wait_for(pose(0.0, 0.0, frame='base_link'), (x, 0.0))


def test_a_departure_starts_where_the_robot_is_now():
    tf2_ros = pytest.importorskip('tf2_ros', reason=NOT_HERE)
    with stage() as running:
        client = running.client
        robot = tf2_ros.TransformBroadcaster(client.node)
        wait_until(robot.pub_tf.get_subscription_count, 'a listener to /tf')
        client.publish('alpha_map', risk_grid())
        client.publish('start_pose', pose(0.0, 0.0, frame='base_link'))
        client.publish('goal_pose', pose(8.5, 5.5))
        client.diagnostics(state='ready')
        assert 'base_link' in client.call('new_route').message

        def departs_at(x):
            client.call('new_route')
            paths = client.received['path']
            return paths and path_from_ros(paths[-1])[0, :2] == pytest.approx((x, 5.5))

        for x in (1.5, 2.5):
            robot.sendTransform(transform('map', 'base_link', x, 5.5, sec=int(x)))
            wait_until(lambda x=x: departs_at(x), f'a departure at {x}')
