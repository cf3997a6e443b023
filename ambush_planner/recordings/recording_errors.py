"""The errors of the recording: each says which file or folder, why, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import AmbushPlannerError, shown


class _AtPath(AmbushPlannerError):
    """What went wrong at a file or folder.

    Attributes
    ----------
    path
        The file or folder.
    reason
        What is wrong, in the operating system's words where it was the one to refuse.
    """

    _said = ''

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(self._said.format(shown(path), reason))
        self.path = path
        self.reason = reason


class RecordingFailed(_AtPath):
    """A departure could not be recorded; planning is not affected, the next one tries again."""

    _said = 'recording failed at {}: {}'


class UnreadableRecording(_AtPath):
    """A file or folder is not a whole recording of a departure."""

    _said = '{} is not readable as a recording: {}'


@contextmanager
def recording_to(path: Path) -> Iterator[None]:
    """Turn an OSError met while writing ``path`` into RecordingFailed."""
    try:
        yield
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
    except OSError as error:
        raise UnreadableRecording(path, f'{error.strerror or error}') from error
