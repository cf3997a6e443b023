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

from ..core.arrays import FloatArray
from ..core.errors import InvalidRiskMap
from ..core.risk_map import (
    OccupancyOptions,
    RiskMap,
    check_occupancy,
    risk_map_from_occupancy,
)
from .errors import InvalidPose

# Of the squared norm, as Nav2 checks quaternions; covers rounding to float32.
_UNIT_TOLERANCE = 1e-4
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


def pose_from_ros(pose: Pose) -> tuple[float, float, float]:
    """Return (x, y, yaw) [m, m, rad] of a pose in the plane."""
    q = pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, yaw


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


def occupancy_from_ros(
    message: OccupancyGrid,
) -> tuple[npt.NDArray[np.int8], float, tuple[float, float, float]]:
    """Return cell values (H, W), the resolution [m] and the origin (x, y, yaw), all checked.

    Raises
    ------
    InvalidRiskMap
        The map has no frame or no cells, its data is not width * height long, its resolution is
        not positive, its origin not a pose in the plane, or a cell's value outside -1..100.
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
    if fault := _pose_fault(origin) or _tilt_fault(origin.orientation):
        raise InvalidRiskMap(f"the map's origin: {fault}")
    values = np.frombuffer(message.data, dtype=np.int8).reshape(info.height, info.width)
    grid = values, float(info.resolution), pose_from_ros(origin)
    check_occupancy(*grid)
    return grid


def risk_map_from_ros(message: OccupancyGrid, options: OccupancyOptions) -> RiskMap:
    """Read the map's cell values as losses.

    Raises
    ------
    InvalidRiskMap
        The message is malformed, or a cell's value is outside -1..100.
    """
    return risk_map_from_occupancy(*occupancy_from_ros(message), options)


def position_from_ros(pose: PoseStamped, name: str) -> tuple[float, float]:
    """Return (x, y) [m] of the pose called ``name``.

    Raises
    ------
    InvalidPose
        A number is not finite, or the orientation is not a unit quaternion.
    """
    if fault := _pose_fault(pose.pose):
        raise InvalidPose(f'{name}: {fault}')
    return pose.pose.position.x, pose.pose.position.y


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


def path_from_ros(path: PathMessage) -> FloatArray:
    """Return the poses (L, 3) = (x, y, yaw) of a path."""
    rows = [pose_from_ros(stamped.pose) for stamped in path.poses]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _pose_fault(pose: Pose) -> str | None:
    """Say what is wrong with a pose's numbers, if anything is."""
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


def _tilt_fault(q: Quaternion) -> str | None:
    if q.x * q.x + q.y * q.y > _UNIT_TOLERANCE:
        return (
            f'orientation (x, y, z, w) = ({q.x}, {q.y}, {q.z}, {q.w}) tilts the map; only a '
            'rotation about z is possible'
        )
    return None


def fields_of(message: Any, but: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the fields of a message, those of messages in it too, as JSON can hold them.

    For messages of numbers and texts, without arrays. ``but`` are left out.
    """
    values = {name: getattr(message, name) for name in _field_names(message) if name not in but}
    return {name: fields_of(value) if _field_names(value) else value
            for name, value in values.items()}


def message_of(kind: Any, fields: Mapping[str, Any], but: tuple[str, ...] = ()) -> Any:
    """Return the message with these fields, whatever they hold; the way back from ``fields_of``.

    Raises
    ------
    ValueError
        They are not those of the message, or of other types.
    """
    message = kind()
    if set(fields) != set(_field_names(message)) - set(but):
        raise ValueError(f'they are not the fields of a {kind.__name__}')
    for name, value in fields.items():
        default = getattr(message, name)
        if _field_names(default) and isinstance(value, dict):
            value = message_of(type(default), value)
        if type(value) is not type(default):
            raise ValueError(f'{name} is not a {type(default).__name__}')
        try:
            setattr(message, name, value)
        except AssertionError as error:
            raise ValueError(f'{name} is out of its range') from error
    return message


def _field_names(message: Any) -> Mapping[str, str]:
    names: Mapping[str, str] = getattr(message, 'get_fields_and_field_types', dict)()
    return names
