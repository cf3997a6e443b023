"""``metadata.yaml``, by which rosbag2 (version 9, Jazzy) takes a folder of files as a bag.

It is written as JSON, which is YAML: yaml-cpp 0.8.0, with the conversions that rosbag2_storage
uses, reads every key of it, and so does the package rosbags in the tests.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from .mcap_file import Content
from .qos_text import fields_from_yaml

FILE_NAME = 'metadata.yaml'
_ROOT = 'rosbag2_bagfile_information'
# Some 60 000 files.
_MOST_BYTES = 2**24
# A line of a metadata.yaml that rosbag2 wrote itself.
_LISTED = re.compile(r'^ *- *"?([^"\n]+\.mcap)"? *$', re.MULTILINE)


class RecordedTopic(NamedTuple):
    """A topic as one file's channel describes it."""

    name: str
    type: str
    qos: str
    type_hash: str


@dataclass(frozen=True)
class BagFile:
    """One MCAP file: its name in the folder, first and last time [ns], and messages by topic."""

    name: str
    start_ns: int
    end_ns: int
    counts: tuple[tuple[RecordedTopic, int], ...]

    @cached_property
    def message_count(self) -> int:
        """Of all topics."""
        return sum(number for _, number in self.counts)


def describe_file(name: str, content: Content) -> BagFile:
    """Describe the content of a file for ``metadata.yaml``."""
    topics = {
        number: RecordedTopic(
            channel.topic, content.schemas[channel.schema_id].name,
            channel.metadata.get('offered_qos_profiles', ''),
            channel.metadata.get('topic_type_hash', ''),
        )
        for number, channel in content.channels.items()
    }
    times = [each.log_time for each in content.messages] or [0]
    counts = Counter(topics[each.channel_id] for each in content.messages)
    return BagFile(name, min(times), max(times), tuple(counts.items()))


def bag_text(files: Iterable[BagFile]) -> bytes:
    """Return ``metadata.yaml`` of a folder with these files, a line each of its entries."""
    # An indent would take Python's slow encoder, for each departure and all those before it.
    entries = ',\n'.join(
        f'  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}'
        for key, value in bag_of(files).items()
    )
    return f'{{\n "{_ROOT}": {{\n{entries}\n }}\n}}\n'.encode()


def bag_of(files: Iterable[BagFile]) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says of these files; rosbag2 demands every key."""
    files = list(files)
    counts: Counter[RecordedTopic] = Counter()
    # Nearly all files are alike: one after the other, 500 took longer than recording a departure.
    for alike, times in Counter(each.counts for each in files).items():
        for topic, number in alike:
            counts[topic] += times * number
    filled = [each for each in files if each.message_count]
    start = min((each.start_ns for each in filled), default=0)
    end = max((each.end_ns for each in filled), default=0)
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **_time_span(start, end),
        'message_count': sum(counts.values()),
        'compression_format': '',  # chunks are compressed inside MCAP, not by rosbag2
        'compression_mode': '',
        'custom_data': {},
        'ros_distro': os.environ.get('ROS_DISTRO', ''),
        'topics_with_message_count': [
            {'topic_metadata': _described(topic), 'message_count': count}
            for topic, count in counts.items()
        ],
        'relative_file_paths': [each.name for each in files],
        'files': [
            {
                'path': each.name, **_time_span(each.start_ns, each.end_ns),
                'message_count': each.message_count,
            }
            for each in files
        ],
    }


def listed_files(folder: Path) -> list[str] | None:
    """Return the files that a folder's ``metadata.yaml`` lists; None if it does not say."""
    names = read_bag(folder).get('relative_file_paths')
    good = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return names if good else None


def read_bag(folder: Path) -> dict[str, Any]:
    """Return what a folder's ``metadata.yaml`` says; nothing where it cannot be read.

    Of one that rosbag2 wrote itself (``ros2 bag reindex``) only the files are read, line by line:
    YAML of unknown origin can take any time and memory.
    """
    path = folder / FILE_NAME
    try:
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return {}
        text = path.read_text()
        if not text.startswith('{'):
            # A block of lines, ended by one that is less indented.
            block = re.search(r'^ *relative_file_paths:\n((?: *- .*\n)*)', text, re.MULTILINE)
            return {'relative_file_paths': _LISTED.findall(block[1])} if block else {}
        bag = json.loads(text)[_ROOT]
        return bag if isinstance(bag, dict) else {}
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}


def _described(topic: RecordedTopic) -> dict[str, Any]:
    try:
        profiles = [fields_from_yaml(topic.qos)]
    except ValueError:
        profiles = []
    return {
        'name': topic.name,
        'type': topic.type,
        'serialization_format': 'cdr',
        'offered_qos_profiles': profiles,
        'type_description_hash': topic.type_hash,
    }


def _time_span(start_ns: int, end_ns: int) -> dict[str, Any]:
    return {
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'duration': {'nanoseconds': end_ns - start_ns},
    }
