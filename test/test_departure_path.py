"""The path of a departure as a message: its poses, and its exact ends."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from ambush_planner.ros.cdr import path_bytes
from ambush_planner.ros.conversions import path_to_ros, pose_to_ros, stamped_poses

START = Pose(position=Point(x=0.1, y=0.2, z=0.3), orientation=Quaternion(z=0.6, w=0.8))
GOAL = Pose(position=Point(x=7.0, y=8.0, z=-1.5), orientation=Quaternion(x=0.6, w=-0.8))


@pytest.mark.parametrize('frame', ['', 'm', 'map', 'größer als'])
def test_bytes_are_the_message(frame):
    rows = np.random.default_rng(1).normal(size=(7, 3))
    message = path_to_ros(rows, START, GOAL, Header(frame_id=frame, stamp=Time(sec=7, nanosec=11)))
    assert deserialize_message(path_bytes(message), Path) == message


def test_poses_are_those_of_the_constructors():
    rows, header = np.random.default_rng(50).normal(size=(50, 3)), Header(frame_id='map')
    fast = stamped_poses(rows, header)
    assert fast == [PoseStamped(header=header, pose=pose_to_ros(*row)) for row in rows.tolist()]
    fast[0].pose.position.x = 9.0
    assert fast[1].pose.position.x != 9.0


def test_a_moved_goal_keeps_its_orientation():
    rows = np.array([[0.1, 0.2, 0.5], [5.0, 6.0, 0.5]])
    first, last = path_to_ros(rows, START, GOAL, Header(frame_id='map')).poses
    assert first.pose == START
    assert (last.pose.position.x, last.pose.position.y) == (5.0, 6.0)
    assert last.pose.position.z == GOAL.position.z
    assert last.pose.orientation == GOAL.orientation
    assert GOAL.position.x == 7.0, 'the given goal is not modified'
