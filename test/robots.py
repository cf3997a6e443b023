# SPDX-License-Identifier: Apache-2.0
"""A robot that is known by TF."""

import math

import interfaces
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from ros_harness import header, wait_until
from scipy.spatial.transform import Rotation

from ambush_planner.ros.topics import TF

interfaces.install('tf2_msgs')
from tf2_msgs.msg import TFMessage  # noqa: E402

ROBOT = {'robot_base_frame': 'base_link', 'transform.max_age': 1000.0}


def transform(parent, child, x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0), sec=1):
    """A transform at time ``sec`` [s]; turn = (roll, pitch, yaw) [rad]."""
    result = TransformStamped(header=header(parent), child_frame_id=child)
    result.header.stamp = Time(sec=sec)
    result.transform.translation = Vector3(x=x, y=y, z=z)
    result.transform.rotation = quaternion(Rotation.from_euler('xyz', turn))
    return result


def quaternion(rotation):
    return Quaternion(**dict(zip('xyzw', rotation.as_quat().tolist(), strict=True)))


class Robot:
    """Publishes the pose of a robot's frame on the map."""

    def __init__(self, running, frame='base_link'):
        self._running, self._node, self._frame = running, running.client.node, frame
        self._moving = self._node.create_publisher(TFMessage, '/tf', TF)
        wait_until(self._moving.get_subscription_count, 'a listener to /tf')

    def moves_to(self, x, y, stamp=None):
        """Say where it is, by default now."""
        there = transform('map', self._frame, float(x), float(y))
        there.header.stamp = stamp or self._node.get_clock().now().to_msg()
        self._moving.publish(TFMessage(transforms=[there]))

    def is_at(self, x, y, stamp=None):
        """Be somewhere, and wait until the planner knows it."""
        self.moves_to(x, y, stamp)
        wait_until(lambda: self._known() == (float(x), float(y)), 'the move')

    def _known(self):
        """Where the node believes the robot to be, None if it does not know."""
        inputs = self._running.planner._dispatcher.inputs
        return inputs.robot_place(self._frame, 'map', math.inf)
