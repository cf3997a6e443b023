# SPDX-License-Identifier: Apache-2.0
"""``metadata.yaml``, by which rosbag2 (version 9, Jazzy) takes a folder of files as one bag.

It is written as JSON, which is YAML and fast to write.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .messages import Channel, RecordedMessage, fields_from_yaml
from .recording_errors import UnreadableRecording, bytes_in
from .schemas import definitions

FILE_NAME = 'metadata.yaml'


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


def listed_in(folder: Path) -> list[str]:
    """Return the files that the ``metadata.yaml`` of a folder lists; none unless it is ours."""
    try:
        content = json.loads(bytes_in(folder / FILE_NAME))
        names = content['rosbag2_bagfile_information']['relative_file_paths']
        return [name for name in names if isinstance(name, str)]
    except (UnreadableRecording, ValueError, LookupError, TypeError, RecursionError):
        return []


def _time_span(start_ns: int, end_ns: int) -> dict[str, Any]:
    return {'starting_time': {'nanoseconds_since_epoch': start_ns},
            'duration': {'nanoseconds': end_ns - start_ns}}
