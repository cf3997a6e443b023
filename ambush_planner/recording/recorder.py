"""Each departure as one finished MCAP file, in a folder that ``ros2 bag`` takes as a bag.

The folder of a session and its files are named as rosbag2 names its own, so that
``ros2 bag info``, ``play`` and ``reindex`` work on the folder and on each file alone. Routes
are secrets: folders have mode 0700, files 0600.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any

from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from ..core.errors import InvalidOption
from .bag_metadata import FILE_NAME, BagFile, bag_metadata, describe_file
from .durable import make_private_folder, write_durably
from .errors import recording_to
from .qos import qos_to_yaml
from .schemas import load_definition, type_name

METADATA_RECORD = 'ambush_planner'

_COMPRESSIONS = {
    'zstd': CompressionType.ZSTD,
    'lz4': CompressionType.LZ4,
    'none': CompressionType.NONE,
}


@dataclass(frozen=True)
class RecordedMessage:
    """A message as it was received or published.

    Attributes:
        topic: Its full name, with a leading slash.
        message: The ROS message instance itself.
        qos: The profile that it was offered with.
        stamp_ns: When, in nanoseconds of the node's clock; players keep these distances.
    """

    topic: str
    message: Any
    qos: QoSProfile
    stamp_ns: int


class Recorder:
    """Records departures below ``directory``, one session folder a recorder.

    The folder is made at the first departure, and a new one when it has been taken away.
    Safe to be used from several threads.

    Args:
        directory: Where session folders are made; made itself, with mode 0700, if missing.
        compression: ``zstd``, ``lz4`` or ``none``.

    Raises:
        InvalidOption: The compression is none of these.
    """

    def __init__(self, directory: Path, compression: str = 'zstd') -> None:
        if compression not in _COMPRESSIONS:
            names = ', '.join(_COMPRESSIONS)
            raise InvalidOption(f'compression {compression!r} is none of {names}')
        self._directory = Path(directory).expanduser()
        self._compression = _COMPRESSIONS[compression]
        self._session: _Session | None = None
        self._lock = Lock()

    def record_departure(
        self, messages: Sequence[RecordedMessage], metadata: Mapping[str, str]
    ) -> Path:
        """Write one departure to a file of its own and list it in the folder's metadata.yaml.

        Args:
            messages: At least one, in any order; the file has them in the order of time.
            metadata: Kept in the file as the metadata record ``ambush_planner``.

        Returns:
            The finished file, safe on the disk.

        Raises:
            RecordingFailed: A file or folder could not be written, or a message's definition
                is not installed. No part of a file is left; the next departure tries again.
            ValueError: There are no messages.
        """
        if not messages:
            raise ValueError('a departure without messages cannot be recorded')
        data = _encode(messages, metadata, self._compression)
        with self._lock:
            if self._session is None or not os.path.isdir(self._session.folder):
                self._session = _Session.begin(self._directory)
            return self._session.add(data)


class _Session:
    """A bag folder that grows by a file a departure."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files: list[BagFile] = []
        self._numbers = count()

    @classmethod
    def begin(cls, directory: Path) -> _Session:
        """Make a folder for a new session, with a name that no other one has."""
        stamp = datetime.now().strftime('ambush_planner_%Y_%m_%d-%H_%M_%S')
        with recording_to(directory):
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            return cls(_make_session_folder(directory / stamp))

    def add(self, data: bytes) -> Path:
        """Write the finished MCAP file ``data`` and the metadata that now holds."""
        # A number is never used twice: a gap is a departure whose recording failed.
        path = self.folder / f'{self.folder.name}_{next(self._numbers)}.mcap'
        file = describe_file(path.name, data)
        with recording_to(path):
            write_durably(path, data)
        self._files.append(file)
        with recording_to(self.folder / FILE_NAME):
            # Readers refuse a folder whose metadata lists a file that was taken away.
            self._files = [file for file in self._files if (self.folder / file.name).exists()]
            write_durably(self.folder / FILE_NAME, bag_metadata(self._files))
        return path


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


def _encode(
    messages: Sequence[RecordedMessage],
    metadata: Mapping[str, str],
    compression: CompressionType,
) -> bytes:
    """Return a whole MCAP file of the profile ``ros2``."""
    stream = BytesIO()
    # The checksum over the data section covers the metadata record; those of chunks do not.
    writer = Writer(stream, compression=compression, enable_data_crcs=True)
    writer.start(profile='ros2')
    writer.add_metadata(METADATA_RECORD, dict(metadata))
    channels = _Channels(writer)
    for recorded in sorted(messages, key=lambda recorded: recorded.stamp_ns):
        writer.add_message(
            channel_id=channels.of(recorded),
            log_time=recorded.stamp_ns,
            publish_time=recorded.stamp_ns,
            data=serialize_message(recorded.message),
        )
    writer.finish()
    return stream.getvalue()


class _Channels:
    """Registers each schema and each channel with the writer once."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}

    def of(self, recorded: RecordedMessage) -> int:
        """Return the channel's id for a message, after registering what is new."""
        key = (recorded.topic, type_name(recorded.message), qos_to_yaml(recorded.qos))
        if key not in self._channels:
            self._channels[key] = self._register(*key)
        return self._channels[key]

    def _register(self, topic: str, type_: str, qos: str) -> int:
        definition = load_definition(type_)
        if type_ not in self._schemas:
            self._schemas[type_] = self._writer.register_schema(
                type_, 'ros2msg', definition.text.encode()
            )
        metadata = {'offered_qos_profiles': qos, 'topic_type_hash': definition.type_hash}
        return self._writer.register_channel(topic, 'cdr', self._schemas[type_], metadata)
