# SPDX-License-Identifier: Apache-2.0
"""Serialised marker arrays equal those of plain messages, by two independent readers."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.ros.cdr import marker_array

NO_COLOURS = np.empty((0, 4), dtype=np.float32)


def some_marker(frame='map', namespace='edges'):
    """A marker with a value in every field before and after points and colours."""
    marker = Marker(ns=namespace, id=7, type=Marker.LINE_LIST, frame_locked=True)
    marker.header = Header(frame_id=frame, stamp=Time(sec=5, nanosec=6))
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=0.1, y=0.2, z=0.3)
    marker.color = ColorRGBA(r=0.5, g=0.25, b=0.125, a=1.0)
    marker.lifetime.sec = 3
    marker.text, marker.mesh_resource = 'words', 'package://nowhere/mesh.dae'
    marker.mesh_use_embedded_materials = True
    return marker


def plain_array(marker, points, colours):
    """The message of ``marker_array``, made of objects."""
    marker.points = [Point(x=x, y=y) for x, y in points.tolist()]
    marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()]
    return MarkerArray(markers=[marker])


def random_points(count, coloured=True):
    rng = np.random.default_rng(count)
    colours = rng.random((count if coloured else 0, 4), dtype=np.float32)
    return rng.normal(scale=1e4, size=(count, 2)), colours


# All lengths modulo 8, and so all paddings before the points.
@pytest.mark.parametrize('namespace', ['abcdefg'[:length] for length in range(8)])
@pytest.mark.parametrize('frame', ['', 'map', 'karte_süd'])
def test_the_same_message_as_from_objects(frame, namespace):
    for count in (0, 1, 2, 300):
        for coloured in (True, False):
            points, colours = random_points(count, coloured)
            serialised = marker_array(some_marker(frame, namespace), points, colours)
            plain = plain_array(some_marker(frame, namespace), points, colours)
            assert deserialize_message(serialised, MarkerArray) == plain
            # The padding's content may differ, its length may not.
            assert len(serialised) == len(serialize_message(plain))


def test_numbers_are_kept_bit_for_bit_in_any_memory_layout():
    points = np.array([[math.inf, -0.0], [math.nan, 5e-324], [-1.7e308, 1 / 3]])
    for given in (points, np.asfortranarray(points)):
        serialised = marker_array(some_marker(), given, NO_COLOURS)
        (marker,) = deserialize_message(serialised, MarkerArray).markers
        found = np.array([(point.x, point.y) for point in marker.points])
        assert found.tobytes() == points.tobytes()
