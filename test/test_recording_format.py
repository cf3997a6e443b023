"""What is in a recorded file: read back equal by independent readers, complete for rosbag2."""

import json

import pytest
import yaml
from mcap.reader import make_reader
from nav_msgs.srv import GetPlan
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from recording_samples import (
    ATTACHMENTS,
    START_NS,
    assert_departure,
    departure,
    metadata_entries,
    path_message,
    pose,
    read_with_mcap_ros2,
    read_with_rosbags,
    record,
    recorded,
)
from service_msgs.msg import ServiceEventInfo
from std_srvs.srv import Trigger

from ambush_planner.recordings import Recorder, RecordingFailed, schemas
from ambush_planner.recordings.schemas import load_definition


def service_calls():
    """The events of a call to each service, as rosbag2 names their topics."""
    request = GetPlan.Request(start=pose(1.0, 2.0), goal=pose(3.0, 4.0), tolerance=0.5)
    calls = {
        'new_route': (Trigger, Trigger.Request(), Trigger.Response(success=True, message='ok')),
        'get_plan': (GetPlan, request, GetPlan.Response(plan=path_message())),
    }
    events = []
    for name, (service, request, response) in calls.items():
        for kind, content in ((1, {'request': [request]}), (2, {'response': [response]})):
            info = ServiceEventInfo(event_type=kind, sequence_number=7)
            events.append(recorded(f'/ambush_planner/{name}/_service_event',
                                   service.Event(info=info, **content), stamp_ns=START_NS + kind))
    return events


def summary_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary()


@pytest.mark.parametrize('compression', ['zstd', 'lz4', 'none'])
def test_a_file_reads_back_equal_in_independent_readers(tmp_path, compression):
    sent, calls = departure(), service_calls()
    path = record(Recorder(tmp_path / 'runs', compression), sent + calls)
    assert_departure(sent, read_with_mcap_ros2(path))
    in_order = sorted(sent + calls, key=lambda message: (message.stamp_ns, message.topic))
    for bag in (path, path.parent):
        read = read_with_rosbags(bag)
        assert_departure(in_order, sorted(read, key=lambda row: (row[1], row[0])))
    chunks = summary_of(path).chunk_indexes
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


def test_service_events_have_type_and_hash_of_the_installed_interface(tmp_path):
    summary = summary_of(record(Recorder(tmp_path), service_calls()))
    stored = {}
    for channel in summary.channels.values():
        if channel.topic.endswith('/_service_event'):
            schema = summary.schemas[channel.schema_id]
            assert schema.encoding == 'ros2idl'
            stored[channel.topic.split('/')[2], schema.name] = channel.metadata['topic_type_hash']
    assert set(stored) == {('new_route', 'std_srvs/srv/Trigger_Event'),
                           ('get_plan', 'nav_msgs/srv/GetPlan_Event')}
    for (_, type_), stored_hash in stored.items():
        interface = json.loads(schemas._read_interface(type_[:-6], 'json'))
        hashes = {each['type_name']: each['hash_string'] for each in interface['type_hashes']}
        assert stored_hash == hashes[type_]


def test_header_metadata_record_and_attachments(tmp_path):
    path = record(Recorder(tmp_path), departure(start_ns=0))
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        ((name, entries),) = [(each.name, each.metadata) for each in reader.iter_metadata()]
        (found,) = reader.iter_attachments()
    assert name == 'ambush_planner'
    read = {key: json.loads(text) for key, text in entries.items()}
    assert read == {'format': 8, **metadata_entries()}
    assert {found.name: found.data} == ATTACHMENTS and found.log_time == 0


def test_a_definition_that_is_not_installed_is_named():
    for name in ('no_such_msgs/msg/Thing', 'no_such_msgs/srv/Thing', 'nav_msgs/srv/Thing'):
        event = f'{name}_Event' if '/srv/' in name else name
        with pytest.raises(RecordingFailed, match=f'{name}.*install the package'):
            load_definition(event)


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
