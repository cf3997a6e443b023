"""The transform buffer, against matrices."""

import itertools
import math

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.duration import Duration
from rclpy.time import Time
from scipy.spatial.transform import Rotation

from ambush_planner.maps.tf_buffer import (
    HISTORY_NS,
    StampedTransform,
    TransformBuffer,
    TransformUnknown,
)

SECOND = 10**9
IDENTITY = (0.0, 0.0, 0.0, 1.0)
numbers = st.floats(-10.0, 10.0)


@st.composite
def motions(draw):
    """A translation and a quaternion."""
    angles = [draw(st.floats(-math.pi, math.pi)) for _ in range(3)]
    quaternion = Rotation.from_euler('xyz', angles).as_quat().tolist()
    return tuple(draw(numbers) for _ in range(3)), tuple(quaternion)


def matrix(rigid):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rigid.rotation.as_matrix(), rigid.translation
    return result


def along_x(parent, child, stamp, x):
    return StampedTransform(parent, child, stamp, (float(x), 0.0, 0.0), IDENTITY)


def buffer_of(*transforms, static=False):
    buffer = TransformBuffer()
    for each in transforms:
        buffer.add(along_x(*each), static)
    return buffer


def x_of(found):
    assert found.rigid.rotation.magnitude() == 0.0
    return found.rigid.translation[0]


@settings(max_examples=50)
@given(st.lists(motions(), min_size=1, max_size=8), st.data())
def test_a_tree_of_frames_gives_the_product_along_the_way(links, data):
    """Against matrices to the root, without common ancestors."""
    buffer, to_root = TransformBuffer(), {'frame0': np.eye(4)}
    for k, motion in enumerate(links, start=1):
        parent = f'frame{data.draw(st.integers(0, k - 1))}'
        transform = StampedTransform(parent, f'frame{k}', 0, *motion)
        buffer.add(transform, data.draw(st.booleans()))
        to_root[f'frame{k}'] = to_root[parent] @ matrix(transform.rigid)
    names = st.sampled_from(sorted(to_root))
    source, target = data.draw(names), data.draw(names)
    wanted = np.linalg.inv(to_root[target]) @ to_root[source]
    np.testing.assert_allclose(matrix(buffer.lookup(target, source).rigid), wanted, atol=1e-6)


def test_positions_and_orientations_are_interpolated():
    buffer = TransformBuffer()
    for stamp, yaw in ((0, 0.2), (10, 1.2)):
        quaternion = tuple(Rotation.from_euler('z', yaw).as_quat().tolist())
        buffer.add(StampedTransform('map', 'base', stamp, (stamp, -stamp, 0.0), quaternion), False)
    found = buffer.lookup('map', 'base', 3).rigid
    assert found.translation == pytest.approx((3.0, -3.0, 0.0))
    assert found.rotation.as_euler('xyz') == pytest.approx((0.0, 0.0, 0.5))


def test_the_latest_common_time_counts():
    buffer = buffer_of(('map', 'odom', 1 * SECOND, 10), ('map', 'odom', 3 * SECOND, 30),
                       ('odom', 'base', 0, 0), ('odom', 'base', 2 * SECOND, 2))
    found = buffer.lookup('map', 'base')
    assert (found.stamp_ns, x_of(found)) == (2 * SECOND, pytest.approx(22.0))
    assert x_of(buffer.lookup('map', 'odom')) == 30.0


def test_a_static_transform_has_no_time_and_holds_at_any():
    buffer = buffer_of(('map', 'depot', 5, 4), static=True)
    found = buffer.lookup('map', 'depot')
    assert (found.stamp_ns, x_of(found)) == (None, 4)
    buffer.add(along_x('depot', 'base', 7 * SECOND, 1), False)
    found = buffer.lookup('map', 'base')
    assert (found.stamp_ns, x_of(found)) == (7 * SECOND, 5.0)
    buffer.clear()
    assert x_of(buffer.lookup('map', 'depot')) == 4
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base')


def test_times_that_do_not_overlap_are_an_error():
    buffer = buffer_of(('map', 'odom', 9 * SECOND, 1), ('odom', 'base', 1, 1))
    with pytest.raises(TransformUnknown, match='do not overlap'):
        buffer.lookup('map', 'base')
    with pytest.raises(TransformUnknown, match='do not overlap'):
        buffer.lookup('map', 'odom', 10 * SECOND)


@pytest.mark.parametrize('target, source, words', [
    ('map', 'nowhere', "'nowhere' does not exist"), ('elsewhere', 'map', "'elsewhere' does not"),
    ('map', 'moon', 'no transforms connect'), ('map', 'a', 'loop'),
])
def test_frames_that_are_not_connected(target, source, words):
    buffer = buffer_of(
        ('map', 'odom', 1, 1), ('sky', 'moon', 1, 1), ('a', 'b', 1, 1), ('b', 'a', 1, 1))
    with pytest.raises(TransformUnknown, match=words):
        buffer.lookup(target, source)


def test_transforms_older_than_the_history_are_dropped():
    buffer = buffer_of(*(('map', 'base', k * SECOND, k) for k in range(30)))
    oldest = 28 * SECOND - HISTORY_NS  # of the last but one, as in tf2
    assert x_of(buffer.lookup('map', 'base', oldest)) == oldest / SECOND
    buffer.add(along_x('map', 'base', 0, 99), False)
    for stamp in (oldest - 1, 0):
        with pytest.raises(TransformUnknown):
            buffer.lookup('map', 'base', stamp)


def test_invalid_transforms_are_ignored():
    buffer = buffer_of(('map', 'base', 1, 1), ('map', 'map', 2, 2), ('', 'base', 2, 2),
                       ('map', '', 2, 2), ('map', 'base', 2, math.nan))
    for quaternion in ((0.0,) * 4, (0.0, 0.0, 0.0, math.nan)):
        buffer.add(StampedTransform('map', 'base', 2, (2.0, 0.0, 0.0), quaternion), False)
    assert x_of(buffer.lookup('map', 'base')) == 1


def test_quaternions_are_normalised_and_the_last_transform_of_a_time_counts():
    buffer = buffer_of(('map', 'base', 1, 1), ('map', 'base', 1, 5))
    assert x_of(buffer.lookup('map', 'base')) == 5
    half = (0.0, 0.0, 0.9 * math.sin(0.25), 0.9 * math.cos(0.25))
    buffer.add(StampedTransform('map', 'base', 2, (2.0, 0.0, 0.0), half), False)
    assert buffer.lookup('map', 'base').rigid.rotation.as_rotvec()[2] == pytest.approx(0.5)
    assert x_of(buffer.lookup('nowhere', 'nowhere')) == 0.0


@st.composite
def histories(draw):
    """Transforms of a tree of frames; if times repeat, only that of the latest of all."""
    found, repeated = [], draw(st.booleans())
    for k in range(1, draw(st.integers(2, 6))):
        parent, static = f'frame{draw(st.integers(0, k - 1))}', draw(st.booleans())
        stamps = draw(st.lists(st.integers(1, 15 * SECOND), min_size=1, max_size=5, unique=True))
        for stamp in [*stamps, *[16 * SECOND] * 2 * repeated]:
            translation, quaternion = draw(motions())
            scaled = tuple(draw(st.floats(0.5, 2.0)) * part for part in quaternion)
            each = StampedTransform(parent, f'frame{k}', stamp, translation, scaled)
            found.append((each, static))
    return found


@settings(max_examples=150)
@given(histories())
def test_lookups_agree_with_tf2(history):
    tf2 = pytest.importorskip('tf2_py')
    ours, theirs = TransformBuffer(), tf2.BufferCore(Duration(nanoseconds=HISTORY_NS))
    for each, static in history:
        ours.add(each, static)
        (x, y, z), (qx, qy, qz, qw) = each.translation, each.quaternion
        message = TransformStamped(child_frame_id=each.child)
        message.header.frame_id = each.parent
        message.header.stamp = Time(nanoseconds=each.stamp_ns).to_msg()
        message.transform.translation = Vector3(x=x, y=y, z=z)
        message.transform.rotation = Quaternion(x=qx, y=qy, z=qz, w=qw)
        (theirs.set_transform_static if static else theirs.set_transform)(message, 'test')
    frames = sorted({name for each, _ in history for name in (each.parent, each.child)})
    for target, source in itertools.product([*frames, 'nowhere'], repeat=2):
        try:
            wanted = theirs.lookup_transform_core(target, source, Time()).transform
        except tf2.TransformException:
            with pytest.raises(TransformUnknown):
                ours.lookup(target, source)
            continue
        found, p, q = ours.lookup(target, source).rigid, wanted.translation, wanted.rotation
        np.testing.assert_allclose(found.translation, (p.x, p.y, p.z), atol=1e-6)
        turned = found.rotation * Rotation.from_quat((q.x, q.y, q.z, q.w)).inv()
        assert turned.magnitude() < 1e-6


def test_another_parent_drops_the_history_and_a_leading_slash_is_ignored():
    buffer = buffer_of(('map', 'base', 5, 1), ('/odom', '/base', 3, 2))
    found = buffer.lookup('odom', 'base')
    assert (found.stamp_ns, x_of(found)) == (3, 2)
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base')
