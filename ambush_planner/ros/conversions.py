"""Messages to arrays and back: whole arrays at a time, in named pairs.

Every number is cast before it goes into a message: rclpy writes other types than the field's own
into memory as they are.
"""

from __future__ import annotations

import array
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from std_msgs.msg import Header

from ..arrays import FloatArray

_new: Any = object.__new__
# Of Jazzy's messages; where others are used, they are made by their constructors.
_SLOTS_ARE_KNOWN = all(
    kind.__slots__ == [*(f'_{name}' for name in names), '_check_fields']
    for kind, names in (
        (Point, 'xyz'), (Quaternion, 'xyzw'), (Pose, ('position', 'orientation')),
        (PoseStamped, ('header', 'pose')),
    )
)


def pose_to_ros(x: float, y: float, yaw: float = 0.0) -> Pose:
    """Return the pose at (x, y) [m] that looks along yaw [rad]."""
    half = 0.5 * float(yaw)
    return Pose(
        position=Point(x=float(x), y=float(y)),
        orientation=Quaternion(z=math.sin(half), w=math.cos(half)),
    )


def occupancy_to_ros(
    values: npt.ArrayLike, resolution: float, origin: tuple[float, float, float], header: Header
) -> OccupancyGrid:
    """Return the grid of cell values (H, W), -1..100, row 0 the lowest; origin (x, y, yaw)."""
    cells = np.ascontiguousarray(values, dtype=np.int8)
    message = OccupancyGrid(header=header, data=array.array('b', cells.tobytes()))
    message.info.map_load_time = header.stamp
    message.info.height, message.info.width = (int(size) for size in cells.shape)
    message.info.resolution = float(resolution)
    message.info.origin = pose_to_ros(*origin)
    return message


def path_to_ros(poses: FloatArray, start: Pose, goal: Pose, header: Header) -> PathMessage:
    """Return the path along ``poses`` (L, 3) = (x, y, yaw).

    The first pose is the start's and the last one the goal's, as they were given.
    """
    result = stamped_poses(poses, header)
    result[0].pose = start
    result[-1].pose = goal
    return PathMessage(header=header, poses=result)


def stamped_poses(poses: FloatArray, header: Header) -> list[PoseStamped]:
    """Return the poses (L, 3) = (x, y, yaw) as messages that share one header.

    Without the constructors, which take eight times as long: a path of 500 poses took 7 ms of a
    departure's answer.
    """
    if not _SLOTS_ARE_KNOWN:
        return [PoseStamped(header=header, pose=pose_to_ros(*row)) for row in poses.tolist()]
    check = header._check_fields
    return [_stamped_pose(x, y, 0.5 * yaw, header, check) for x, y, yaw in poses.tolist()]


def _stamped_pose(x: float, y: float, half: float, header: Header, check: bool) -> PoseStamped:
    position = _new(Point)
    position._x, position._y, position._z, position._check_fields = x, y, 0.0, check
    q = _new(Quaternion)
    q._x, q._y, q._z, q._w, q._check_fields = 0.0, 0.0, math.sin(half), math.cos(half), check
    pose = _new(Pose)
    pose._position, pose._orientation, pose._check_fields = position, q, check
    stamped = _new(PoseStamped)
    stamped._header, stamped._pose, stamped._check_fields = header, pose, check
    return stamped


def fields_of(message: Any, but: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the fields of a message, those of messages in it too, as JSON can hold them.

    For messages of numbers and texts, without arrays. ``but`` are left out.
    """
    values = {name: getattr(message, name) for name in _field_names(message) if name not in but}
    return {name: fields_of(value) if _field_names(value) else value
            for name, value in values.items()}


def _field_names(message: Any) -> Mapping[str, str]:
    names: Mapping[str, str] = getattr(message, 'get_fields_and_field_types', dict)()
    return names
