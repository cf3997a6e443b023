"""Each departure as one finished MCAP file, in a folder that ``ros2 bag`` takes as a bag.

The folder of a session and its files are named as rosbag2 names its own, so that
``ros2 bag info``, ``play`` and ``reindex`` work on the folder and on each file alone. Routes
are secrets: folders have mode 0700, files 0600.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import count
from pathlib import Path
from threading import Lock

from mcap.writer import CompressionType

from ..core.errors import InvalidOption
from .bag_metadata import FILE_NAME, BagMetadata, describe_file
from .durable import make_private_folder, make_private_folders, write_durably
from .encoding import encode_departure
from .errors import recording_to
from .folder_lock import FolderLock
from .messages import Attachment, RecordedMessage

SESSION_PREFIX = 'ambush_planner_'
# Of a session: metadata.yaml, which lists all of them, is written anew with each.
MOST_FILES = 500

COMPRESSIONS = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}


class Recorder:
    """Records departures below ``directory``, one session folder a recorder.

    The folder is made at the first departure, and a new one when it has been taken away or holds
    ``MOST_FILES``. It is locked (``flock``) until ``close`` or the end of the process, so that
    ``repair`` leaves it alone. Safe to be used from several threads; also a context manager.

    Args:
        directory: Where session folders are made; made itself, with mode 0700, if missing.
        compression: ``zstd``, ``lz4`` or ``none``.

    Raises:
        InvalidOption: The compression is none of these.
    """

    def __init__(self, directory: Path, compression: str = 'zstd') -> None:
        if compression not in COMPRESSIONS:
            names = ', '.join(COMPRESSIONS)
            raise InvalidOption(f'compression {compression!r} is none of {names}')
        self._directory = Path(directory).expanduser()
        self._compression = COMPRESSIONS[compression]
        self._session: _Session | None = None
        self._lock = Lock()

    def record_departure(
        self,
        messages: Sequence[RecordedMessage],
        metadata: Mapping[str, str],
        attachments: Sequence[Attachment] = (),
    ) -> Path:
        """Write one departure to a file of its own and list it in the folder's metadata.yaml.

        Args:
            messages: At least one, in any order; the file has them in the order of time.
            metadata: Kept in the file as the metadata record ``ambush_planner``.
            attachments: Files that are kept in the recording.

        Returns:
            The finished file, safe on the disk.

        Raises:
            RecordingFailed: A file or folder could not be written, or a message's definition
                is not installed. No part of a file is left; the next departure tries again.
            ValueError: There are no messages.
        """
        if not messages:
            raise ValueError('a departure without messages cannot be recorded')
        data = encode_departure(messages, metadata, attachments, self._compression)
        with self._lock:
            if self._session is not None and not self._session.takes_more():
                self._end_session()
            if self._session is None:
                self._session = _Session.begin(self._directory)
            return self._session.add(data)

    def close(self) -> None:
        """End the session: its folder is free for others. A later departure begins a new one."""
        with self._lock:
            self._end_session()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _end_session(self) -> None:
        if self._session is not None:
            self._session.end()
            self._session = None


class _Session:
    """A bag folder that grows by a file a departure, locked as long as it does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = FolderLock(folder)
        self._metadata = BagMetadata()
        self._next = 0

    @classmethod
    def begin(cls, directory: Path) -> _Session:
        """Make a folder for a new session, with a name that no other one has."""
        stamp = datetime.now().strftime(f'{SESSION_PREFIX}%Y_%m_%d-%H_%M_%S')
        with recording_to(directory):
            make_private_folders(directory)
            return cls(_make_session_folder(directory / stamp))

    def takes_more(self) -> bool:
        """Whether the folder still stands under its name, and is not full."""
        return self._next < MOST_FILES and self._lock.is_of(self.folder)

    def add(self, data: bytes) -> Path:
        """Write the finished MCAP file ``data`` and the metadata that now holds."""
        # A number is never used twice: a gap is a departure whose recording failed.
        path = self.folder / f'{self.folder.name}_{self._next}.mcap'
        self._next += 1
        file = describe_file(path.name, data)
        with recording_to(path):
            write_durably(path, data)
        self._metadata.add(file)
        with recording_to(self.folder / FILE_NAME):
            # Readers refuse a folder whose metadata lists a file that was taken away.
            self._metadata.keep(os.listdir(self.folder))
            write_durably(self.folder / FILE_NAME, self._metadata.text())
        return path

    def end(self) -> None:
        """Let others work on the folder."""
        self._lock.release()


def _make_session_folder(wanted: Path) -> Path:
    """Make the folder ``wanted``, or with the first number behind it that is free."""
    folder = wanted
    for number in count(2):
        try:
            make_private_folder(folder)
            break
        except FileExistsError:
            folder = wanted.with_name(f'{wanted.name}-{number}')
    return folder
