# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: round trips, exactness, and what is refused."""

import math

import numpy as np
import pytest
from bad_maps import BAD_MAPS
from games import examples
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from ros_harness import FRAME, header

from ambush_planner.errors import InvalidRiskMap
from ambush_planner.maps.ros_messages import occupancy_from_ros, path_from_ros, pose_from_ros
from ambush_planner.ros.conversions import occupancy_to_ros, path_to_ros, pose_to_ros

coordinates = st.floats(-1e6, 1e6)


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


@pytest.mark.parametrize('name', BAD_MAPS)
def test_bad_map_is_refused_by_name_and_number(name):
    message, words = BAD_MAPS[name]
    with pytest.raises(InvalidRiskMap, match=words):
        occupancy_from_ros(message)
