# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: round trips, exactness, what is refused, and serialised markers."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from games import examples
from geometry_msgs.msg import Point, Vector3
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from ros_harness import FRAME, header, risk_grid
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.errors import InvalidRiskMap
from ambush_planner.maps.ros_messages import occupancy_from_ros, path_from_ros, pose_from_ros
from ambush_planner.ros.cdr import marker_array
from ambush_planner.ros.conversions import occupancy_to_ros, path_to_ros, pose_to_ros

coordinates = st.floats(-1e6, 1e6)
NO_COLOURS = np.empty((0, 4), dtype=np.float32)
NAN, INF = math.nan, math.inf


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


@examples(20)
@given(coordinates, coordinates, st.floats(-math.pi, math.pi))
def test_pose_round_trip(x, y, yaw):
    got = pose_from_ros(over_the_wire(pose_to_ros(x, y, yaw)))
    assert got[:2] == (x, y)
    assert math.cos(got[2] - yaw) == pytest.approx(1.0, abs=1e-12)


def test_occupancy_round_trip():
    values = np.random.default_rng(3).integers(-1, 101, (7, 5), dtype=np.int8)
    message = occupancy_to_ros(values, 0.25, (1.0, -2.0, 0.75), header())
    assert (message.info.height, message.info.width) == (7, 5)
    assert np.shares_memory(occupancy_from_ros(message)[0], message.data), 'it is not copied'
    got, resolution, origin = occupancy_from_ros(over_the_wire(message))
    np.testing.assert_array_equal(got, values)
    assert (resolution, *origin) == pytest.approx((0.25, 1.0, -2.0, 0.75), abs=1e-15)


def test_path_keeps_both_ends_exactly():
    start, goal = pose_to_ros(0.1, 0.2, 3.0), pose_to_ros(7.3, 0.4, -2.0)
    start.position.z, goal.position.z = 1.5, 2.5
    rows = np.array([[0.1, 0.2, 0.0], [3.0, 0.2, 0.5], [7.3, 0.4, 0.5]])
    path = over_the_wire(path_to_ros(rows, start, goal, header()))
    assert path.poses[0].pose == start
    assert path.poses[-1].pose == goal
    assert {stamped.header.frame_id for stamped in path.poses} == {FRAME}
    rows[[0, -1], 2] = 3.0, -2.0
    np.testing.assert_allclose(path_from_ros(path), rows, rtol=0, atol=1e-15)


def spoiled(**changes):
    """A good map with fields of its info, origin's position or orientation changed."""
    message = risk_grid(np.zeros((3, 4), dtype=np.int8))
    for name, value in changes.items():
        place = message.info
        if name in ('x', 'y', 'z'):
            place = message.info.origin.position
        elif name.startswith('q'):
            place, name = message.info.origin.orientation, name[1:]
        setattr(place, name, value)
    return message


# Maps that have to be refused, and words that the reason must have (regular expressions).
BAD_MAPS = {
    'no cells': (spoiled(width=0, height=0), 'empty: width 0, height 0'),
    'no rows': (spoiled(height=0), 'width 4, height 0'),
    'data too short': (spoiled(height=5), '12 cells, but width 4 x height 5 is 20'),
    'data too long': (spoiled(width=2), '12 cells, but width 2 x height 3 is 6'),
    'huge claim': (spoiled(width=30_000, height=30_000), '900000000'),
    'resolution 0': (spoiled(resolution=0.0), 'resolution.*0.0'),
    'resolution negative': (spoiled(resolution=-0.5), 'resolution.*-0.5'),
    'resolution NaN': (spoiled(resolution=NAN), 'resolution.*nan'),
    'resolution infinite': (spoiled(resolution=INF), 'resolution.*inf'),
    'origin NaN': (spoiled(x=NAN), r'origin: position \(nan, 0.0, 0.0\)'),
    'origin infinite': (spoiled(y=-INF), r'origin: position \(0.0, -inf, 0.0\)'),
    'origin quaternion NaN': (spoiled(qz=NAN), 'origin: orientation .*nan'),
    'origin quaternion zero': (spoiled(qw=0.0), 'not a unit quaternion: its norm is 0'),
    'origin quaternion long': (spoiled(qw=2.0), 'not a unit quaternion: its norm is 2'),
    'origin tilted': (spoiled(qw=0.0, qx=1.0), 'tilts the map'),
    'value over 100': (risk_grid(np.array([[0, 101]])), r'101 at \(row, column\) \(0, 1\)'),
    'value under -1': (risk_grid(np.array([[0], [-2]])), r'-2 at \(row, column\) \(1, 0\)'),
    'no frame': (risk_grid(frame=''), 'frame_id is empty'),
}


@pytest.mark.parametrize('name', BAD_MAPS)
def test_bad_map_is_refused_by_name_and_number(name):
    message, words = BAD_MAPS[name]
    with pytest.raises(InvalidRiskMap, match=words):
        occupancy_from_ros(message)


# Arrays of markers, which are written without objects.


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
    for array in (points, np.asfortranarray(points)):
        serialised = marker_array(some_marker(), array, NO_COLOURS)
        (marker,) = deserialize_message(serialised, MarkerArray).markers
        found = np.array([(point.x, point.y) for point in marker.points])
        assert found.tobytes() == points.tobytes()
