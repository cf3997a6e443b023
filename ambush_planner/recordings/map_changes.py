"""The attachment ``map_changes.npz``: how the ground had changed since a departure was planned."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .npz import BadAttachment, packed, unpacked

MAP_CHANGES_FILE = 'map_changes.npz'
# What numpy writes before an array, and a cell with its value take [bytes].
_HEADER, _CELL = 128, 5


def map_changes_file(before: npt.NDArray[np.int8], after: npt.NDArray[np.int8]) -> bytes:
    """Return the cells in which two maps (H, W) differ; no bytes where they do not.

    An npz file: ``cells`` (K,) = row * W + column, rising, and their ``values`` (K,) afterwards.
    """
    cells = np.flatnonzero(before.ravel() != after.ravel()).astype(np.int32)
    if not len(cells):
        return b''
    return packed({'cells': cells, 'values': after.ravel()[cells].astype(np.int8)})


def changed_map(before: npt.NDArray[np.int8], data: bytes) -> npt.NDArray[np.int8]:
    """Return the map (H, W) after the changes in the bytes of a ``map_changes.npz``.

    Raises
    ------
    BadAttachment
        They are not changes of this map.
    """
    expected = {'cells': (np.int32, ('cells',)), 'values': (np.int8, ('cells',))}
    content = unpacked(data, MAP_CHANGES_FILE, expected, 2 * _HEADER + _CELL * before.size)
    cells, values = content['cells'], content['values']
    rising = len(cells) > 0 and bool((np.diff(cells) > 0).all())
    if not rising or cells[0] < 0 or cells[-1] >= before.size:
        raise BadAttachment('the changed cells are not in rising order on the map')
    after = before.ravel().copy()
    if (after[cells] == values).any():
        raise BadAttachment('a cell that has not changed stands among those that have')
    after[cells] = values
    return after.reshape(before.shape)
