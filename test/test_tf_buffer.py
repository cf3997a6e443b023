"""Transforms that were told, against matrices and scipy's rotations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from ambush_planner.ros.tf_buffer import (
    HISTORY_NS,
    Found,
    Rigid,
    StampedTransform,
    TransformBuffer,
    TransformUnknown,
    between,
)

SECOND = 10**9
numbers = st.floats(-10.0, 10.0)


@st.composite
def rigids(draw):
    angles = [draw(st.floats(-math.pi, math.pi)) for _ in range(3)]
    rotation = Rotation.from_euler('xyz', angles).as_quat().tolist()
    return Rigid(tuple(draw(numbers) for _ in range(3)), tuple(rotation))


def matrix(rigid):
    result = np.eye(4)
    result[:3, :3] = Rotation.from_quat(rigid.rotation).as_matrix()
    result[:3, 3] = rigid.translation
    return result


def moved(x):
    return Rigid((float(x), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def buffer_of(*told, static=False):
    buffer = TransformBuffer()
    for parent, child, stamp, rigid in told:
        buffer.add(StampedTransform(parent, child, stamp, rigid), static)
    return buffer


@given(rigids(), rigids())
def test_motions_multiply_and_invert_as_matrices_do(one, other):
    np.testing.assert_allclose(matrix(one @ other), matrix(one) @ matrix(other), atol=1e-9)
    np.testing.assert_allclose(matrix(one.inverse()), np.linalg.inv(matrix(one)), atol=1e-9)


@given(rigids(), rigids(), st.floats(0.0, 1.0))
def test_between_is_a_line_and_slerp(one, other, share):
    found = between(one, other, share)
    ends = Rotation.from_quat([one.rotation, other.rotation])
    turn = ends[0].inv() * ends[1]
    if turn.magnitude() < math.pi - 1e-3:  # there are two ways to turn by half a circle
        wanted = Slerp([0.0, 1.0], ends)(share)
        off = (wanted.inv() * Rotation.from_quat(found.rotation)).magnitude()
        assert off < 1e-6
    line = np.add(one.translation, share * np.subtract(other.translation, one.translation))
    np.testing.assert_allclose(found.translation, line, atol=1e-9)


@settings(max_examples=50)
@given(st.lists(rigids(), min_size=1, max_size=8), st.data())
def test_a_tree_of_frames_gives_the_product_along_the_way(links, data):
    """Against matrices to the root, which know nothing of common ancestors."""
    buffer, to_root = TransformBuffer(), {'frame0': np.eye(4)}
    for k, link in enumerate(links, start=1):
        parent = f'frame{data.draw(st.integers(0, k - 1))}'
        buffer.add(StampedTransform(parent, f'frame{k}', 0, link), data.draw(st.booleans()))
        to_root[f'frame{k}'] = to_root[parent] @ matrix(link)
    names = st.sampled_from(sorted(to_root))
    source, target = data.draw(names), data.draw(names)
    wanted = np.linalg.inv(to_root[target]) @ to_root[source]
    np.testing.assert_allclose(matrix(buffer.lookup(target, source).rigid), wanted, atol=1e-6)


def test_the_latest_common_time_counts_and_the_rest_is_interpolated():
    buffer = buffer_of(
        ('map', 'odom', 1 * SECOND, moved(10)), ('map', 'odom', 3 * SECOND, moved(30)),
        ('odom', 'base', 0, moved(0)), ('odom', 'base', 2 * SECOND, moved(2)))
    found = buffer.lookup('map', 'base')
    assert found.stamp_ns == 2 * SECOND
    assert found.rigid.translation == pytest.approx((22.0, 0.0, 0.0))
    assert buffer.lookup('map', 'odom').rigid.translation[0] == 30.0
    at = buffer.lookup('map', 'odom', 1_500_000_000)
    assert at.rigid.translation[0] == pytest.approx(15.0)


def test_a_static_transform_has_no_time_and_holds_at_any():
    buffer = buffer_of(('map', 'depot', 5, moved(4)), static=True)
    assert buffer.lookup('map', 'depot') == Found(moved(4), None)
    buffer.add(StampedTransform('depot', 'base', 7 * SECOND, moved(1)), False)
    found = buffer.lookup('map', 'base')
    assert (found.stamp_ns, found.rigid.translation[0]) == (7 * SECOND, 5.0)


def test_times_that_do_not_overlap_are_an_error():
    buffer = buffer_of(('map', 'odom', 9 * SECOND, moved(1)), ('odom', 'base', 1, moved(1)))
    with pytest.raises(TransformUnknown, match='do not overlap'):
        buffer.lookup('map', 'base')
    with pytest.raises(TransformUnknown, match='do not overlap'):
        buffer.lookup('map', 'odom', 10 * SECOND)


@pytest.mark.parametrize('target, source, words', [
    ('map', 'nowhere', "'nowhere' does not exist"), ('elsewhere', 'map', "'elsewhere' does not"),
    ('map', 'moon', 'not in one tree'),
])
def test_frames_that_are_not_connected(target, source, words):
    buffer = buffer_of(('map', 'odom', 1, moved(1)), ('sky', 'moon', 1, moved(1)))
    with pytest.raises(TransformUnknown, match=words):
        buffer.lookup(target, source)


def test_a_loop_of_frames_is_an_error():
    buffer = buffer_of(('a', 'b', 1, moved(1)), ('b', 'a', 1, moved(1)), ('c', 'd', 1, moved(1)))
    with pytest.raises(TransformUnknown, match='loop'):
        buffer.lookup('c', 'a')


def test_what_is_older_than_the_history_is_forgotten():
    buffer = TransformBuffer()
    for k in range(30):
        buffer.add(StampedTransform('map', 'base', k * SECOND, moved(k)), False)
    oldest = 29 * SECOND - HISTORY_NS
    assert buffer.lookup('map', 'base', oldest).rigid.translation[0] == oldest / SECOND
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base', oldest - 1)
    buffer.add(StampedTransform('map', 'base', 0, moved(99)), False)
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base', 0)


def test_transforms_that_make_no_sense_are_ignored():
    buffer = buffer_of(('map', 'base', 1, moved(1)))
    for parent, child, rigid in (
            ('map', 'map', moved(2)), ('', 'base', moved(2)), ('map', '', moved(2)),
            ('map', 'base', moved(math.nan)), ('map', 'base', Rigid((2.0, 0, 0), (0, 0, 0, 0))),
            ('map', 'base', Rigid((2.0, 0, 0), (0, 0, 0, math.nan)))):
        buffer.add(StampedTransform(parent, child, 2, rigid), False)
    assert buffer.lookup('map', 'base').rigid == moved(1)


def test_another_parent_drops_the_history_and_a_leading_slash_is_none():
    buffer = buffer_of(('map', 'base', 5, moved(1)), ('/odom', '/base', 3, moved(2)))
    assert buffer.lookup('odom', 'base') == Found(moved(2), 3)
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base')


def test_clear_keeps_what_is_static():
    buffer = buffer_of(('map', 'depot', 0, moved(1)), static=True)
    buffer.add(StampedTransform('map', 'base', 1, moved(2)), False)
    buffer.clear()
    assert buffer.lookup('map', 'depot').rigid == moved(1)
    with pytest.raises(TransformUnknown):
        buffer.lookup('map', 'base')
