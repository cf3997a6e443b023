# SPDX-License-Identifier: Apache-2.0
"""Writes each departure as one finished MCAP file, which ``ros2 bag`` takes as a bag.

Session folders and their files are named as rosbag2 names its own. Routes are secrets: folders
have mode 0700, files 0600.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

from .durable_files import TEMPORARY, make_private_folder, make_private_folders, write_all_durably
from .encoding import encode
from .messages import RecordedMessage
from .recording_errors import recording_to

SESSION_PREFIX = 'ambush_planner_'
# Temporary files older than this [s] are leftovers of a killed process.
_ABANDONED = 60.0


class Recorder:
    """Records departures below ``directory``, in one session folder per recorder.

    The folder is made for the first departure, and a new one once it has been taken away.

    ``directory`` is made with mode 0700 if missing; ``compression`` is ``zstd``, ``lz4`` or
    ``none``.
    """

    def __init__(self, directory: Path, compression: str = 'zstd') -> None:
        self._directory, self._compression = Path(directory).expanduser(), compression
        self._folder: Path | None = None
        self._next = 0

    def record_departure(self, messages: Sequence[RecordedMessage], entries: Mapping[str, Any],
                         attachments: Mapping[str, bytes]) -> Path:
        """Write one departure to a file of its own, and return its path.

        Messages come in any order, ``entries`` are those of the metadata record. RecordingFailed:
        a file or folder could not be written, or a message's definition is not installed. No
        partial file is left, and the next departure tries again.
        """
        ordered = sorted(messages, key=lambda each: each.stamp_ns)
        with recording_to(self._directory):
            data = encode(ordered, entries, attachments, self._compression)
        folder = self._session_folder()
        # A number is never used twice: a missing one is a departure whose recording failed.
        path = folder / f'{folder.name}_{self._next}.mcap'
        self._next += 1
        with recording_to(path):
            write_all_durably({path: data})
        return path

    def _session_folder(self) -> Path:
        if self._folder is None or not self._folder.is_dir():
            # UTC: these names are sorted, and local clocks are put back in autumn.
            name = datetime.now(timezone.utc).strftime(f'{SESSION_PREFIX}%Y_%m_%d-%H_%M_%S')
            with recording_to(self._directory):
                make_private_folders(self._directory)
                self._folder = _new_folder(self._directory / name)
            self._next = 0
        return self._folder


def prepare(directory: Path) -> list[Path]:
    """Make the folder of sessions, and remove and return the temporary files that kills left there.

    Files younger than a minute stay, since another node may be writing them. RecordingFailed: it
    cannot be written to, or the library that writes recordings is not installed.
    """
    with recording_to(directory):
        import_module('mcap.writer')
        make_private_folders(directory)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        found = [path for path in directory.glob(f'{SESSION_PREFIX}*/*{TEMPORARY}')
                 if time.time() - path.lstat().st_mtime > _ABANDONED]
        for path in found:
            path.unlink()
    return found


def _new_folder(wanted: Path) -> Path:
    """Make the folder ``wanted``; if it exists, append the first free number."""
    folder, number = wanted, count(2)
    while True:
        try:
            make_private_folder(folder)
            return folder
        except FileExistsError:
            folder = wanted.with_name(f'{wanted.name}-{next(number)}')
