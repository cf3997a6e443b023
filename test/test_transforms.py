"""Poses in other frames: transforms that travel over DDS, and clear errors where there are none."""

import math
import threading
from contextlib import ExitStack, closing, contextmanager

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from nav_msgs.srv import GetPlan
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros_harness import free_domain, header, pose, risk_grid, ros_context, spinning, stage
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from standin_types import message_type, tf_message
from waiting import stderr_in, wait_until

from ambush_planner.errors import InvalidPose
from ambush_planner.maps.ros_messages import path_from_ros, pose_from_ros
from ambush_planner.ros import transforms
from ambush_planner.ros.error_codes import FrameMismatch
from ambush_planner.ros.qos import TF, TF_STATIC
from ambush_planner.ros.tf_buffer import TransformBuffer
from ambush_planner.ros.transforms import FrameTransforms
from ambush_planner.worker.process import WorkerProcess

TF_MESSAGE = message_type('tf2_msgs', 'TFMessage')
HALF_TURN = (0.0, 0.0, math.pi)


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """TF's message, as a stand-in where it is not installed."""
    monkeypatch.setattr(transforms, 'TFMessage', TF_MESSAGE)


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
        self.listener, self.sender = listener, sender
        self.frames = FrameTransforms(listener)
        self.close = self.frames.close
        self.moving = sender.create_publisher(TF_MESSAGE, '/tf', TF)
        self._static = sender.create_publisher(TF_MESSAGE, '/tf_static', TF_STATIC)

    def send(self, *sent):
        """Tell moving transforms, once, and only when somebody listens."""
        wait_until(self.moving.get_subscription_count, 'a listener to /tf')
        self.moving.publish(tf_message(*sent))

    def fix(self, *sent):
        self._static.publish(tf_message(*sent))

    def position(self, given, frame='map'):
        """The transformed (x, y), or None as long as it is not known how the frames lie."""
        try:
            return pose_from_ros(self.frames.to_frame(given, 'goal', frame, math.inf).pose)[:2]
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
        assert frames.to_frame(given, 'start', 'map', math.inf) is given


def test_without_tf_another_frame_is_an_error_that_says_what_to_do(node, monkeypatch):
    monkeypatch.setattr(transforms, 'TFMessage', None)
    with pytest.raises(FrameMismatch) as error:
        FrameTransforms(node).to_frame(pose(1.0, 2.0, frame='odom'), 'start', 'map', math.inf)
    assert str(error.value) == (
        "start is given in the frame 'odom', the map in 'map'; give it in the map's frame, or "
        'install tf2_msgs to have it transformed'
    )


@pytest.mark.parametrize('frame', ['map', ''])
def test_no_frame_is_an_error_even_where_the_other_has_none(node, frame):
    with closing(FrameTransforms(node)) as frames:
        with pytest.raises(FrameMismatch, match='goal .*header.frame_id is empty'):
            frames.to_frame(pose(1.0, 2.0, frame=''), 'goal', frame, math.inf)


def test_a_pose_is_turned_and_moved(tf):
    tf.fix(transform('map', 'odom', 1.0, 2.0, turn=(0.0, 0.0, math.pi / 2)))
    given = pose(3.0, 4.0, 0.3, frame='odom')
    tf.wait_for(given, (-3.0, 5.0))
    result = tf.frames.to_frame(given, 'goal', 'map', math.inf)
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
    there, beyond = (tf.frames.to_frame(each, 'goal', 'map', math.inf) for each in (there, beyond))
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
        result = tf.frames.to_frame(given, 'start', 'map', math.inf)
        assert pose_from_ros(result.pose)[0] == pytest.approx(5.5)
        assert result.header.stamp == Time(sec=5)


def test_an_unknown_frame_is_an_error_with_the_reason(tf):
    tf.fix(transform('map', 'odom'))
    tf.wait_for(pose(1.0, 2.0, frame='odom'), (1.0, 2.0))
    with pytest.raises(FrameMismatch) as error:
        tf.frames.to_frame(pose(1.0, 2.0, frame='base_link'), 'start', 'map', math.inf)
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
        tf.frames.to_frame(given, 'goal', 'map', math.inf)


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
    with free_domain() as domain, node_in(domain, 'planner') as node:
        frames = FrameTransforms(node)
    with closing(frames):
        wait_until(lambda: not tf_threads(), 'the end of the thread')


def test_the_listener_is_remapped_like_the_node_but_keeps_its_name():
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
    with running_tf(parameter_overrides=[Parameter('use_sim_time', value=True)]) as tf:
        clock = tf.sender.create_publisher(Clock, '/clock', 1)
        for sec, x in ((1000, 7.0), (1, 3.0)):
            def time_is(sec=sec):
                clock.publish(Clock(clock=Time(sec=sec)))
                return tf.listener.get_clock().now().nanoseconds == sec * 10**9

            wait_until(time_is, f'{sec} s')
            tf.send(transform('map', 'base_link', x, sec=sec))
            tf.wait_for(pose(0.0, 0.0, frame='base_link'), (x, 0.0))


def test_a_transform_that_is_too_old_is_an_error_with_its_age(tf):
    now = tf.listener.get_clock().now().nanoseconds // 10**9
    tf.send(transform('map', 'base_link', 3.0, sec=now - 100))
    given = pose(0.0, 0.0, frame='base_link')
    tf.wait_for(given, (3.0, 0.0))
    with pytest.raises(FrameMismatch, match=r'is 10\d s old, more than transform.max_age, 2 s'):
        tf.frames.to_frame(given, 'start', 'map', 2.0)
    tf.fix(transform('map', 'depot', 1.0, sec=1))
    tf.wait_for(pose(0.0, 0.0, frame='depot'), (1.0, 0.0))
    tf.frames.to_frame(pose(0.0, 0.0, frame='depot'), 'start', 'map', 2.0)


@pytest.mark.parametrize('data', [
    b'', b'\0\1\0\0', b'\0\1\0\0\5\0\0\0', b'\0\7\0\0' + bytes(40),
    tf_message(transform('map', 'odom', 1.0))[:-9],
    tf_message(transform('map', 'odom', 1.0)).replace(b'odom', b'\xff\xfe\xfd\xfc'),
])
def test_bytes_that_are_no_transforms_end_nothing(tf, data):
    wait_until(tf.moving.get_subscription_count, 'a listener to /tf')
    tf.moving.publish(data)
    tf.send(transform('map', 'odom', 3.0))
    tf.wait_for(pose(1.0, 0.0, frame='odom'), (4.0, 0.0))


def test_an_error_in_the_listener_is_told_and_survived(tf, monkeypatch, tmp_path):
    def broken(*_):
        raise RuntimeError(f'went through {math.pi}')

    with monkeypatch.context() as patch, stderr_in(tmp_path / 'log') as said:
        patch.setattr(TransformBuffer, 'add', broken)
        tf.send(transform('map', 'odom', 1.0))
        wait_until(lambda: 'in broken' in said(), 'the log')
        assert '3.14159' not in said()
    tf.send(transform('map', 'odom', 3.0, sec=2))
    tf.wait_for(pose(1.0, 0.0, frame='odom'), (4.0, 0.0))


def test_remaps_that_are_the_nodes_own_are_honoured():
    arguments = ['--ros-args', '-r', '/tf:=robot_tf', '-r', '/tf_static:=robot_tf_static']
    with free_domain() as domain, node_in(domain, 'planner', cli_args=arguments) as node:
        with closing(FrameTransforms(node)):
            for topic in ('/robot_tf', '/robot_tf_static'):
                wait_until(lambda topic=topic: node.count_subscribers(topic), topic)
            assert not node.count_subscribers('/tf')


class Robot:
    """Tells where base_link is on the map, with the time of now."""

    def __init__(self, node):
        self._node = node
        self._moving = node.create_publisher(TF_MESSAGE, '/tf', TF)
        wait_until(self._moving.get_subscription_count, 'a listener to /tf')

    def is_at(self, x, y):
        there = transform('map', 'base_link', x, y)
        there.header.stamp = self._node.get_clock().now().to_msg()
        self._moving.publish(tf_message(there))


ROBOT = {'robot_base_frame': 'base_link', 'transform.max_age': 1000.0}


def first_pose(client, count):
    return path_from_ros(client.last('path', count))[0, :2]


@pytest.mark.parametrize('start', [None, 'base_link', ''], ids=['none', 'in its frame', 'empty'])
def test_a_departure_starts_where_the_robot_is_now(start):
    with stage(parameters=ROBOT) as running:
        client = running.client
        robot = Robot(client.node)
        client.publish('alpha_map', risk_grid())
        if start is not None:
            client.publish('start_pose', pose(0.0, 0.0, frame=start))
        client.publish('goal_pose', pose(8.5, 5.5))
        client.diagnostics(state='ready', level=b'\0')
        assert 'base_link' in client.call('new_route').message

        def departs_at(x):
            client.call('new_route')
            paths = client.received['path']
            return paths and path_from_ros(paths[-1])[0, :2] == pytest.approx((x, 5.5))

        for x in (1.5, 2.5):
            robot.is_at(x, 5.5)
            wait_until(lambda x=x: departs_at(x), f'a departure at {x}')
        request = GetPlan.Request(start=pose(0.0, 0.0, frame=''), goal=pose(8.5, 5.5))
        path = client.call('get_plan', request).plan
        assert path_from_ros(path)[0, :2] == pytest.approx((2.5, 5.5))


def test_a_robot_that_drives_while_it_is_solved_departs_where_it_is_then(monkeypatch):
    """Within the tolerance the path begins there; beyond it, it is solved once more."""
    solves, solve = [], WorkerProcess.solve
    with stage(parameters=ROBOT) as running:
        client = running.client
        robot = Robot(client.node)

        def drive(worker, request):
            plan = solve(worker, request)
            solves.append(request.start_xy)
            robot.is_at(*places[len(solves) - 1])
            there = pose(0.0, 0.0, frame='base_link')
            wait_until(lambda: place(running.planner._transforms.to_frame(
                there, 'start', 'map', math.inf))[:2].tolist() == list(places[len(solves) - 1]),
                'its move')
            return plan

        monkeypatch.setattr(WorkerProcess, 'solve', drive)
        client.publish('alpha_map', risk_grid(np.zeros((20, 20))))
        client.publish('goal_pose', pose(8.5, 5.5))
        robot.is_at(1.5, 5.5)
        places = [(1.6, 5.5)]
        client.call_until('new_route', lambda answer: answer.success)
        assert first_pose(client, 1) == pytest.approx((1.6, 5.5))
        assert len(solves) == 1
        solves.clear()
        places = [(5.0, 2.5), (5.0, 2.6)]
        robot.is_at(1.5, 2.5)
        client.call_until('new_route', lambda _: solves and client.last('path', 2))
        assert first_pose(client, 2) == pytest.approx((5.0, 2.6))
        assert [start[0] for start in solves] == [1.5, 5.0]


def test_a_robot_whose_transform_is_old_does_not_depart():
    with stage(parameters={**ROBOT, 'transform.max_age': 2.0}) as running:
        client = running.client
        robot = client.node.create_publisher(TF_MESSAGE, '/tf', TF)
        wait_until(robot.get_subscription_count, 'a listener to /tf')
        client.publish('alpha_map', risk_grid())
        client.publish('goal_pose', pose(8.5, 5.5))
        client.diagnostics(state='ready')
        robot.publish(tf_message(transform('map', 'base_link', 1.5, 5.5)))
        answer = client.call_until('new_route', lambda answer: 's old' in answer.message)
        assert not answer.success
        client.diagnostics(code='TF_ERROR')
