"""A marker's points and colours as arrays, put straight into the bytes of the message.

Every point of a message is a Python object, and serialising reads each of its fields: 60 000 points
and their colours take about 300 ms as objects, and 3 ms here (benchmarks/markers.py).
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..core.risk_map import FloatArray

# Serialised messages begin with four bytes that say how the body is written: plain CDR, little
# endian. Numbers are aligned relative to the body.
_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
# A colour that no marker has. 0xfe is in each of its numbers and never in UTF-8, so that neither a
# frame nor a namespace can be taken for it.
_MARK = -(2.0**126)
_MARK_BYTES = struct.pack('<4f', *[_MARK] * 4)


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
    return b''.join((head, gap, xyz, struct.pack('<I', len(rgba)), rgba, after[0]))
