"""The bytes of a path are those of the message that rclpy would serialise."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import Header

from ambush_planner.ros.departure_path import path_between

START = Pose(position=Point(x=0.1, y=0.2, z=0.3), orientation=Quaternion(z=0.6, w=0.8))
GOAL = Pose(position=Point(x=7.0, y=8.0, z=-1.5), orientation=Quaternion(x=0.6, w=-0.8))


def path_along(count, frame='map'):
    """A path along a route of some nodes that ends at the goal."""
    points = np.cumsum(np.random.default_rng(count).normal(size=(count, 2)), axis=0)
    points[0], points[-1] = (0.1, 0.2), (7.0, 8.0)
    header = Header(frame_id=frame, stamp=Time(sec=7, nanosec=11))
    rows = np.column_stack((points, np.linspace(-3.0, 3.0, count)))
    return path_between(rows, START, GOAL, header)


@pytest.mark.parametrize('frame', ['', 'm', 'map', 'odom', 'base_link', 'größer als'])
@pytest.mark.parametrize('count', [2, 3, 50])
def test_bytes_are_the_message(count, frame):
    path = path_along(count, frame)
    message = path.to_message()
    assert len(message.poses) == len(path.rows)
    assert deserialize_message(path.to_bytes(), Path) == message


def test_a_step_that_is_one_segment_has_two_poses():
    rows = np.array([[0.1, 0.2, 0.5], [7.0, 8.0, 0.5]])
    path = path_between(rows, START, GOAL, Header(frame_id='map'))
    assert len(path.rows) == 2
    assert deserialize_message(path.to_bytes(), Path) == path.to_message()


def test_an_independent_reader_agrees():
    path = path_along(40)
    store = get_typestore(Stores.ROS2_JAZZY)
    read = store.deserialize_cdr(path.to_bytes(), 'nav_msgs/msg/Path')
    assert read.header.frame_id == 'map'
    rows = np.array([(p.pose.position.x, p.pose.position.y) for p in read.poses])
    np.testing.assert_array_equal(rows, path.rows[:, :2])
    assert read.poses[-1].pose.orientation.x == GOAL.orientation.x
    assert {p.header.stamp.nanosec for p in read.poses} == {11}


def test_a_goal_that_was_moved_keeps_its_orientation():
    rows = np.array([[0.1, 0.2, 0.5], [5.0, 6.0, 0.5]])
    last = path_between(rows, START, GOAL, Header(frame_id='map')).to_message().poses[-1]
    assert (last.pose.position.x, last.pose.position.y) == (5.0, 6.0)
    assert last.pose.position.z == GOAL.position.z
    assert last.pose.orientation == GOAL.orientation
    assert GOAL.position.x == 7.0, 'the goal as it was given stays as it is'
