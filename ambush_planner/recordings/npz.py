"""Arrays in the attachments of recordings: all checked before any of them takes memory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from io import BytesIO
from zipfile import ZipFile, ZipInfo

import numpy as np

# Sizes by name of the dimensions of an array; the same name stands for the same number.
Shape = tuple[str | int, ...]

_LOCAL_HEADER, _CENTRAL_HEADER, _END = 30, 46, 22


class BadAttachment(ValueError):
    """The bytes of an attachment are not what they should be; the text says why."""


def packed(arrays: Mapping[str, object]) -> bytes:
    """Return the arrays as an npz file (``numpy.load`` reads it)."""
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def unpacked(
    data: bytes, file: str, expected: Mapping[str, tuple[type, Shape]], most: int
) -> dict[str, np.ndarray]:
    """Return the arrays in the bytes of a ``file``.

    Parameters
    ----------
    data, file
        The bytes, and how they are called in error messages.
    expected
        Type and shape of each array that there must be.
    most
        Bytes that all may take together.

    Raises
    ------
    BadAttachment
        The bytes are damaged, hold more than these arrays, or others.
    """
    try:
        with ZipFile(BytesIO(data)) as archive:
            _check(archive, data, file, expected, most)
        with np.load(BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except BadAttachment:
        raise
    except Exception as error:
        # zipfile, zlib and numpy raise a dozen kinds of errors at bytes that are not theirs.
        raise BadAttachment(f'{file} is damaged ({type(error).__name__})') from error


def _check(
    archive: ZipFile, data: bytes, file: str, expected: Mapping[str, tuple[type, Shape]], most: int
) -> None:
    entries = archive.infolist()
    size = sum(entry.file_size for entry in entries)
    if size > most:
        raise BadAttachment(f'{file} claims to hold {size} bytes, at most {most} can be')
    names = [entry.filename.removesuffix('.npy') for entry in entries]
    for name in sorted({*names, *expected}):
        if names.count(name) != (name in expected):
            raise BadAttachment(
                f'{file} has {names.count(name)} arrays {name[:60]!r}, not {int(name in expected)}'
            )
    sizes: dict[str, int] = {}
    for name, entry in zip(names, entries, strict=True):
        dtype, shape = expected[name]
        found, stated = _header(archive, entry)
        fits = len(stated) == len(shape) and all(
            number == (sizes.setdefault(each, number) if isinstance(each, str) else each)
            for each, number in zip(shape, stated, strict=True)
        )
        if not fits or found != np.dtype(dtype):
            raise BadAttachment(
                f'{name} must be of the shape {shape} and {np.dtype(dtype)}, got {stated} of '
                f'{found}'
            )
    if len(data) != _needed(archive, entries, data):
        raise BadAttachment(f'{file} holds bytes beside its arrays')


def _header(archive: ZipFile, entry: ZipInfo) -> tuple[np.dtype, tuple[int, ...]]:
    """What an array's header states, which must be that of the bytes behind it."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read = (np.lib.format.read_array_header_1_0 if version == (1, 0)
                else np.lib.format.read_array_header_2_0)
        shape, _, dtype = read(file)
        if math.prod(shape) * dtype.itemsize != entry.file_size - file.tell():
            raise BadAttachment(f'{entry.filename[:60]} has not as many bytes as its header states')
    return dtype, shape


def _needed(archive: ZipFile, entries: list[ZipInfo], data: bytes) -> int:
    """Bytes of an archive with these entries, and with nothing before, between or behind them."""
    needed = _END
    for entry in entries:
        name, extra = (
            int.from_bytes(data[entry.header_offset + k : entry.header_offset + k + 2], 'little')
            for k in (26, 28)
        )
        needed += _LOCAL_HEADER + name + extra + entry.compress_size
        needed += _CENTRAL_HEADER + name + len(entry.extra)
    return needed
