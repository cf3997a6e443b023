"""What is in a recorded file: read back equal by independent readers, complete for rosbag2."""

import json
from io import BytesIO

import pytest
import yaml
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError, StreamReader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recording_samples import (
    START_NS,
    VOLATILE,
    assert_departure,
    departure,
    diagnostics,
    get_plan_events,
    metadata_entries,
    pose,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    recorded,
    trigger_events,
)

from ambush_planner.recordings import Recorder, RecordingFailed, schemas
from ambush_planner.recordings.schemas import load_definition


def service_calls():
    """The events of a call to each service, as rosbag2 names their topics."""
    calls = {'/new_route': trigger_events(), '/get_plan': get_plan_events()}
    return [
        recorded(f'/ambush_planner{name}/_service_event', event, stamp_ns=START_NS + number)
        for name, events in calls.items()
        for number, event in enumerate(events)
    ]


def summary_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_a_file_reads_back_equal_in_independent_readers(tmp_path, compression):
    sent = departure()
    path = record(Recorder(tmp_path / 'runs', compression), sent)
    assert_departure(sent, read_with_mcap_ros2(path))
    assert_departure(sent, read_with_rosbags(path))
    chunks = summary_of(path).chunk_indexes
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


def test_service_events_have_type_and_hash_of_the_installed_interface(tmp_path):
    path = record(Recorder(tmp_path), service_calls())
    summary = summary_of(path)
    stored = {
        summary.schemas[channel.schema_id].name: (
            channel.topic, summary.schemas[channel.schema_id].encoding,
            channel.metadata['topic_type_hash'],
        )
        for channel in summary.channels.values() if channel.topic.endswith('/_service_event')
    }
    installed = {
        type_: next(
            entry['hash_string']
            for entry in json.loads(schemas._read_interface(type_[:-6], 'json'))['type_hashes']
            if entry['type_name'] == type_
        )
        for type_ in stored
    }
    assert stored == {
        'std_srvs/srv/Trigger_Event': (
            '/ambush_planner/new_route/_service_event', 'ros2idl',
            installed['std_srvs/srv/Trigger_Event'],
        ),
        'nav_msgs/srv/GetPlan_Event': (
            '/ambush_planner/get_plan/_service_event', 'ros2idl',
            installed['nav_msgs/srv/GetPlan_Event'],
        ),
    }


def test_every_checksum_holds_and_covers_the_metadata_record(tmp_path):
    path = record(Recorder(tmp_path), departure())
    data = path.read_bytes()
    list(StreamReader(BytesIO(data), validate_crcs=True).records)
    changed = data.replace(b'departure_id', b'Departure_id')
    assert changed != data
    with pytest.raises(CRCValidationError):
        list(StreamReader(BytesIO(changed), validate_crcs=True).records)


def test_header_and_metadata_record(tmp_path):
    path = record(Recorder(tmp_path), departure())
    with path.open('rb') as file:
        reader = make_reader(file)
        assert reader.get_header().profile == 'ros2'
        records = [(record.name, record.metadata) for record in reader.iter_metadata()]
    ((name, entries),) = records
    assert name == 'ambush_planner'
    read = {key: json.loads(text) for key, text in entries.items()}
    assert read == {'format': 6, **metadata_entries()}


def test_schemas_and_channels_are_written_once(tmp_path):
    sent = departure()
    again = recorded('/diagnostics', diagnostics(), VOLATILE, START_NS + 9_000_000)
    summary = summary_of(record(Recorder(tmp_path), [*sent, again]))
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


def test_a_definition_that_is_not_installed_is_named():
    for name in ('no_such_msgs/msg/Thing', 'no_such_msgs/srv/Thing', 'nav_msgs/srv/Thing'):
        event = f'{name}_Event' if '/srv/' in name else name
        with pytest.raises(RecordingFailed, match=f'{name}.*install the package'):
            load_definition(event)


def test_qos_profiles_are_complete(tmp_path):
    qos = QoSProfile(
        depth=5,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        deadline=Duration(seconds=1, nanoseconds=5),
    )
    message = recorded('/start_pose', pose(0.0, 0.0), qos, START_NS)
    path = record(Recorder(tmp_path), [message])
    (channel,) = [
        each for each in summary_of(path).channels.values() if each.topic == '/start_pose'
    ]
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
