# SPDX-License-Identifier: Apache-2.0
"""Array types of the records, read-only copies, arrays of files, indices, sums, rounding."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from functools import reduce
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

try:
    from threadpoolctl import threadpool_limits
except ImportError:  # apt and rosdep lack it; the node's worker has one thread anyway
    threadpool_limits = None

FloatArray = npt.NDArray[np.float64]
IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Position = tuple[float, float]  # x, y [m]

# Maximum size of what is read from a file, unpacked [bytes]: a map of 10^8 cells and its losses.
MAX_BYTES = 1_200_000_000
# Relative rounding of sums and comparisons.
ROUNDING = 1e-9
# Site prices, flows and values below this share of the largest are rounding, and not counted.
NEGLIGIBLE = 1e-7


@contextmanager
def single_thread() -> Iterator[None]:
    """Let BLAS use one thread: the matrices are small, and more threads wait for each other."""
    with threadpool_limits(1, user_api='blas') if threadpool_limits else nullcontext():
        yield


def frozen_array(values: npt.ArrayLike, dtype: Any) -> npt.NDArray[Any]:
    """Return a read-only copy of ``values`` as ``dtype``, or the array itself if it is one."""
    if (isinstance(values, np.ndarray) and values.dtype == dtype and values.base is None
            and values.flags.c_contiguous and not values.flags.writeable):
        return values
    array = np.array(values, dtype=dtype, order='C')
    array.setflags(write=False)
    return array


def arrays_in(file: Path | BytesIO, names: Iterable[str]) -> dict[str, npt.NDArray[Any]]:
    """Read those of the named arrays that an npz file has, read-only; all others stay compressed.

    ValueError if they would take more than ``MAX_BYTES``; numpy raises others if the file is
    malformed.
    """
    # numpy leaves a file open that is no archive.
    with (file if isinstance(file, BytesIO) else file.open('rb') as stream,
          np.load(stream, allow_pickle=False) as archive):
        found = [name for name in names if name in archive]
        size = sum(archive.zip.getinfo(f'{name}.npy').file_size for name in found)
        if size > MAX_BYTES:
            raise ValueError(f'its arrays would take {size:.3g} bytes, the limit is {MAX_BYTES}')
        arrays = {name: archive[name] for name in found}
    for each in arrays.values():
        each.setflags(write=False)  # so that records take them without a copy
    return arrays


def sums(index: IndexArray, values: FloatArray, count: int) -> FloatArray:
    """Sum ``values`` (K,) by ``index`` (K,): (count,)."""
    return np.asarray(np.bincount(index, weights=values, minlength=count), dtype=np.float64)


def pooled(function: np.ufunc, cells: npt.NDArray[Any], block: int) -> npt.NDArray[Any]:
    """Reduce each block of ``block`` cells a side (H, W), by np.maximum or another such function.

    Reducing equal values must give them again: the last cells are repeated where blocks end beyond
    them.
    """
    margins = [(0, -size % block) for size in cells.shape]
    padded = np.pad(cells, margins, 'edge') if np.any(margins) else cells
    # By whole rows, then columns: ten times as fast as over two axes.
    rows = reduce(function, [padded[k::block] for k in range(block)])
    return np.asarray(reduce(function, [rows[:, k::block] for k in range(block)]))


def members(count: IndexArray) -> tuple[IndexArray, IndexArray]:
    """The group (K,) of each member of groups with ``count`` (G,) members, and its number in it."""
    of = np.repeat(np.arange(len(count)), count)
    return of, np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)


def found_in(keys: IndexArray, wanted: IndexArray) -> IndexArray:
    """Return the positions of wanted numbers (K,) among different keys (N,); -1: absent."""
    order = np.append(np.argsort(keys, kind='stable'), -1)
    return order[found_in_sorted(keys[order[:-1]], wanted)]


def found_in_sorted(keys: IndexArray, wanted: IndexArray) -> IndexArray:
    """Return the positions of wanted numbers (K,) among sorted different keys (N,); -1: absent."""
    if not len(keys):
        return np.full(wanted.shape, -1)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1)
