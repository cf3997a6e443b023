"""What is in a recorded file: read back equal by independent readers, complete for rosbag2."""

from io import BytesIO

import pytest
import yaml
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError, StreamReader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recording_samples import (
    METADATA,
    START_NS,
    VOLATILE,
    assert_departure,
    departure,
    pose,
    read_with_mcap_ros2,
    read_with_rosbags,
)
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from ambush_planner.recording import RecordedMessage, Recorder, RecordingFailed
from ambush_planner.recording.schemas import load_definition


def summary_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_a_file_reads_back_equal_in_independent_readers(tmp_path, compression):
    sent = departure()
    path = Recorder(tmp_path / 'runs', compression).record_departure(sent, METADATA)
    assert_departure(sent, read_with_mcap_ros2(path))
    assert_departure(sent, read_with_rosbags(path))
    chunks = summary_of(path).chunk_indexes
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


def test_every_checksum_holds_and_covers_the_metadata_record(tmp_path):
    path = Recorder(tmp_path).record_departure(departure(), METADATA)
    data = path.read_bytes()
    list(StreamReader(BytesIO(data), validate_crcs=True).records)
    changed = data.replace(METADATA['input_sha256'].encode(), b'cd' * 32)
    assert changed != data
    with pytest.raises(CRCValidationError):
        list(StreamReader(BytesIO(changed), validate_crcs=True).records)


def test_messages_are_stored_in_the_order_of_time(tmp_path):
    sent = departure()
    path = Recorder(tmp_path).record_departure(sent[::-1], METADATA)
    with path.open('rb') as file:
        reader = make_reader(file)
        times = [m.log_time for *_, m in reader.iter_messages(log_time_order=False)]
    assert times == [m.stamp_ns for m in sent]


def test_header_and_metadata_record(tmp_path):
    path = Recorder(tmp_path).record_departure(departure(), METADATA)
    with path.open('rb') as file:
        reader = make_reader(file)
        assert reader.get_header().profile == 'ros2'
        records = [(record.name, record.metadata) for record in reader.iter_metadata()]
    assert records == [('ambush_planner', METADATA)]


def test_schemas_and_channels_are_written_once(tmp_path):
    sent = departure()
    again = RecordedMessage('/start_pose', pose(0.0, 0.0), VOLATILE, START_NS)
    summary = summary_of(Recorder(tmp_path).record_departure([*sent, again], METADATA))
    assert sorted(schema.name for schema in summary.schemas.values()) == [
        'diagnostic_msgs/msg/DiagnosticArray',
        'geometry_msgs/msg/PoseStamped',
        'nav_msgs/msg/OccupancyGrid',
        'nav_msgs/msg/Path',
        'visualization_msgs/msg/MarkerArray',
    ]
    assert {schema.encoding for schema in summary.schemas.values()} == {'ros2msg'}
    assert [channel.topic for channel in summary.channels.values()] == [m.topic for m in sent]
    assert {channel.message_encoding for channel in summary.channels.values()} == {'cdr'}


def test_type_hashes_are_those_that_rosbags_computes_from_the_recorded_schemas(tmp_path):
    path = Recorder(tmp_path).record_departure(departure(), METADATA)
    summary = summary_of(path)
    recorded = {
        summary.schemas[channel.schema_id].name: channel.metadata['topic_type_hash']
        for channel in summary.channels.values()
    }
    with AnyReader([path]) as reader:
        computed = {name: reader.typestore.hash_rihs01(name) for name in recorded}
    assert recorded == computed


def test_definitions_have_each_dependency_once_depth_first():
    text = load_definition('nav_msgs/msg/Path').text
    parts = text.split('=' * 80 + '\n')
    assert [part.split('\n')[0] for part in parts[1:]] == [
        f'MSG: {name}'
        for name in (
            'std_msgs/Header',
            'builtin_interfaces/Time',
            'geometry_msgs/PoseStamped',
            'geometry_msgs/Pose',
            'geometry_msgs/Point',
            'geometry_msgs/Quaternion',
        )
    ]


def test_a_definition_that_is_not_installed_is_named():
    with pytest.raises(RecordingFailed, match='no_such_msgs/msg/Thing.*install the package'):
        load_definition('no_such_msgs/msg/Thing')


def test_qos_profiles_are_complete(tmp_path):
    qos = QoSProfile(
        depth=5,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        deadline=Duration(seconds=1, nanoseconds=5),
    )
    message = RecordedMessage('/start_pose', pose(0.0, 0.0), qos, START_NS)
    path = Recorder(tmp_path).record_departure([message], METADATA)
    (channel,) = summary_of(path).channels.values()
    (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    assert profile == {
        'history': 'keep_last',
        'depth': 5,
        'reliability': 'best_effort',
        'durability': 'transient_local',
        'deadline': {'sec': 1, 'nsec': 5},
        'lifespan': infinite,
        'liveliness': 'manual_by_topic',
        'liveliness_lease_duration': infinite,
        'avoid_ros_namespace_conventions': False,
    }


def test_rosbags_reads_the_profiles(tmp_path):
    path = Recorder(tmp_path).record_departure(departure(), METADATA)
    for bag in (path, path.parent):
        with Reader(bag) as reader:
            profiles = {c.topic: c.ext.offered_qos_profiles[0] for c in reader.connections}
        assert profiles['/alpha_map'].durability == QosDurability.TRANSIENT_LOCAL
        assert profiles['/start_pose'].durability == QosDurability.VOLATILE
        assert {p.reliability for p in profiles.values()} == {QosReliability.RELIABLE}


def test_time_zero_is_recorded(tmp_path):
    sent = departure(start_ns=0)
    path = Recorder(tmp_path).record_departure(sent, METADATA)
    assert_departure(sent, read_with_rosbags(path))
    assert_departure(sent, read_with_rosbags(path.parent))
