"""Each departure as one finished MCAP file, in a folder that ``ros2 bag`` takes as a bag.

The folder of a session and its files are named as rosbag2 names its own, so that
``ros2 bag info``, ``play`` and ``reindex`` work on the folder and on each file alone. Each file
states the SHA-256 of the one before it, the first of a session that of the session before. Routes
are secrets: folders have mode 0700, files 0600.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone
from itertools import count
from pathlib import Path
from threading import Lock

from mcap import records

from ..errors import InvalidOption
from .bag_folder import FILE_NAME, BagFile, bag_text, describe_file
from .durable_files import make_private_folder, make_private_folders, write_durably
from .folder_lock import FolderLock
from .mcap_file import COMPRESSIONS, METADATA_RECORD, Content, encode
from .messages import Attachment, RecordedMessage
from .metadata import Link, chain_text
from .reader import check_readable, natural_order, read_bytes
from .recording_errors import RecordingFailed, UnreadableRecording, recording_to
from .schemas import load_definition

__all__ = ['COMPRESSIONS', 'MOST_FILES', 'SESSION_PREFIX', 'Recorder']

SESSION_PREFIX = 'ambush_planner_'
# Of a session: metadata.yaml, which lists all of them, is written anew with each.
MOST_FILES = 500


class Recorder:
    """Records departures below ``directory``, one session folder a recorder.

    The folder is made at the first departure, and a new one when it has been taken away or holds
    ``MOST_FILES``. It is locked (``flock``) until ``close`` or the end of the process, so that
    ``repair`` leaves it alone. Safe to be used from several threads; also a context manager.

    Parameters
    ----------
    directory
        Where session folders are made; made itself, with mode 0700, if missing.
    compression
        ``zstd``, ``lz4`` or ``none``.

    Raises
    ------
    InvalidOption
        The compression is none of these.
    """

    def __init__(self, directory: Path, compression: str = 'zstd') -> None:
        if compression not in COMPRESSIONS:
            names = ', '.join(COMPRESSIONS)
            raise InvalidOption(f'compression {compression!r} is not one of {names}')
        self._directory = Path(directory).expanduser()
        self._compression = compression
        self._session: _Session | None = None
        self._lock = Lock()

    def record_departure(
        self,
        messages: Sequence[RecordedMessage],
        metadata: Mapping[str, str],
        attachments: Sequence[Attachment] = (),
    ) -> Path:
        """Write one departure to a file of its own and list it in the folder's metadata.yaml.

        Parameters
        ----------
        messages
            At least one, in any order; the file has them in the order of time.
        metadata
            The entries of the metadata record but ``chain``, see ``metadata_texts``.
        attachments
            Files that are kept in the recording.

        Returns
        -------
        Path
            The finished file, safe on the disk.

        Raises
        ------
        RecordingFailed
            A file or folder could not be written, a message's definition is not installed, or
            the readers would refuse the file. No part of a file is left; the next departure
            tries again.
        ValueError
            There are no messages.
        """
        if not messages:
            raise ValueError('a departure without messages cannot be recorded')
        with self._lock:
            if self._session is not None and not self._session.takes_more():
                self._end_session()
            if self._session is None:
                self._session = _Session(self._directory)
            return self._session.add(messages, metadata, attachments, self._compression)

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


def departure_content(
    messages: Iterable[RecordedMessage],
    metadata: dict[str, str],
    attachments: Iterable[Attachment],
    compression: str,
) -> Content:
    """Return what a file of a departure holds; the messages are put in the order of time.

    Raises
    ------
    RecordingFailed
        A message's definition is not installed.
    """
    ordered = sorted(messages, key=lambda each: each.stamp_ns)
    content = Content('ros2', compression=compression.removeprefix('none'))
    content.metadata = [records.Metadata(METADATA_RECORD, metadata)]
    content.attachments = [
        records.Attachment(0, ordered[0].stamp_ns, each.name, each.media_type, each.data)
        for each in attachments
    ]
    channels: dict[tuple[str, str, str], int] = {}
    for each in ordered:
        key = each.topic, each.type, each.qos_text
        if key not in channels:
            channels[key] = _add_channel(content, *key)
        time = each.stamp_ns
        content.messages.append(records.Message(channels[key], time, each.data, time, 0))
    return content


def _add_channel(content: Content, topic: str, type_: str, qos: str) -> int:
    definition = load_definition(type_)
    schemas = {each.name: each.id for each in content.schemas.values()}
    if type_ not in schemas:
        schemas[type_] = len(schemas) + 1
        content.add(records.Schema(
            schemas[type_], definition.text.encode(), definition.encoding, type_
        ))
    number = len(content.channels) + 1
    metadata = {'offered_qos_profiles': qos, 'topic_type_hash': definition.type_hash}
    content.add(records.Channel(number, topic, 'cdr', metadata, schemas[type_]))
    return number


class _Session:
    """A new bag folder that grows by a file a departure, locked as long as it does."""

    def __init__(self, directory: Path) -> None:
        # UTC: the chain goes by these names, and clocks are put back in autumn.
        stamp = datetime.now(timezone.utc).strftime(f'{SESSION_PREFIX}%Y_%m_%d-%H_%M_%S')
        with recording_to(directory):
            make_private_folders(directory)
            self._last = _last_recorded(directory)
            self._folder = _make_session_folder(directory / stamp)
            self._lock = FolderLock(self._folder)
        self._files: dict[str, BagFile] = {}
        self._strategy = b''
        self._next = 0

    def takes_more(self) -> bool:
        """Whether the folder still stands under its name, and is not full."""
        return self._next < MOST_FILES and self._lock.is_of(self._folder)

    def add(
        self,
        messages: Sequence[RecordedMessage],
        metadata: Mapping[str, str],
        attachments: Sequence[Attachment],
        compression: str,
    ) -> Path:
        """Write a departure and the metadata.yaml that now holds."""
        # A number is never used twice: a gap is a departure whose recording failed.
        path = self._folder / f'{self._folder.name}_{self._next}.mcap'
        self._next += 1
        link = Link(path.name, self._last.file, self._last.sha256)
        content = departure_content(
            messages, {**metadata, 'chain': chain_text(link)}, attachments, compression
        )
        data = encode(content)
        try:
            # Many departures have one strategy, which takes longer to read than all else.
            self._strategy = check_readable(path, content, len(data), self._strategy)
        except UnreadableRecording as error:
            raise RecordingFailed(
                path, f'readers would refuse it: {error.reason}; the departure is not recorded'
            ) from error
        with recording_to(path):
            write_durably(path, data)
        self._last = Link(path.name, sha256=hashlib.sha256(data).hexdigest())
        self._list(describe_file(path.name, content))
        return path

    def end(self) -> None:
        """Let others work on the folder."""
        self._lock.release()

    def _list(self, file: BagFile) -> None:
        self._files[file.name] = file
        with recording_to(self._folder / FILE_NAME):
            # Readers refuse a folder whose metadata lists a file that was taken away.
            present = set(os.listdir(self._folder))
            listed = [each for name, each in self._files.items() if name in present]
            write_durably(self._folder / FILE_NAME, bag_text(listed))


def _last_recorded(directory: Path) -> Link:
    """Name and hash of the newest recording in the session folders that are there."""
    folders = sorted(
        (each for each in directory.glob(f'{SESSION_PREFIX}*') if each.is_dir()),
        key=natural_order, reverse=True,
    )
    for folder in folders:
        for path in sorted(folder.glob('*.mcap'), key=natural_order, reverse=True):
            try:
                data = read_bytes(path)
            except UnreadableRecording:
                continue
            return Link(path.name, sha256=hashlib.sha256(data).hexdigest())
    return Link()


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
