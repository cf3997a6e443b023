# SPDX-License-Identifier: Apache-2.0
"""The attachment ``map_changes.npz``: cells that changed since a departure was planned."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import numpy.typing as npt

MAP_CHANGES_FILE = 'map_changes.npz'


def map_changes_file(before: npt.NDArray[np.int8], after: npt.NDArray[np.int8]) -> bytes:
    """Return the cells in which two maps (H, W) differ; no bytes if they are equal.

    An npz file: ``cells`` (K,) = row * W + column, and their ``values`` (K,) afterwards.
    """
    cells = np.flatnonzero(before.ravel() != after.ravel()).astype(np.int32)
    if not len(cells):
        return b''
    stream = BytesIO()
    np.savez_compressed(stream, cells=cells, values=after.ravel()[cells].astype(np.int8))
    return stream.getvalue()


def changed_map(before: npt.NDArray[np.int8], data: bytes) -> npt.NDArray[np.int8]:
    """Return the map (H, W) after the changes in the bytes of a ``map_changes.npz``."""
    after = before.ravel().copy()
    with np.load(BytesIO(data), allow_pickle=False) as content:
        after[content['cells']] = content['values']
    return after.reshape(before.shape)
