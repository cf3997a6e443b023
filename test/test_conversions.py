# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: round trips, exactness, what is refused, messages from arrays."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from games import examples
from geometry_msgs.msg import Point, PoseStamped, Vector3
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message, serialize_message
from ros_harness import FRAME, header, risk_grid
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.errors import InvalidRiskMap
from ambush_planner.maps.ros_messages import occupancy_from_ros, path_from_ros, pose_from_ros
from ambush_planner.recordings import cdr
from ambush_planner.ros.conversions import SentPath, occupancy_to_ros, pose_to_ros, row_of
from ambush_planner.ros.trip import Trip

coordinates = st.floats(-1e6, 1e6)
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
    start, goal = pose_to_ros(0.1, 0.2, 3.0), pose_to_ros(9.9, 9.9, -2.0)
    start.position.z, goal.position.z = 1.5, 2.5
    trip = SimpleNamespace(map=SimpleNamespace(frame=FRAME), start_pose=SimpleNamespace(pose=start),
                           goal_pose=SimpleNamespace(pose=goal))
    rows = np.array([[0.1, 0.2, 0.0], [3.0, 0.2, 0.5], [7.3, 0.4, 0.5]])
    for first in (0, 2):  # a robot at the goal gets a path of one pose
        path = over_the_wire(Trip.path(trip, rows[first:], 5).message)
        assert first == 2 or path.poses[0].pose == start
        assert row_of(path.poses[-1].pose) == [7.3, 0.4, *row_of(goal)[2:]]
        assert {stamped.header.frame_id for stamped in path.poses} == {FRAME}
    np.testing.assert_allclose(path_from_ros(Trip.path(trip, rows, 5).message),
                               [[0.1, 0.2, 3.0], rows[1], [7.3, 0.4, -2.0]], rtol=0, atol=1e-15)


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


# Messages from whole arrays are those that rclpy writes, to the last byte of their length.


TYPES = {cdr.pose_stamped: PoseStamped, cdr.path: PathMessage, cdr.occupancy_grid: OccupancyGrid,
         cdr.marker_array: MarkerArray}
FRAMES = st.text(max_size=9).filter(lambda text: '\0' not in text)  # all paddings


def read(write, *arguments):
    """The message of rclpy that is written; its bytes have the length of rclpy's own."""
    data = write(*arguments)
    message = deserialize_message(data, TYPES[write])
    # The padding's content may differ, its length may not.
    assert len(data) == len(serialize_message(message))
    return message


@examples(30)
@given(FRAMES, st.integers(0, 2**31 * 10**9 - 1), st.integers(0, 4))
def test_poses_paths_and_grids_of_arrays(frame, stamp_ns, count):
    rng = np.random.default_rng(count)
    poses = rng.normal(scale=1e4, size=(count + 1, 7))
    sec, nanosec = divmod(stamp_ns, 10**9)
    header = Header(frame_id=frame, stamp=Time(sec=sec, nanosec=nanosec))
    stamped = read(cdr.pose_stamped, frame, stamp_ns, poses[0])
    assert (stamped.header, row_of(stamped.pose)) == (header, poses[0].tolist())
    path = read(cdr.path, frame, stamp_ns, poses[:count])
    assert path.header == header and all(each.header == header for each in path.poses)
    assert [row_of(each.pose) for each in path.poses] == poses[:count].tolist()
    assert SentPath(frame, stamp_ns, poses[:count]).message == path
    cells = rng.integers(-1, 101, (3, count + 1), dtype=np.int8)
    grid = read(cdr.occupancy_grid, frame, stamp_ns, cells, 0.25, poses[0])
    assert (grid.header, grid.info.map_load_time) == (header, header.stamp)
    assert row_of(grid.info.origin) == poses[0].tolist() and grid.info.resolution == 0.25
    assert np.array_equal(occupancy_cells(grid), cells)


def occupancy_cells(grid):
    return np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)


# All lengths modulo 8, and so all paddings before the points.
@pytest.mark.parametrize('namespace', ['abcdefg'[:length] for length in range(8)])
@pytest.mark.parametrize('frame', ['', 'map', 'karte_süd'])
def test_markers_of_arrays(frame, namespace):
    for count in (0, 1, 2, 300):
        rng = np.random.default_rng(count)
        points = rng.normal(scale=1e4, size=(count, 2))
        for colours in (rng.random((count, 4), dtype=np.float32), np.empty((0, 4), np.float32)):
            (found,) = read(cdr.marker_array, frame, 5 * 10**9 + 6, namespace, cdr.LINE_LIST, -2.5,
                            (0.1, 0.2, 0.3), (0.5, 0.25, 0.125, 1.0), points, colours).markers
            plain = Marker(
                header=Header(frame_id=frame, stamp=Time(sec=5, nanosec=6)), ns=namespace,
                type=Marker.LINE_LIST, action=Marker.ADD if count else Marker.DELETE,
                scale=Vector3(x=0.1, y=0.2, z=0.3),
                color=ColorRGBA(r=0.5, g=0.25, b=0.125, a=1.0),
                points=[Point(x=x, y=y) for x, y in points.tolist()],
                colors=[ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()])
            plain.pose.position.z, plain.pose.orientation.w = -2.5, 1.0
            assert found == plain


def test_numbers_are_kept_bit_for_bit_in_any_memory_layout():
    points = np.array([[math.inf, -0.0], [math.nan, 5e-324], [-1.7e308, 1 / 3]])
    for array in (points, np.asfortranarray(points)):
        (marker,) = read(cdr.marker_array, 'map', 0, 'a', cdr.SPHERE_LIST, 0.0, (0.0,) * 3,
                         (0.0,) * 4, array, np.empty((0, 4), np.float32)).markers
        found = np.array([(point.x, point.y) for point in marker.points])
        assert found.tobytes() == points.tobytes()
