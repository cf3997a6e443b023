"""Spliced messages are, read by two readers, the messages that plain objects make."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, TransformStamped, Vector3
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from service_msgs.msg import ServiceEventInfo
from standin_types import grid_update, tf_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.ros.cdr import (
    grid_bytes,
    grid_cells,
    marker_array,
    plan_event_bytes,
    read_grid_update,
    read_transforms,
    splice,
)
from ambush_planner.ros.conversions import (
    occupancy_to_ros,
    path_to_ros,
    pose_to_ros,
    stamped_poses,
)

NO_COLOURS = np.empty((0, 4), dtype=np.float32)


def some_marker(frame='map', namespace='edges'):
    """A marker with something in every field before and after points and colours."""
    marker = Marker(ns=namespace, id=7, type=Marker.LINE_LIST, frame_locked=True)
    marker.header = Header(frame_id=frame, stamp=Time(sec=5, nanosec=6))
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=0.1, y=0.2, z=0.3)
    marker.color = ColorRGBA(r=0.5, g=0.25, b=0.125, a=1.0)
    marker.lifetime.sec = 3
    marker.text, marker.mesh_resource = 'words', 'package://nowhere/mesh.dae'
    marker.mesh_use_embedded_materials = True
    return marker


def plainly(marker, points, colours):
    """The message of ``marker_array``, made of objects."""
    marker.points = [Point(x=x, y=y) for x, y in points.tolist()]
    marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()]
    return MarkerArray(markers=[marker])


def drawn(count, coloured=True):
    """So many points and colours, at random."""
    rng = np.random.default_rng(count)
    colours = rng.random((count if coloured else 0, 4), dtype=np.float32)
    return rng.normal(scale=1e4, size=(count, 2)), colours


# Of all lengths modulo 8, so that each gap before the points comes up that there can be.
@pytest.mark.parametrize('namespace', ['abcdefg'[:length] for length in range(8)])
@pytest.mark.parametrize('frame', ['', 'map', 'karte_süd'])
@pytest.mark.parametrize('count', [0, 1, 2])
@pytest.mark.parametrize('coloured', [True, False])
def test_the_same_message_as_from_objects(count, coloured, frame, namespace):
    points, colours = drawn(count, coloured)
    spliced = marker_array(some_marker(frame, namespace), points, colours)
    plain = plainly(some_marker(frame, namespace), points, colours)
    assert deserialize_message(spliced, MarkerArray) == plain
    # Padding may differ, its length may not.
    assert len(spliced) == len(serialize_message(plain))


def test_many_points():
    points, colours = drawn(20_000)
    message = deserialize_message(marker_array(some_marker(), points, colours), MarkerArray)
    assert message == plainly(some_marker(), points, colours)


@pytest.mark.parametrize('namespace', ['', 'a', 'abcde'])
@pytest.mark.parametrize('count', [0, 1, 100])
def test_a_reader_of_its_own_finds_the_same(count, namespace):
    points, colours = drawn(count)
    spliced = marker_array(some_marker(namespace=namespace), points, colours)
    store = get_typestore(Stores.ROS2_JAZZY)
    (marker,) = store.deserialize_cdr(spliced, 'visualization_msgs/msg/MarkerArray').markers
    assert (marker.ns, marker.id, marker.frame_locked) == (namespace, 7, True)
    assert (marker.text, marker.mesh_use_embedded_materials) == ('words', True)
    assert [(p.x, p.y, p.z) for p in marker.points] == [(*p, 0.0) for p in points.tolist()]
    assert [(c.r, c.g, c.b, c.a) for c in marker.colors] == [tuple(c) for c in colours.tolist()]


def test_numbers_are_kept_bit_for_bit():
    points = np.array([[math.inf, -0.0], [math.nan, 5e-324], [-1.7e308, 1 / 3]])
    spliced = marker_array(some_marker(), points, NO_COLOURS)
    (marker,) = deserialize_message(spliced, MarkerArray).markers
    got = np.array([(point.x, point.y) for point in marker.points])
    assert got.tobytes() == points.tobytes()


def test_arrays_of_any_layout_will_do():
    points, colours = drawn(5)
    wanted = marker_array(some_marker(), points, colours)
    other = marker_array(
        some_marker(), np.asfortranarray(points), np.asfortranarray(colours.astype(np.float64)))
    assert deserialize_message(other, MarkerArray) == deserialize_message(wanted, MarkerArray)


@pytest.mark.parametrize('template, words', [
    (b'\x00\x01\x00\x00' + bytes(40), '00 01 00 00 .* 0 times'),
    (b'\x00\x01\x00\x00' + 2 * (bytes(8) + b'\x00\x00\x80\xfe' * 4), '2 times'),
    (b'\x00\x00\x00\x00' + bytes(8) + b'\x00\x00\x80\xfe' * 4, 'begins with 00 00 00 00'),
    (b'', '0 times'),
], ids=['no mark', 'two marks', 'big endian', 'nothing'])
def test_an_unknown_serialisation_is_refused(template, words):
    with pytest.raises(ValueError, match=words):
        splice(template, *drawn(1))


@given(st.binary(max_size=200), st.integers(0, 10**6))
def test_bytes_from_anywhere_are_read_or_refused(noise, seed):
    """Nothing but ValueError, and never a reservation of what the counts claim."""
    rng = np.random.default_rng(seed)
    whole = [
        tf_message(TransformStamped(child_frame_id='b'), TransformStamped(child_frame_id='cc')),
        grid_update('map', 1, 2, [[3, 4, 5]]),
    ]
    for data in whole:
        mutated = bytearray(data)
        for place in rng.integers(0, len(data), 3):
            mutated[place] = rng.integers(256)
        cut = bytes(mutated[:rng.integers(300)])
        for sent in (noise, b'\0\1\0\0' + noise, bytes(mutated), cut):
            for read in (read_transforms, read_grid_update):
                try:
                    read(sent)
                except ValueError:
                    pass


def test_a_plan_that_was_serialised_is_put_into_its_event_as_it_is():
    rows = np.cumsum(np.random.default_rng(3).normal(size=(40, 3)), axis=0)
    header = Header(frame_id='map')
    path = path_to_ros(rows, pose_to_ros(1.0, 2.0), pose_to_ros(3.0, 4.0), header)
    info = ServiceEventInfo(event_type=2, sequence_number=7)
    event = GetPlan.Event(info=info, response=[GetPlan.Response(plan=path)])
    found = plan_event_bytes(event, serialize_message(path))
    assert deserialize_message(found, GetPlan.Event) == event
    assert len(found) == len(serialize_message(event))


def test_poses_that_are_made_fast_are_those_of_the_constructors():
    rows = np.cumsum(np.random.default_rng(4).normal(size=(50, 3)), axis=0)
    header = Header(frame_id='map')
    slow = [PoseStamped(header=header, pose=pose_to_ros(*row)) for row in rows.tolist()]
    fast = stamped_poses(rows, header)
    assert fast == slow
    assert repr(fast) == repr(slow)
    for one, other in zip(fast, slow, strict=True):
        assert bytes(serialize_message(one)) == bytes(serialize_message(other))
    fast[0].pose.position.x = 9.0
    assert fast[1].pose.position.x != 9.0


def test_a_map_is_a_view_into_the_bytes_it_came_in():
    values = np.arange(-1, 29, dtype=np.int8).reshape(5, 6)
    message = occupancy_to_ros(values, 0.5, (1.0, 2.0, 0.0), Header(frame_id='größer'))
    data = bytes(serialize_message(message))
    assert (grid_cells(message, data) == values).all()
    assert grid_cells(message, data[:-4]) is None
    again = deserialize_message(grid_bytes(message, values[::-1]), OccupancyGrid)
    assert (np.array(again.data).reshape(5, 6) == values[::-1]).all()
