"""The attachment ``map_changes.npz``: how the ground had changed since a departure was planned."""

from __future__ import annotations

from io import BytesIO
from zipfile import ZipFile

import numpy as np
import numpy.typing as npt

MAP_CHANGES_FILE = 'map_changes.npz'
_DTYPES = {'cells': np.dtype(np.int32), 'values': np.dtype(np.int8)}
# What numpy writes before an array.
_HEADER = 128


class BadMapChanges(ValueError):
    """The bytes are no changes of the map; the text says why."""


def map_changes_file(before: npt.NDArray[np.int8], after: npt.NDArray[np.int8]) -> bytes:
    """Return the cells in which two maps (H, W) differ; no bytes where they do not.

    An npz file: ``cells`` (K,) = row * W + column, rising, and their ``values`` (K,) afterwards.
    """
    cells = np.flatnonzero(before.ravel() != after.ravel()).astype(np.int32)
    if not len(cells):
        return b''
    stream = BytesIO()
    np.savez_compressed(stream, cells=cells, values=after.ravel()[cells].astype(np.int8))
    return stream.getvalue()


def changed_map(before: npt.NDArray[np.int8], data: bytes) -> npt.NDArray[np.int8]:
    """Return the map (H, W) after the changes in the bytes of a ``map_changes.npz``.

    Raises
    ------
    BadMapChanges
        They are no changes of this map.
    """
    try:
        cells, values = _arrays(data, before.size)
    except BadMapChanges:
        raise
    except Exception as error:
        # zipfile, zlib and numpy raise a dozen kinds of errors at bytes that are not theirs.
        raise BadMapChanges(f'{MAP_CHANGES_FILE} is damaged ({type(error).__name__})') from error
    rising = len(cells) > 0 and bool((np.diff(cells) > 0).all())
    if not rising or cells[0] < 0 or cells[-1] >= before.size:
        raise BadMapChanges('the changed cells are not in rising order on the map')
    after = before.ravel().copy()
    if (after[cells] == values).any():
        raise BadMapChanges('a cell that has not changed stands among those that have')
    after[cells] = values
    return after.reshape(before.shape)


def _arrays(data: bytes, most: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int8]]:
    """Cells and values, their sizes checked before they take memory."""
    with ZipFile(BytesIO(data)) as archive:
        entries = archive.infolist()
        if sorted(each.filename for each in entries) != [f'{name}.npy' for name in _DTYPES]:
            raise BadMapChanges(f'{MAP_CHANGES_FILE} has not just the arrays cells and values')
        sizes = {each.filename: each.file_size for each in entries}
        for name, dtype in _DTYPES.items():
            if sizes[f'{name}.npy'] > _HEADER + most * dtype.itemsize:
                raise BadMapChanges(f'{MAP_CHANGES_FILE} claims more cells than the map has')
    with np.load(BytesIO(data), allow_pickle=False) as archive:
        cells, values = archive['cells'], archive['values']
    if cells.shape != values.shape or cells.ndim != 1:
        raise BadMapChanges('cells and values must be lists of one length')
    if (cells.dtype, values.dtype) != (_DTYPES['cells'], _DTYPES['values']):
        raise BadMapChanges('cells and values are of other types')
    return cells, values
