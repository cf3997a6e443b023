"""The errors of the recording: each says which file or folder, why, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import AmbushPlannerError, shown


class RecordingFailed(AmbushPlannerError):
    """A departure could not be recorded; planning is not affected, the next one tries again.

    Attributes
    ----------
    path
        The file or folder that could not be read or written.
    reason
        Why, in the operating system's words where it was the one to refuse.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f'recording failed at {shown(path)}: {reason}')
        self.path = path
        self.reason = reason


class UnreadableRecording(AmbushPlannerError):
    """A file or folder is not a whole recording of a departure.

    Attributes
    ----------
    path
        The file or folder.
    reason
        What is wrong with it, and what to do.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f'{shown(path)} is not readable as a recording: {reason}')
        self.path = path
        self.reason = reason


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
