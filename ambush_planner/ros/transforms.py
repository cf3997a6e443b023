# SPDX-License-Identifier: Apache-2.0
"""Transform poses into another frame, by what /tf and /tf_static publish."""

from __future__ import annotations

from functools import partial
from typing import Any

from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from ..maps.ros_messages import position_from_ros
from ..maps.tf_buffer import (
    Found,
    StampedTransform,
    TransformBuffer,
    TransformUnknown,
    rigid_motion,
)
from .conversions import installed_type
from .errors import FrameMismatch
from .listener import Listener
from .topics import TF, TF_STATIC


class FrameTransforms:
    """Transforms poses between frames; without ``tf2_msgs``, only within a frame.

    ``to_frame`` may be called from any thread. Call ``close`` before destroying the node.
    """

    def __init__(self, node: Node, listener: Listener) -> None:
        self._clock, self._buffer = node.get_clock(), TransformBuffer()
        # After a jump back, of a simulation, a bag or by a little, old ones would stay the newest.
        self._jumps = self._clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1),
                          on_clock_change=True),
            post_callback=lambda _: self._buffer.clear(),
        )
        self._message = installed_type('tf2_msgs.msg', 'TFMessage')
        if self._message is not None:
            for topic, qos, static in (('/tf', TF, False), ('/tf_static', TF_STATIC, True)):
                listener.subscribe(self._message, topic, qos, partial(self._read, static))

    def close(self) -> None:
        """Take no more notice of the clock."""
        self._jumps.unregister()

    def moves(self, frame: str, other: str) -> bool:
        """Return whether a frame moves in another one: what is given in it is no fixed place."""
        try:
            return self._buffer.lookup(other, frame).newest_ns is not None
        except TransformUnknown:
            return False

    def to_frame(self, pose: PoseStamped, name: str, frame: str, max_age: float) -> PoseStamped:
        """Return the pose called ``name`` in ``frame``; unchanged if that is its frame.

        The newest transforms are used, whatever the pose's stamp: a pose in ``base_link`` is where
        the robot is now. Those stamped more than ``max_age`` [s] ahead of now are used for nothing
        that others are known for. The result has the oldest stamp of these, or none if all are
        static. Never waits for a transform.

        Raises FrameMismatch if the pose has no frame, or no transform to ``frame`` is known, or it
        is older than ``max_age`` or all known ones are stamped further ahead of now, and
        InvalidPose if a pose to transform is not a valid one.
        """
        given = pose.header.frame_id
        if given and given == frame:
            return pose
        shown = given[:80]
        problem = (f"{name} is given in the frame {shown!r}, the map in {frame!r}; give it in the "
                   "map's frame")
        if not given:
            raise FrameMismatch(f'{problem}: its header.frame_id is empty')
        if self._message is None:
            raise FrameMismatch(f'{problem}, or install tf2_msgs to have it transformed')
        # Checked before the rotation, which would normalise an invalid orientation.
        position_from_ros(pose, name)
        now = self._clock.now().nanoseconds
        try:
            found = self._buffer.lookup(frame, given, now + max_age * 1e9)
        except TransformUnknown as error:
            raise FrameMismatch(
                f'{problem}, or publish the transform between the two on /tf: {error}'
            ) from error
        age, ahead = (0.0 if stamp is None else sign * (now - stamp) / 1e9
                      for sign, stamp in ((1, found.stamp_ns), (-1, found.newest_ns)))
        if max(age, ahead) <= max_age:  # localisation post-dates map -> odom by about a second
            return _transformed(pose, found, frame)
        fault = f'{age:.3g} s old' if age > max_age else f'stamped {ahead:.3g} s ahead of now'
        raise FrameMismatch(
            f'{name}: the transform from {shown!r} to {frame!r} is {fault}, more than '
            f'transform.max_age, {max_age:g} s; check that /tf is still published, with stamps of '
            "this node's clock"
        )

    def receive(self, static: bool, message: Any) -> None:
        """Take the transforms of a tf2_msgs/TFMessage."""
        for each in message.transforms:
            p, q = each.transform.translation, each.transform.rotation
            stamp = each.header.stamp
            stamp_ns = None if static else stamp.sec * 1_000_000_000 + stamp.nanosec
            self._buffer.add(StampedTransform(each.header.frame_id, each.child_frame_id, stamp_ns,
                                              (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))

    def _read(self, static: bool, data: bytes, _: dict[str, int]) -> None:
        self.receive(static, deserialize_message(data, self._message))


def _transformed(pose: PoseStamped, found: Found, frame: str) -> PoseStamped:
    p, q = pose.pose.position, pose.pose.orientation
    moved = found.matrix @ rigid_motion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    x, y, z = moved[:3, 3].tolist()
    qx, qy, qz, qw = Rotation.from_matrix(moved[:3, :3]).as_quat().tolist()
    stamp = Time(nanoseconds=max(found.stamp_ns or 0, 0)).to_msg()  # rclpy has none before 1970
    return PoseStamped(
        header=Header(frame_id=frame, stamp=stamp),
        pose=Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
    )
