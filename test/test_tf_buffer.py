# SPDX-License-Identifier: Apache-2.0
"""The transform buffer, against matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ambush_planner.maps.tf_buffer import (
    StampedTransform,
    TransformBuffer,
    TransformUnknown,
    rigid_motion,
)

IDENTITY = (0.0, 0.0, 0.0, 1.0)
numbers = st.floats(-10.0, 10.0)


@st.composite
def motions(draw):
    """A translation and a quaternion."""
    angles = [draw(st.floats(-math.pi, math.pi)) for _ in range(3)]
    quaternion = Rotation.from_euler('xyz', angles).as_quat().tolist()
    return tuple(draw(numbers) for _ in range(3)), tuple(quaternion)


def buffer_of(*transforms):
    """Motions along x: parent, child, time (None: static), metres."""
    buffer = TransformBuffer()
    for parent, child, stamp, x in transforms:
        buffer.add(StampedTransform(parent, child, stamp, (float(x), 0.0, 0.0), IDENTITY))
    return buffer


def found_in(buffer, target, source):
    """The time and x of a motion along x."""
    found = buffer.lookup(target, source)
    assert (found.matrix[:3, :3] == np.eye(3)).all()
    return found.stamp_ns, found.matrix[0, 3]


@settings(max_examples=50)
@given(st.lists(motions(), min_size=1, max_size=8), st.data())
def test_a_tree_of_frames_gives_the_product_along_the_way(links, data):
    """Against matrices to the root, without common ancestors."""
    buffer, to_root = TransformBuffer(), {'frame0': np.eye(4)}
    for k, motion in enumerate(links, start=1):
        parent = f'frame{data.draw(st.integers(0, k - 1))}'
        stamp = data.draw(st.sampled_from([None, 0]))
        buffer.add(StampedTransform(parent, f'frame{k}', stamp, *motion))
        to_root[f'frame{k}'] = to_root[parent] @ rigid_motion(*motion)
    names = st.sampled_from(sorted(to_root))
    source, target = data.draw(names), data.draw(names)
    wanted = np.linalg.inv(to_root[target]) @ to_root[source]
    np.testing.assert_allclose(buffer.lookup(target, source).matrix, wanted, atol=1e-6)


def test_a_quaternion_turns_as_in_ros_and_is_normalised():
    half = (0.0, 0.0, 0.9 * math.sin(0.25), 0.9 * math.cos(0.25))
    ahead = rigid_motion((1.0, 2.0, 3.0), half) @ (1.0, 0.0, 0.0, 1.0)
    assert ahead == pytest.approx((1.0 + math.cos(0.5), 2.0 + math.sin(0.5), 3.0, 1.0))


@pytest.mark.parametrize(('transforms', 'wanted'), [
    # The newest of each link, and the time of the oldest of these.
    ([('map', 'odom', 1, 10), ('map', 'odom', 3, 30), ('odom', 'base', 2, 2)], (2, 32.0)),
    ([('odom', 'base', 2, 2), ('odom', 'base', 1, 1), ('map', 'odom', 9, 5)], (2, 7.0)),
    ([('map', 'base', 1, 1), ('map', 'base', 1, 5)], (1, 5.0)),  # the last of a time
    # Static ones have no time.
    ([('map', 'odom', None, 4), ('odom', 'base', 7, 1)], (7, 5.0)),
    ([('map', 'odom', None, 4), ('odom', 'base', None, 1)], (None, 5.0)),
    ([('map', 'base', 7, 4), ('map', 'base', None, 1)], (None, 1.0)),
    # A new parent counts, whatever its time.
    ([('odom', 'base', 5, 1), ('/map', '/base', 3, 2)], (3, 2.0)),
    # Not two frames, or no number.
    ([('map', 'base', 1, 1), ('map', 'map', 2, 2), ('', 'base', 2, 2), ('map', '', 2, 2),
      ('map', 'base', 2, math.nan)], (1, 1.0)),
])
def test_which_transforms_count(transforms, wanted):
    assert found_in(buffer_of(*transforms), 'map', 'base') == wanted


@pytest.mark.parametrize(('stamps', 'latest', 'wanted'), [
    ([50, 8, 9], 10, 9),  # one by a clock that is fast does not shut out right ones
    ([8, 9, 50], 10, 9), ([50, 8, 51, 9, 52], 10, 9),  # nor a publisher with wrong stamps
    ([9, 8], 10, 9), ([50, 40], 10, 50),  # nothing else is known: the caller names it
    ([50, *range(1, 11)], math.inf, 10),  # without a clock: once enough others have come
])
def test_stamps_ahead_of_the_clock_shut_out_nothing(stamps, latest, wanted):
    buffer = buffer_of(*(('map', 'base', stamp, stamp) for stamp in stamps))
    found = buffer.lookup('map', 'base', latest)
    assert (found.stamp_ns, found.newest_ns, found.matrix[0, 3]) == (wanted, wanted, wanted)


def test_invalid_quaternions_are_ignored():
    buffer = buffer_of(('map', 'base', 1, 1))
    for quaternion in ((0.0,) * 4, (0.0, 0.0, 0.0, math.nan)):
        buffer.add(StampedTransform('map', 'base', 2, (2.0, 0.0, 0.0), quaternion))
    assert found_in(buffer, 'map', 'base') == (1, 1.0)


def test_only_static_transforms_outlive_a_clear():
    buffer = buffer_of(('map', 'depot', None, 4), ('depot', 'base', 7, 1))
    buffer.clear()
    assert found_in(buffer, 'map', 'depot') == (None, 4.0)
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base')


@pytest.mark.parametrize('target, source, words', [
    ('map', 'nowhere', "'nowhere' does not exist"), ('elsewhere', 'map', "'elsewhere' does not"),
    ('map', 'moon', 'no transforms connect'), ('map', 'a', 'loop'),
])
def test_frames_that_are_not_connected(target, source, words):
    buffer = buffer_of(
        ('map', 'odom', 1, 1), ('sky', 'moon', 1, 1), ('a', 'b', 1, 1), ('b', 'a', 1, 1))
    with pytest.raises(TransformUnknown, match=words):
        buffer.lookup(target, source)
