# SPDX-License-Identifier: Apache-2.0
"""Read maps, poses and paths from ROS messages decoded by any library; needs no ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..errors import InvalidPose, InvalidRiskMap
from .occupancy import check_occupancy

# Maximum number of poses in a path; serialising more would block the node for seconds.
MAX_POSES = 20_000
# Tolerance of a quaternion's squared norm, as in Nav2; covers rounding to float32.
_UNIT_TOLERANCE = 1e-4


def occupancy_from_ros(
    message: Any,
) -> tuple[npt.NDArray[np.int8], float, tuple[float, float, float]]:
    """Return the checked cell values (H, W), resolution [m] and origin (x, y, yaw).

    Raises InvalidRiskMap if the map has no frame or no cells, its data does not match width *
    height, its resolution is not positive, its origin is not a planar pose, or a value is outside
    -1..100.
    """
    info = message.info
    if not message.header.frame_id:
        raise InvalidRiskMap('the map has no frame: header.frame_id is empty')
    if info.width == 0 or info.height == 0:
        raise InvalidRiskMap(f'the map is empty: width {info.width}, height {info.height}')
    if len(message.data) != info.width * info.height:
        raise InvalidRiskMap(
            f'the map holds {len(message.data)} cells, but width {info.width} x height '
            f'{info.height} is {info.width * info.height}'
        )
    origin = info.origin
    if fault := _pose_fault(origin):
        raise InvalidRiskMap(f"the map's origin: {fault}")
    q = origin.orientation
    if q.x * q.x + q.y * q.y > _UNIT_TOLERANCE:
        raise InvalidRiskMap(f"the map's origin: orientation (x, y, z, w) = ({q.x}, {q.y}, {q.z}, "
                             f'{q.w}) tilts the map; only rotation about z is supported')
    values = np.frombuffer(message.data, dtype=np.int8).reshape(info.height, info.width)
    grid = values, float(info.resolution), pose_from_ros(origin)
    check_occupancy(*grid)
    return grid


def pose_from_ros(pose: Any) -> tuple[float, float, float]:
    """Return (x, y, yaw) [m, m, rad] of a planar pose."""
    q = pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, yaw


def position_from_ros(pose: Any, name: str) -> tuple[float, float]:
    """Return (x, y) [m] of the pose called ``name``.

    Raises InvalidPose if a number is not finite, or the orientation is not a unit quaternion.
    """
    if fault := _pose_fault(pose.pose):
        raise InvalidPose(f'{name}: {fault}')
    return pose.pose.position.x, pose.pose.position.y


def path_from_ros(path: Any) -> FloatArray:
    """Return the poses (L, 3) = (x, y, yaw) of a path."""
    rows = [pose_from_ros(stamped.pose) for stamped in path.poses]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _pose_fault(pose: Any) -> str | None:
    """Describe what is wrong with a pose's numbers, if anything."""
    p, q = pose.position, pose.orientation
    if not all(map(math.isfinite, (p.x, p.y, p.z))):
        return f'position ({p.x}, {p.y}, {p.z}) is not finite'
    norm = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not abs(norm * norm - 1.0) <= _UNIT_TOLERANCE:
        return (
            f'orientation (x, y, z, w) = ({q.x}, {q.y}, {q.z}, {q.w}) is not a unit quaternion: '
            f'its norm is {norm:.6g}'
        )
    return None


def update_fault(update: Any, frame_of_map: str, shape: tuple[int, ...]) -> str:
    """Describe why a map_msgs/OccupancyGridUpdate does not fit a map (H, W); '' if it fits."""
    (height, width), frame = shape, update.header.frame_id
    rows, columns, x, y = update.height, update.width, update.x, update.y
    if len(update.data) != rows * columns:
        return (f'it holds {len(update.data)} cells, but width {columns} x height {rows} is '
                f'{rows * columns}')
    if frame != frame_of_map:
        return f'its frame is {frame[:80]!r}, but the frame of the map is {frame_of_map!r}'
    if x < 0 or y < 0 or x + columns > width or y + rows > height:
        return (f'{columns} x {rows} cells from ({x}, {y}) do not fit into the map of '
                f'{width} x {height} cells')
    return ''
