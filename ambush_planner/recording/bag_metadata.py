"""What rosbag2's ``metadata.yaml`` says about the files of a bag folder (version 9, Jazzy)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import yaml
from mcap.reader import make_reader

from .qos import qos_from_yaml

FILE_NAME = 'metadata.yaml'


@dataclass(frozen=True)
class RecordedTopic:
    """A topic as one file's channel describes it."""

    name: str
    type: str
    qos: str
    type_hash: str


@dataclass(frozen=True)
class BagFile:
    """One finished MCAP file: its name in the folder, first and last time [ns], and topics."""

    name: str
    start_ns: int
    end_ns: int
    message_counts: Mapping[RecordedTopic, int]


def describe_file(name: str, data: bytes) -> BagFile:
    """Describe the finished MCAP file ``data`` from its own summary section."""
    summary = make_reader(BytesIO(data)).get_summary()
    counts: Counter[RecordedTopic] = Counter()
    for channel in summary.channels.values():
        topic = RecordedTopic(
            channel.topic,
            summary.schemas[channel.schema_id].name,
            channel.metadata['offered_qos_profiles'],
            channel.metadata['topic_type_hash'],
        )
        counts[topic] = summary.statistics.channel_message_counts[channel.id]
    times = summary.statistics
    return BagFile(name, times.message_start_time, times.message_end_time, counts)


def bag_metadata(files: Sequence[BagFile]) -> bytes:
    """Return the text of ``metadata.yaml`` for a folder that holds ``files``, at least one.

    rosbag2 refuses a folder when any of the keys is missing.
    """
    counts = sum((Counter(file.message_counts) for file in files), Counter())
    start_ns = min(file.start_ns for file in files)
    information = {
        'version': 9,
        'storage_identifier': 'mcap',
        **_time_span(start_ns, max(file.end_ns for file in files)),
        'message_count': counts.total(),
        'topics_with_message_count': [_topic(topic, counts[topic]) for topic in counts],
        'compression_format': '',  # chunks are compressed inside MCAP, not by rosbag2
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [_file(file) for file in files],
        'custom_data': {},
        'ros_distro': os.environ.get('ROS_DISTRO', ''),
    }
    document = {'rosbag2_bagfile_information': information}
    return yaml.safe_dump(document, sort_keys=False).encode()


def _topic(topic: RecordedTopic, count: int) -> dict[str, Any]:
    return {
        'topic_metadata': {
            'name': topic.name,
            'type': topic.type,
            'serialization_format': 'cdr',
            'offered_qos_profiles': qos_from_yaml(topic.qos),
            'type_description_hash': topic.type_hash,
        },
        'message_count': count,
    }


def _file(file: BagFile) -> dict[str, Any]:
    return {
        'path': file.name,
        **_time_span(file.start_ns, file.end_ns),
        'message_count': sum(file.message_counts.values()),
    }


def _time_span(start_ns: int, end_ns: int) -> dict[str, Any]:
    return {
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'duration': {'nanoseconds': end_ns - start_ns},
    }
