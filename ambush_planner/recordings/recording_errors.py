# SPDX-License-Identifier: Apache-2.0
"""Errors of recordings: each names the file or folder, the reason, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from ..arrays import MAX_BYTES
from ..errors import AmbushPlannerError, shown

_T = TypeVar('_T')


class _AtPath(AmbushPlannerError):
    """An error with a file or folder: its ``path``, and the ``reason`` in words."""

    _sentence = ''

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(self._sentence.format(shown(path), reason))
        self.path = path
        self.reason = reason


class RecordingFailed(_AtPath):
    """A departure could not be recorded. The departure itself is not affected."""

    _sentence = 'recording failed at {}: {}'


class UnreadableRecording(_AtPath):
    """A file or folder is not a whole recording of a departure, or a plan."""

    _sentence = '{} cannot be read as a recording or plan: {}'


class NoPermission(UnreadableRecording):
    """The user may not read the file, so nothing is known of it."""


@contextmanager
def recording_to(path: Path) -> Iterator[None]:
    """Turn an OSError met while writing ``path``, or a missing library, into RecordingFailed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise RecordingFailed(path, f'{error.name} is not installed; try: pip install '
                              'mcap-ros2-support, or set recording.enabled to false') from error
    except OSError as error:
        raise RecordingFailed(
            path,
            f'{error.strerror or error}; check that recording.directory is a folder '
            'that this user may write to, on a disk with space left',
        ) from error


@contextmanager
def reading_from(path: Path) -> Iterator[None]:
    """Turn an OSError met while reading ``path`` into UnreadableRecording."""
    try:
        yield
    except PermissionError as error:
        raise NoPermission(path, 'no permission; docs/operations.md says how several people share '
                           'a folder') from error
    except OSError as error:
        raise UnreadableRecording(path, f'{error.strerror or error}') from error


def bytes_in(path: Path) -> bytes:
    """Return the content of a file; raises UnreadableRecording."""
    with reading_from(path):
        if not (path.is_file() or path.is_dir()) and path.exists():  # a pipe would block
            raise UnreadableRecording(path, 'it is neither a file nor a folder')
        check_size(path, path.stat().st_size)
        return path.read_bytes()


def check_size(path: Path, size: int) -> None:
    """Raise UnreadableRecording if a file of this size [bytes] is too large to read."""
    if size > MAX_BYTES:
        raise UnreadableRecording(path, f'it would take {size:.3g} bytes of memory, the limit is '
                                  f'{MAX_BYTES:.3g}')


def part(path: Path, name: str, read: Callable[[], _T]) -> _T:
    """Read a part of a recording; the error names the part, and never its contents."""
    try:
        return read()
    except UnreadableRecording:
        raise
    except AmbushPlannerError as error:
        raise UnreadableRecording(path, f'{name}: {error}') from error
    except Exception as error:  # numpy, zipfile and the decoder raise a dozen kinds of errors
        raise UnreadableRecording(
            path, f'{name}: missing or malformed ({type(error).__name__})'
        ) from error
