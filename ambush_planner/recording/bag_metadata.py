"""What rosbag2's ``metadata.yaml`` says about the files of a bag folder (version 9, Jazzy).

The text is put together from pieces that are made once, for a file and for a topic: writing
thousands of files through a YAML library anew at each departure would take seconds.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from mmap import mmap
from textwrap import indent
from types import MappingProxyType
from typing import Any

from .mcap_content import read_summary
from .yaml_text import BadYaml, dump_yaml, load_yaml

FILE_NAME = 'metadata.yaml'
# Some 60 000 files.
MOST_METADATA_BYTES = 2**24
_ROOT = 'rosbag2_bagfile_information'


@dataclass(frozen=True, slots=True)
class RecordedTopic:
    """A topic as one file's channel describes it."""

    name: str
    type: str
    qos: str
    type_hash: str


@dataclass(frozen=True, slots=True)
class BagFile:
    """One finished MCAP file: its name in the folder, first and last time [ns], and topics."""

    name: str
    start_ns: int
    end_ns: int
    message_counts: Mapping[RecordedTopic, int]


def can_be_listed(name: str) -> bool:
    """Whether ``metadata.yaml`` can hold a file's name: YAML has no bytes that are not UTF-8."""
    return not re.search('[\ud800-\udfff]', name)


def describe_file(name: str, data: bytes | mmap) -> BagFile:
    """Describe the finished MCAP file ``data`` from its own summary section.

    Raises:
        DamagedRecord: The file has no whole summary.
    """
    summary = read_summary(data)
    counts: Counter[RecordedTopic] = Counter()
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        topic = RecordedTopic(
            channel.topic,
            schema.name if schema else '',
            channel.metadata.get('offered_qos_profiles', ''),
            channel.metadata.get('topic_type_hash', ''),
        )
        counts[topic] += summary.statistics.channel_message_counts.get(channel.id, 0)
    times = summary.statistics
    return BagFile(
        name, times.message_start_time, times.message_end_time, _shared(frozenset(counts.items()))
    )


@lru_cache(maxsize=64)
def _shared(counts: frozenset[tuple[RecordedTopic, int]]) -> Mapping[RecordedTopic, int]:
    """The counts of a file, one object for all files that have the same: most of them do.

    A session may grow to thousands of files, and all of them are listed anew each time.
    """
    return MappingProxyType(dict(sorted(counts, key=lambda item: item[0].name)))


class BagMetadata:
    """The ``metadata.yaml`` of a folder that gains a file at a time.

    Args:
        files: What is in the folder already, in order.
    """

    def __init__(self, files: Iterable[BagFile] = ()) -> None:
        self._start_anew(files)

    def _start_anew(self, files: Iterable[BagFile]) -> None:
        self._files: dict[str, BagFile] = {}
        self._counts: Counter[RecordedTopic] = Counter()
        self._span_ns: tuple[int, int] | None = None
        self._paths = bytearray(b'  relative_file_paths:\n')
        self._entries = bytearray(b'  files:\n')
        for file in files:
            self.add(file)

    def add(self, file: BagFile) -> None:
        """List one more file, at the end."""
        self._files[file.name] = file
        self._counts.update(file.message_counts)
        count = sum(file.message_counts.values())
        if count:
            start_ns, end_ns = self._span_ns or (file.start_ns, file.end_ns)
            self._span_ns = (min(start_ns, file.start_ns), max(end_ns, file.end_ns))
        entry = {
            'path': file.name,
            **_time_span(file.start_ns, file.end_ns),
            'message_count': count,
        }
        self._paths += _indented([file.name])
        self._entries += _indented([entry])

    def is_empty(self) -> bool:
        """Whether it lists no file; there is no text then."""
        return not self._files

    def keep(self, names: Collection[str]) -> None:
        """Drop the files that are not among ``names``."""
        kept = set(names)
        if not self._files.keys() <= kept:
            self._start_anew([file for file in self._files.values() if file.name in kept])

    def text(self) -> bytes:
        """Return the text of ``metadata.yaml``; there must be a file.

        rosbag2 refuses a folder when any of the keys is missing.
        """
        head = {
            'version': 9,
            'storage_identifier': 'mcap',
            **_time_span(*(self._span_ns or (0, 0))),
            'message_count': sum(self._counts.values()),
            'compression_format': '',  # chunks are compressed inside MCAP, not by rosbag2
            'compression_mode': '',
            'custom_data': {},
            'ros_distro': os.environ.get('ROS_DISTRO', ''),
        }
        topics = [
            _topic_text(topic) + f'    message_count: {count}\n'.encode()
            for topic, count in self._counts.items()
        ]
        return b''.join([
            f'{_ROOT}:\n'.encode(),
            _indented(head),
            b'  topics_with_message_count:\n' if topics else b'  topics_with_message_count: []\n',
            *topics,
            self._paths,
            self._entries,
        ])


def listed_files(text: bytes) -> list[str]:
    """Return the ``relative_file_paths`` of a ``metadata.yaml``.

    Raises:
        BadYaml: The text is not that of a bag folder.
    """
    try:
        names = load_yaml(text.decode(), MOST_METADATA_BYTES)[_ROOT]['relative_file_paths']
    except (UnicodeDecodeError, LookupError, TypeError) as error:
        raise BadYaml(f'no {FILE_NAME} of a bag') from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise BadYaml(f'no {FILE_NAME} of a bag')
    return names


def _indented(document: Any) -> bytes:
    return indent(dump_yaml(document), '  ').encode()


@lru_cache(maxsize=1024)
def _topic_text(topic: RecordedTopic) -> bytes:
    """A topic's entry in ``topics_with_message_count``, up to the count."""
    try:
        qos = load_yaml(topic.qos) or []
    except BadYaml:
        qos = []
    entry = {
        'topic_metadata': {
            'name': topic.name,
            'type': topic.type,
            'serialization_format': 'cdr',
            'offered_qos_profiles': qos,
            'type_description_hash': topic.type_hash,
        },
    }
    return _indented([entry])


def _time_span(start_ns: int, end_ns: int) -> dict[str, Any]:
    return {
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'duration': {'nanoseconds': end_ns - start_ns},
    }
