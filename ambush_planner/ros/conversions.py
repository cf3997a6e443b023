# SPDX-License-Identifier: Apache-2.0
"""Convert arrays to ROS messages, whole arrays at a time; ``maps/ros_messages.py`` reads them.

Every number is cast before it is assigned: rclpy copies the memory of other types unconverted.
"""

from __future__ import annotations

import array
import math
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from std_msgs.msg import Header

from ..arrays import FloatArray
from ..recordings import cdr
from .errors import Refusal


def pose_to_ros(x: float, y: float, yaw: float = 0.0) -> Pose:
    """Return the pose at (x, y) [m] with heading yaw [rad]."""
    pose, half = Pose(), 0.5 * float(yaw)
    pose.position.x, pose.position.y = float(x), float(y)
    pose.orientation.z, pose.orientation.w = math.sin(half), math.cos(half)
    return pose


def occupancy_to_ros(values: npt.ArrayLike, resolution: float, origin: tuple[float, float, float],
                     header: Header) -> OccupancyGrid:
    """Return the grid of cell values (H, W), -1..100, row 0 the lowest; origin (x, y, yaw)."""
    cells = np.ascontiguousarray(values, dtype=np.int8)
    message = OccupancyGrid(header=header, data=array.array('b', cells.tobytes()))
    message.info.map_load_time = header.stamp
    message.info.height, message.info.width = (int(size) for size in cells.shape)
    message.info.resolution = float(resolution)
    message.info.origin = pose_to_ros(*origin)
    return message


class SentPath(NamedTuple):
    """A path in a frame at a time [ns], along poses (L, 7) as in ``recordings.cdr``."""

    frame: str
    stamp_ns: int
    poses: FloatArray

    @property
    def data(self) -> bytes:
        """The serialised message, 200 times as fast as the message."""
        return cdr.path(*self)

    @property
    def message(self) -> PathMessage:
        """The message, for services and actions, which rclpy serialises.

        Its poses are filled by their slots: constructors and setters take seven times as long.
        """
        header = Header(frame_id=self.frame, stamp=Time(nanoseconds=self.stamp_ns).to_msg())
        poses, new = [], object.__new__
        for row in self.poses.tolist():
            point, quaternion, pose, each = new(Point), new(Quaternion), new(Pose), new(PoseStamped)
            point._x, point._y, point._z = row[:3]
            quaternion._x, quaternion._y, quaternion._z, quaternion._w = row[3:]
            pose._position, pose._orientation = point, quaternion
            each._header, each._pose = header, pose
            point._check_fields = quaternion._check_fields = False
            pose._check_fields = each._check_fields = False
            poses.append(each)
        return PathMessage(header=header, poses=poses)


def row_of(pose: Pose) -> list[float]:
    """Return a pose as a row (7,): x, y, z [m] and its quaternion x, y, z, w."""
    return [getattr(part, name) for part, names in ((pose.position, 'xyz'),
                                                    (pose.orientation, 'xyzw')) for name in names]


def installed_type(module: str, name: str) -> Any:
    """Return an interface's type, or None if its package, which PyPI lacks, is not installed."""
    try:
        return getattr(import_module(module), name)
    except ImportError:
        return None


def message_from(data: bytes, kind: Any, topic: str) -> Any:
    """Return the message of a topic whose bytes these are; raises Refusal if they are none."""
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy's own error type is not public
        raise Refusal('INVALID_MESSAGE', f'{len(data)} bytes on {topic} are not a message of type '
                      f'{kind.__name__}') from error


def fields_of(message: Any) -> dict[str, Any]:
    """Return the fields of a message, nested ones included, as JSON values.

    For messages of numbers and strings, without arrays.
    """
    values = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    return {name: fields_of(value) if hasattr(value, 'get_fields_and_field_types') else value
            for name, value in values.items()}
