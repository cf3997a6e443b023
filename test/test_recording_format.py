# SPDX-License-Identifier: Apache-2.0
"""What is in a recorded file: read back equal by independent readers, complete for rosbag2."""

import json

import pytest
import yaml
from mcap.reader import make_reader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recording_samples import (
    ATTACHMENTS,
    START_NS,
    assert_departure,
    departure,
    metadata_entries,
    pose,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    recorded,
)

from ambush_planner.recordings import Recorder, RecordingFailed
from ambush_planner.recordings.schemas import load_definition


def summary_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_a_file_reads_back_equal_in_independent_readers(tmp_path, compression):
    sent = departure()
    path = record(Recorder(tmp_path / 'runs', compression), sent)
    assert_departure(sent, read_with_mcap_ros2(path))
    for bag in (path, path.parent):
        assert_departure(sent, read_with_rosbags(bag))
    chunks = summary_of(path).chunk_indexes
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


def test_header_metadata_record_and_attachments(tmp_path):
    path = record(Recorder(tmp_path), departure(start_ns=0))
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        ((name, entries),) = [(each.name, each.metadata) for each in reader.iter_metadata()]
        (found,) = reader.iter_attachments()
    assert name == 'ambush_planner'
    read = {key: json.loads(text) for key, text in entries.items()}
    assert read == {'format': 10, **metadata_entries()}
    assert {found.name: found.data} == ATTACHMENTS and found.log_time == 0


def test_a_definition_that_is_not_installed_is_named():
    for name in ('no_such_msgs/msg/Thing', 'nav_msgs/msg/Thing'):
        with pytest.raises(RecordingFailed, match=f'{name}.*install the package'):
            load_definition(name)


def test_qos_profiles_are_complete(tmp_path):
    qos = QoSProfile(
        depth=5, reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        deadline=Duration(seconds=1, nanoseconds=5))
    message = recorded('/start_pose', pose(0.0, 0.0), qos, START_NS)
    path = record(Recorder(tmp_path), [message])
    (channel,) = [
        each for each in summary_of(path).channels.values() if each.topic == '/start_pose'
    ]
    (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    assert profile == {
        'history': 'keep_last', 'depth': 5, 'reliability': 'best_effort',
        'durability': 'transient_local', 'deadline': {'sec': 1, 'nsec': 5}, 'lifespan': infinite,
        'liveliness': 'manual_by_topic', 'liveliness_lease_duration': infinite,
        'avoid_ros_namespace_conventions': False,
    }
