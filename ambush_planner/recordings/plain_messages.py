# SPDX-License-Identifier: Apache-2.0
"""The map, poses and path of a departure as ROS messages, made without ROS.

Their definitions are in ``definitions.json``, as Jazzy has them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from ..arrays import FloatArray
from ..maps.occupancy import OBSTACLE, UNKNOWN, OccupancyOptions
from ..maps.risk_map import RiskMap
from .messages import DURATIONS, INFINITE_NS, RecordedMessage
from .schemas import definitions

MAP, POSE, PATH = 'nav_msgs/msg/OccupancyGrid', 'geometry_msgs/msg/PoseStamped', 'nav_msgs/msg/Path'
_FOREVER = dict(zip(('sec', 'nsec'), divmod(INFINITE_NS, 1_000_000_000), strict=True))
# The quality of service that the node publishes paths with.
LATCHED = yaml.safe_dump([{
    'history': 'keep_last', 'depth': 1, 'reliability': 'reliable', 'durability': 'transient_local',
    **dict.fromkeys(DURATIONS, _FOREVER), 'liveliness': 'automatic',
    'avoid_ros_namespace_conventions': False}], sort_keys=False)


def map_message(risk_map: RiskMap, options: OccupancyOptions, frame: str,
                stamp_ns: int) -> RecordedMessage:
    """The map as an occupancy grid, its losses rounded to those of the values 0 to 100."""
    x, y, yaw = risk_map.origin
    values = grid_values(risk_map, options)
    info = {'map_load_time': _time(stamp_ns), 'resolution': risk_map.resolution,
            'width': values.shape[1], 'height': values.shape[0], 'origin': _pose(x, y, yaw)}
    return _message('/alpha_map', MAP, {'header': _header(frame, stamp_ns), 'info': info,
                                        'data': values.tobytes()}, stamp_ns)


def pose_message(topic: str, xy: Sequence[float], frame: str, stamp_ns: int) -> RecordedMessage:
    """A start or a goal."""
    return _message(topic, POSE, _stamped((*xy, 0.0), frame, stamp_ns), stamp_ns)


def path_message(poses: FloatArray, frame: str, stamp_ns: int) -> RecordedMessage:
    """A path (L, 3) = (x, y, yaw)."""
    rows = [_stamped(pose, frame, stamp_ns) for pose in poses.tolist()]
    return _message('/path', PATH, {'header': _header(frame, stamp_ns), 'poses': rows}, stamp_ns)


def grid_values(risk_map: RiskMap, options: OccupancyOptions) -> npt.NDArray[np.int8]:
    """The values (H, W) of an occupancy grid, -1 to 100, whose losses are nearest to the map's."""
    most = options.obstacle_threshold - 1
    span = (options.alpha_max - options.alpha_min) or 1.0
    share = (np.nan_to_num(risk_map.alpha) - options.alpha_min) / span
    values = np.clip(np.rint(100.0 * share), 0, most).astype(np.int8)
    values[risk_map.obstacles] = OBSTACLE
    if risk_map.unknown is not None:
        values[risk_map.unknown] = UNKNOWN
    return values


def _message(topic: str, kind: str, fields: Mapping[str, Any], stamp_ns: int) -> RecordedMessage:
    from mcap.reader import make_reader
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    stream = BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    # Bytes are written as one slice, other numbers one by one.
    text = definitions()[kind].text.replace('int8[] data', 'uint8[] data')
    writer.write_message(topic, writer.register_msgdef(kind, text), fields, stamp_ns)
    writer.finish()
    stream.seek(0)
    (_, _, message), = make_reader(stream).iter_messages()
    return RecordedMessage(topic, kind, message.data, LATCHED, stamp_ns)


def _stamped(pose: Sequence[float], frame: str, stamp_ns: int) -> dict[str, Any]:
    return {'header': _header(frame, stamp_ns), 'pose': _pose(*pose)}


def _pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    return {'position': {'x': x, 'y': y, 'z': 0.0},
            'orientation': {'x': 0.0, 'y': 0.0, 'z': math.sin(yaw / 2.0),
                            'w': math.cos(yaw / 2.0)}}


def _header(frame: str, stamp_ns: int) -> dict[str, Any]:
    return {'stamp': _time(stamp_ns), 'frame_id': frame}


def _time(stamp_ns: int) -> dict[str, int]:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    return {'sec': seconds, 'nanosec': rest}
