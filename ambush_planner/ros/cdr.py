"""Serialised messages (CDR) written and read as whole arrays, past the message objects.

Every point of a message is a Python object, and serialising reads each of its fields: 60 000 points
and their colours take about 300 ms as objects, and 3 ms here (benchmarks/markers.py). Transforms
and updates of maps come often, and are read here, too.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray
from .tf_buffer import Rigid, StampedTransform

# Serialised messages begin with four bytes that say how the body is written: plain CDR, little
# endian. Numbers are aligned relative to the body.
_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
# A colour that no marker has. 0xfe is in each of its numbers and never in UTF-8, so that neither a
# frame nor a namespace can be taken for it.
_MARK = -(2.0**126)
_MARK_BYTES = struct.pack('<4f', *[_MARK] * 4)
_ALIGNMENT = 8  # of the largest numbers
_MOST_PADDING = 3  # at the end of a message from the network
_POSE = struct.Struct('<7d')


def marker_array(
    marker: Marker, points: FloatArray, colours: npt.NDArray[np.float32]
) -> bytes:
    """Return the serialised MarkerArray of one marker, drawn at height 0 in its frame.

    Parameters
    ----------
    marker
        All the rest; its ``points`` and ``colors`` are replaced.
    points : (K, 2)
        Positions [m].
    colours : (K, 4) or (0, 4)
        Red, green, blue, alpha of each point, 0..1; none: the marker's own ``color`` for all.

    Raises
    ------
    ValueError
        The middleware serialises in a way that this module does not know.
    """
    marker.points, marker.colors = [], [ColorRGBA(r=_MARK, g=_MARK, b=_MARK, a=_MARK)]
    return splice(serialize_message(MarkerArray(markers=[marker])), points, colours)


def splice(template: bytes, points: FloatArray, colours: npt.NDArray[np.float32]) -> bytes:
    """Return ``template``, a marker without points and with the mark as its colour, with others.

    Raises
    ------
    ValueError
        The template is not little endian CDR, or the mark is not in it exactly once.
    """
    before, *after = template.split(_MARK_BYTES)
    if not template.startswith(_LITTLE_ENDIAN) or len(after) != 1:
        raise ValueError(
            'the middleware serialises markers in an unknown way: the message begins with '
            f'{template[:4].hex(" ")} (known: {_LITTLE_ENDIAN.hex(" ")}) and has the marked '
            f'colour {len(after)} times (expected: once)'
        )
    # The counts of points (0) and of colours (1) come right before the mark. From there on nothing
    # is aligned to more than 4 bytes, except the points themselves: to 8, if there are any.
    head = before[:-8] + struct.pack('<I', len(points))
    gap = bytes(-(len(head) - len(_LITTLE_ENDIAN)) % 8 if len(points) else 0)
    xyz = np.zeros((len(points), 3), dtype='<f8')
    xyz[:, :2] = points
    rgba = np.ascontiguousarray(colours, dtype='<f4')
    return b''.join((head, gap, xyz.data, struct.pack('<I', len(rgba)), rgba.data, after[0]))


def path_bytes(ends: PathMessage, numbers: FloatArray) -> bytes:
    """Return the serialised path whose first and last poses are those of ``ends``.

    All stamped poses behind the first one take the same bytes but for the seven numbers at their
    end: the frame is the same, and each begins and ends aligned to 8.

    Parameters
    ----------
    ends
        A path of two poses with the header that all poses have.
    numbers : (L, 7)
        Positions and quaternions of the poses between them, in a message's order.
    """
    none, one, both = (
        serialize_message(PathMessage(header=ends.header, poses=ends.poses[:count]))
        for count in range(3)
    )
    last = both[len(one):]
    inner = np.tile(np.frombuffer(last, np.uint8), (len(numbers), 1))
    inner[:, -_POSE.size:] = np.ascontiguousarray(numbers, dtype='<f8').view(np.uint8)
    count = struct.pack('<I', len(numbers) + 2)
    return b''.join((none[:-4], count, both[len(none):len(one)], inner.data, last))


def plan_event_bytes(event: Any, path: bytes) -> bytes:
    """Return a serialised GetPlan event whose one response holds a serialised path.

    Parameters
    ----------
    event
        A GetPlan.Event with one response; the plan in it is not looked at.
    path
        The plan as it was published.
    """
    kind = type(event)
    empty = kind(info=event.info, request=event.request, response=[GetPlan.Response()])
    whole = serialize_message(empty)
    head = whole[:len(whole) - len(serialize_message(PathMessage())) + len(_LITTLE_ENDIAN)]
    if (len(head) - len(_LITTLE_ENDIAN)) % _ALIGNMENT or not path.startswith(_LITTLE_ENDIAN):
        return bytes(serialize_message(event))
    return head + path[len(_LITTLE_ENDIAN):]


def grid_bytes(head: OccupancyGrid, values: npt.NDArray[np.int8]) -> bytes:
    """Return the serialised map with the header and info of ``head`` and these cells (H, W)."""
    empty = serialize_message(OccupancyGrid(header=head.header, info=head.info))
    cells = np.ascontiguousarray(values)
    return b''.join((empty[:-4], struct.pack('<I', cells.size), cells.data))


def grid_cells(head: OccupancyGrid, data: bytes) -> npt.NDArray[np.int8] | None:
    """Return the cells (H, W) of a serialised map as a view into its bytes, if they lie there.

    ``head`` is the map's header and info, which were read already.
    """
    count = head.info.width * head.info.height
    begin = len(serialize_message(OccupancyGrid(header=head.header, info=head.info)))
    known = 0 <= len(data) - begin - count <= _MOST_PADDING
    if not known or data[begin - 4:begin] != struct.pack('<I', count):
        return None
    cells = np.frombuffer(data, np.int8, count, offset=begin)
    return cells.reshape(head.info.height, head.info.width)


@dataclass(frozen=True, eq=False)
class GridUpdate:
    """A map_msgs/OccupancyGridUpdate: new values (H, W) of cells from column x and row y on."""

    frame: str
    stamp: Time
    x: int
    y: int
    values: npt.NDArray[np.int8]


def read_grid_update(data: bytes) -> GridUpdate:
    """Read a serialised map_msgs/OccupancyGridUpdate.

    Raises
    ------
    ValueError
        The bytes are not one.
    """
    reader = _Reader(data)
    sec, nanosec = reader.take('iI')
    frame = reader.text()
    x, y, width, height, count = reader.take('iiIII')
    if count != width * height:
        raise ValueError(
            f'the update holds {count} cells, but width {width} x height {height} is '
            f'{width * height}'
        )
    values = np.frombuffer(reader.rest(count), np.int8).reshape(height, width)
    return GridUpdate(frame, Time(sec=sec, nanosec=nanosec), x, y, values)


def read_transforms(data: bytes) -> list[StampedTransform]:
    """Read a serialised tf2_msgs/TFMessage.

    Raises
    ------
    ValueError
        The bytes are not one.
    """
    reader = _Reader(data)
    (count,) = reader.take('I')
    return [_read_transform(reader) for _ in range(count)]


def _read_transform(reader: _Reader) -> StampedTransform:
    sec, nanosec = reader.take('iI')
    parent, child = reader.text(), reader.text()
    x, y, z, *rotation = reader.take('7d')
    stamp = sec * 1_000_000_000 + nanosec
    return StampedTransform(parent, child, stamp, Rigid((x, y, z), tuple(rotation)))


class _Reader:
    """Takes numbers and texts from a serialised message, one after the other.

    All methods raise ValueError where the message has ended or a text is not one.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise ValueError(f'{len(data)} bytes that are not plain CDR')
        self._order = '<' if data[1] else '>'
        self._body, self._at = memoryview(data)[4:], 0

    def take(self, kinds: str) -> tuple[Any, ...]:
        """Read numbers by their letters in ``struct``, all of one size."""
        layout = struct.Struct(self._order + kinds)
        size = struct.calcsize(self._order + kinds[-1])
        self._at += -self._at % size
        try:
            numbers = layout.unpack_from(self._body, self._at)
        except struct.error as error:
            raise ValueError(f'a message that ends after {len(self._body)} bytes') from error
        self._at += layout.size
        return numbers

    def text(self) -> str:
        """Read a string."""
        (length,) = self.take('I')
        try:
            return bytes(self.rest(length)).rstrip(b'\0').decode()
        except UnicodeDecodeError as error:
            raise ValueError('a name that is not UTF-8') from error

    def rest(self, length: int) -> memoryview:
        """Read bytes."""
        if length > len(self._body) - self._at:
            raise ValueError(f'a message that ends after {len(self._body)} bytes')
        self._at += length
        return self._body[self._at - length:self._at]
