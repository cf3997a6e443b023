"""What the fuzzing sends: each message follows from the seed and its number alone."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import node_rig
import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from std_srvs.srv import Trigger

sys.path.append(str(node_rig.TESTS))
import interfaces  # noqa: E402

from ambush_planner.planning.parameters import PARAMETERS
from ambush_planner.ros.conversions import occupancy_to_ros, pose_to_ros

Random = np.random.Generator
interfaces.install('map_msgs')
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402

SIDE = 10.0  # of the map in force [m]
_ODD = (float('nan'), float('inf'), -float('inf'), -0.0, 5e-324, 1e-30, 1e30, 1.8e308, -1.0)
_NAMES = ('', 'map', '/map', 'odom', 'mäp', 'a' * 300, 'line\nbreak', '%s%n', '\ufffe', '{0}', '🜨')
_LENGTHS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFF8, 100_000_000)
# Not the folder of the recordings, nor the clock: these are the operator's to get wrong.
_PARAMETERS = [name for name in PARAMETERS if name != 'recording.directory']


@dataclass(frozen=True)
class Attack:
    """One message: bytes for a topic, or a request for a service."""

    what: str
    kind: type
    target: str
    content: Any

    @property
    def is_service(self) -> bool:
        """Whether it asks for an answer."""
        return not isinstance(self.content, bytes)


def attack(seed: int, number: int) -> Attack:
    """The message with this number."""
    rng = np.random.default_rng([seed, number])
    makers = (_bytes_on_a_topic, _request, _parameters)
    return makers[rng.choice(len(makers), p=[0.7, 0.2, 0.1])](rng)


def good_map() -> OccupancyGrid:
    """A map of ``SIDE`` with some risk and a block in the middle."""
    values = np.random.default_rng(1).integers(0, 60, (20, 20), dtype=np.int8)
    values[8:12, 8:12] = 100
    return occupancy_to_ros(values, SIDE / 20, (0.0, 0.0, 0.0), Header(frame_id='map'))


def good_pose(x: float, y: float) -> PoseStamped:
    """A pose on that map."""
    return PoseStamped(header=Header(frame_id='map'), pose=pose_to_ros(x, y))


def _bytes_on_a_topic(rng: Random) -> Attack:
    kind, topic, make = _pick(rng, (
        (OccupancyGrid, '/alpha_map', _map), (OccupancyGridUpdate, '/alpha_map_updates', _update),
        (PoseStamped, '/start_pose', _pose_stamped),
        (PoseStamped, '/goal_pose', _pose_stamped),
        (PoseWithCovarianceStamped, '/initialpose', _estimate),
    ))
    if rng.random() < 0.1:
        return Attack('random bytes', kind, topic, rng.bytes(int(rng.integers(0, 300))))
    made = make(rng)
    data = made if isinstance(made, bytes) else bytes(serialize_message(made))
    if rng.random() < 0.25:
        return Attack('any numbers', kind, topic, data)
    names = []
    for _ in range(rng.integers(1, 4)):
        mutate = _pick(rng, _MUTATIONS)
        names.append(mutate.__name__.strip('_'))
        data = mutate(rng, data)
    return Attack(' + '.join(names), kind, topic, data)


def _flip(rng: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for at in rng.integers(0, len(data), rng.integers(1, 9)) if data else ():
        changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _truncate(rng: Random, data: bytes) -> bytes:
    return data[:int(rng.integers(0, len(data) + 1))]


def _extend(rng: Random, data: bytes) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 5000)))


def _absurd_length(rng: Random, data: bytes) -> bytes:
    return _put(rng, data, 4, struct.pack('<I', _pick(rng, _LENGTHS)))


def _odd_number(rng: Random, data: bytes) -> bytes:
    return _put(rng, data, 8, struct.pack('<d', _pick(rng, _ODD)))


def _other_encoding(rng: Random, data: bytes) -> bytes:
    """Big endian, parameter lists, the newer CDR, and kinds that nobody knows."""
    return bytes([0, int(rng.integers(0, 16)), *rng.bytes(2)]) + data[4:]


def _swap(rng: Random, data: bytes) -> bytes:
    """Move the end before the beginning."""
    at = int(rng.integers(0, len(data) + 1))
    return data[:4] + data[at:] + data[4:at]


def _zero(rng: Random, data: bytes) -> bytes:
    begin, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    return data[:begin] + bytes(end - begin) + data[end:]


_MUTATIONS: tuple[Callable[[Random, bytes], bytes], ...] = (
    _flip, _truncate, _extend, _absurd_length, _odd_number, _other_encoding, _swap, _zero,
)


def _put(rng: Random, data: bytes, size: int, new: bytes) -> bytes:
    """Overwrite one of the places where such a number can stand: they are aligned in the body."""
    places = (len(data) - 4) // size
    if places < 1:
        return data
    at = 4 + size * int(rng.integers(places))
    return data[:at] + new + data[at + size:]


def _map(rng: Random) -> OccupancyGrid:
    """Most of them could be in force."""
    shape = rng.integers(1, 25, 2)
    low, high = _pick(rng, ((0, 60), (0, 60), (-1, 101), (-128, 128)))
    made = occupancy_to_ros(
        rng.integers(low, high, shape, dtype=np.int8), SIDE / 20,
        (0.0, 0.0, _pick(rng, (0.0, 0.0, 1.0))), Header(frame_id='map'))
    if rng.random() < 0.3:
        made.header.frame_id = _pick(rng, _NAMES)
        made.info.resolution = abs(_number(rng, 1e30)) if rng.random() < 0.5 else 0.5
        made.info.origin.position.x = _number(rng)
        made.info.origin.orientation.z = _number(rng)
        made.info.width = _pick(rng, (*map(int, shape), *_LENGTHS))
    return made


def _update(rng: Random) -> OccupancyGridUpdate:
    """Most of them lie within a map of ``SIDE``, some beside it, and few on the good one."""
    values = rng.integers(*_pick(rng, ((0, 60), (0, 101), (-128, 128))), rng.integers(0, 6, 2))
    x, y = rng.integers(-2, 20, 2).tolist() if rng.random() < 0.9 else (-(2**31), 2**31 - 1)
    frame = 'map' if rng.random() < 0.8 else _pick(rng, _NAMES)
    stamp = Time(sec=int(rng.integers(2**31)), nanosec=int(rng.integers(2**32)))
    height, width = map(int, values.shape)
    return OccupancyGridUpdate(
        header=Header(frame_id=frame, stamp=stamp), x=x, y=y, width=width, height=height,
        data=values.ravel().tolist(),
    )


def _pose_stamped(rng: Random) -> PoseStamped:
    """Most of them could be driven to."""
    made = good_pose(*rng.uniform(0.0, SIDE, 2).tolist())
    if rng.random() < 0.3:
        made.header.frame_id = _pick(rng, _NAMES)
        made.pose.position.x, made.pose.position.y = _number(rng), _number(rng)
        made.pose.orientation.w = _number(rng)
        made.header.stamp.sec = int(rng.integers(-(2**31), 2**31))
        made.header.stamp.nanosec = int(rng.integers(0, 2**32))
    return made


def _estimate(rng: Random) -> PoseWithCovarianceStamped:
    stamped = _pose_stamped(rng)
    made = PoseWithCovarianceStamped(header=stamped.header)
    made.pose.pose = stamped.pose
    made.pose.covariance = [_number(rng) for _ in range(36)]
    return made


def _request(rng: Random) -> Attack:
    kind, name = _pick(rng, (
        (GetPlan, 'get_plan'), (GetPlan, 'get_plan'), (Trigger, 'new_route'),
        (Trigger, 'replan'), (Trigger, 'cancel'),
    ))
    request = kind.Request()
    if kind is GetPlan:
        tolerance = float(np.float32(_pick(rng, (0.0, 1.0, _number(rng, 3e38)))))
        request = kind.Request(
            start=_pose_stamped(rng), goal=_pose_stamped(rng), tolerance=tolerance)
    return Attack('any request', kind, name, request)


def _parameters(rng: Random) -> Attack:
    names = [_name(rng) for _ in range(rng.integers(0, 4))]
    kind, name, request = _pick(rng, (
        (SetParametersAtomically, 'set_parameters_atomically', _setting),
        (SetParametersAtomically, 'set_parameters_atomically', _setting),
        (SetParameters, 'set_parameters', _setting),
        (GetParameters, 'get_parameters', _naming),
        (DescribeParameters, 'describe_parameters', _naming),
        (GetParameterTypes, 'get_parameter_types', _naming),
        (ListParameters, 'list_parameters', _listing),
    ))
    return Attack('any parameters', kind, name, request(rng, kind, names))


def _setting(rng: Random, kind: type, names: list[str]) -> Any:
    return kind.Request(parameters=[_parameter(rng, name) for name in names])


def _naming(rng: Random, kind: type, names: list[str]) -> Any:
    return kind.Request(names=names)


def _listing(rng: Random, kind: type, names: list[str]) -> Any:
    return kind.Request(prefixes=names, depth=int(rng.integers(0, 2**63)))


def _name(rng: Random) -> str:
    """A parameter's name, seldom one that there is not."""
    return _pick(rng, _NAMES if rng.random() < 0.05 else _PARAMETERS)


def _parameter(rng: Random, name: str) -> Parameter:
    """A value that is near the default, of another type, or absurd."""
    default = PARAMETERS[name].default if name in PARAMETERS else 1.0
    value = ParameterValue(type=int(rng.integers(0, 11)))
    choice = rng.random()
    if choice < 0.1:
        value.type = int(rng.integers(0, 256))
    elif choice < 0.8:
        value.type = {bool: 1, int: 2, float: 3, str: 4}[type(default)]
    value.bool_value = bool(rng.random() < 0.5)
    value.integer_value = _pick(rng, (-1, 0, 1, 2, 50, 100, 2**62, -(2**63)))
    # Long solves are another benchmark's.
    odd = 2.0 if name == 'max_planning_time' else _number(rng)
    value.double_value = _pick(rng, (0.0, 0.5, 1.0, 2.0, odd))
    value.string_value = _pick(rng, (*(PARAMETERS[name].choices if name in PARAMETERS else ()),
                                     *_NAMES))
    return Parameter(name=name, value=value)


def _number(rng: Random, largest: float = 1e308) -> float:
    number = _pick(rng, (*_ODD, float(rng.uniform(-SIDE, 2.0 * SIDE))))
    return float(np.clip(number, -largest, largest))


def _pick(rng: Random, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]
