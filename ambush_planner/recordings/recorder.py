# SPDX-License-Identifier: Apache-2.0
"""Writes each departure as one finished MCAP file, in a folder that ``ros2 bag`` takes as a bag.

Session folders and their files are named as rosbag2 names its own. Routes are secrets: folders
have mode 0700, files 0600.
"""

from __future__ import annotations

import errno
import json
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from .durable_files import TEMPORARY, make_private_folder, make_private_folders, write_all_durably
from .encoding import encode
from .messages import Channel, RecordedMessage, fields_from_yaml
from .recording_errors import recording_to
from .schemas import definitions

# The list of a session folder's files. It is written as JSON, which is YAML and fast to write.
FILE_NAME = 'metadata.yaml'
SESSION_PREFIX = 'ambush_planner_'
# Maximum number of recordings in a session folder; metadata.yaml lists all, and is written with
# each.
MAX_FILES = 500
# Temporary files older than this [s] are leftovers of a killed process.
_ABANDONED = 60.0


class Recorder:
    """Records departures below ``directory``, in one session folder per recorder.

    The folder is made for the first departure, and a new one once it holds ``MAX_FILES`` or has
    been taken away.

    ``directory`` is made with mode 0700 if missing; ``compression`` is ``zstd``, ``lz4`` or
    ``none``.
    """

    def __init__(self, directory: Path, compression: str = 'zstd') -> None:
        self._directory, self._compression = Path(directory).expanduser(), compression
        self._folder: Path | None = None
        self._files: list[BagFile] = []
        self._next = 0

    def record_departure(self, messages: Sequence[RecordedMessage], entries: Mapping[str, Any],
                         attachments: Mapping[str, bytes]) -> Path:
        """Write one departure to a file of its own, list it in metadata.yaml, and return its path.

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
            files = [*self._present(folder), describe_file(path.name, ordered)]
            write_all_durably({path: data, folder / FILE_NAME: bag_text(files)})
        self._files = files
        return path

    def remove(self, path: Path) -> None:
        """Remove the recording of a departure that has not left."""
        with recording_to(path):
            path.unlink(missing_ok=True)
            self._files = self._present(path.parent)
            if self._files:
                write_all_durably({path.parent / FILE_NAME: bag_text(self._files)})
            else:
                (path.parent / FILE_NAME).unlink(missing_ok=True)

    def _present(self, folder: Path) -> list[BagFile]:
        """Return the files that are still there: rosbag2 refuses a list with one that is not."""
        present = set(os.listdir(folder))
        return [each for each in self._files if each.name in present]

    def _session_folder(self) -> Path:
        if self._folder is None or self._next >= MAX_FILES or not self._folder.is_dir():
            # UTC: these names are sorted, and local clocks are put back in autumn.
            name = datetime.now(timezone.utc).strftime(f'{SESSION_PREFIX}%Y_%m_%d-%H_%M_%S')
            with recording_to(self._directory):
                make_private_folders(self._directory)
                self._folder = _new_folder(self._directory / name)
            self._files, self._next = [], 0
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


class BagFile(NamedTuple):
    """One MCAP file: its name, first and last time [ns], and messages by (topic, type, QoS).

    ``entry`` is what the list says of it, which is written again with each other file.
    """

    name: str
    start_ns: int
    end_ns: int
    counts: Mapping[Channel, int]
    entry: str


def describe_file(name: str, messages: Sequence[RecordedMessage]) -> BagFile:
    """Describe a file by its messages, which are in the order of time."""
    start, end = messages[0].stamp_ns, messages[-1].stamp_ns
    entry = json.dumps({'path': name, **_time_span(start, end), 'message_count': len(messages)})
    return BagFile(name, start, end, Counter(each.channel for each in messages), entry)


def bag_text(files: Sequence[BagFile]) -> bytes:
    """Return ``metadata.yaml`` of a folder with these files; rosbag2 demands every key."""
    counts: Counter[Channel] = Counter()
    for each in files:
        counts.update(each.counts)
    start, end = min(each.start_ns for each in files), max(each.end_ns for each in files)
    described = {'rosbag2_bagfile_information': {
        'version': 9,
        'storage_identifier': 'mcap',
        **_time_span(start, end),
        'message_count': sum(counts.values()),
        'compression_format': '',  # MCAP compresses inside its chunks
        'compression_mode': '',
        'custom_data': {},
        'ros_distro': os.environ.get('ROS_DISTRO', ''),
        'topics_with_message_count': [
            {'message_count': count, 'topic_metadata': {
                'name': channel.topic, 'type': channel.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': [fields_from_yaml(channel.qos)],
                'type_description_hash': definitions()[channel.type].type_hash}}
            for channel, count in counts.items()
        ],
        'relative_file_paths': [each.name for each in files],
        'files': [],
    }}
    head, end_of_list = json.dumps(described, ensure_ascii=False).rsplit(']', 1)
    return f'{head}{", ".join(each.entry for each in files)}]{end_of_list}\n'.encode()


def _time_span(start_ns: int, end_ns: int) -> dict[str, Any]:
    return {'starting_time': {'nanoseconds_since_epoch': start_ns},
            'duration': {'nanoseconds': end_ns - start_ns}}
