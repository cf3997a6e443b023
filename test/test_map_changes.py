"""The cells in which a map has changed: written and read back, and malformed files."""

import re
from io import BytesIO
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from ambush_planner.recordings.map_changes import changed_map, map_changes_file
from ambush_planner.recordings.npz import BadAttachment

BEFORE = np.arange(12, dtype=np.int8).reshape(3, 4)


def packed(**content):
    stream = BytesIO()
    np.savez_compressed(stream, **content)
    return stream.getvalue()


def changes(cells, values, cell_type=np.int32, value_type=np.int8):
    return packed(cells=np.array(cells, cell_type), values=np.array(values, value_type))


@given(st.data())
def test_changes_lead_from_the_one_map_to_the_other(data):
    shape = data.draw(array_shapes(min_dims=2, max_dims=2, max_side=8))
    before, after = (
        data.draw(arrays(np.int8, shape, elements=st.integers(-1, 3))) for _ in range(2)
    )
    made, kept = map_changes_file(before, after), before.copy()
    if np.array_equal(before, after):
        assert made == b''
    else:
        assert np.array_equal(changed_map(before, made), after)
    assert np.array_equal(before, kept)


def test_nine_cells_of_a_large_map_take_no_room():
    before = np.random.default_rng(1).integers(0, 60, (1000, 1000), dtype=np.int8)
    after = before.copy()
    after[500:503, 300:303] = 100
    assert len(map_changes_file(before, after)) < 1000


@pytest.mark.parametrize('data, words', [
    (b'', 'is damaged (BadZipFile)'),
    (b'PK\3\4nothing', 'is damaged'),
    (changes([1], [5])[:-30], 'is damaged'),
    (packed(cells=np.array([1], np.int32)), "has 0 arrays 'values', not 1"),
    (packed(cells=np.array([1], np.int32), values=np.array([5], np.int8), more=np.zeros(1)),
     'claims to hold 397 bytes, at most 316'),
    (changes([], []), 'rising order'),
    (changes([2, 1], [9, 9]), 'rising order'),
    (changes([1, 1], [9, 9]), 'rising order'),
    (changes([-1], [9]), 'rising order'),
    (changes([12], [9]), 'rising order'),
    (changes([1], [1]), 'has not changed'),
    (changes([1, 2], [9]), 'values must be of the shape'),
    (changes([[1]], [[9]]), 'cells must be of the shape'),
    (changes([1], [9], cell_type=np.int64), 'int32, got (1,) of int64'),
    (changes([1], [9], value_type=np.uint8), 'int8, got (1,) of uint8'),
    (packed(cells=np.array([None]), values=np.array([5], np.int8)), 'claims to hold'),
])
def test_bytes_that_are_no_changes_of_this_map(data, words):
    with pytest.raises(BadAttachment, match=re.escape(words)):
        changed_map(BEFORE, data)


def test_a_claim_of_more_cells_than_the_map_has_takes_no_memory():
    stream = BytesIO()
    with ZipFile(stream, 'w', ZIP_DEFLATED) as archive:
        for name in ('cells', 'values'):
            archive.writestr(f'{name}.npy', bytes(10**7))
    with pytest.raises(BadAttachment, match='claims to hold 20000000 bytes'):
        changed_map(BEFORE, stream.getvalue())
