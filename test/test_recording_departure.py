"""A recorded departure: its messages by their roles, decoded, or a clear error."""

from dataclasses import replace

import pytest
from rclpy.serialization import serialize_message
from recording_samples import (
    METADATA,
    assert_same,
    departure,
    fields,
    message_of,
    path_message,
    small_departure,
    trigger_events,
)

from ambush_planner.recording import Recorder, UnreadableRecording, read_departure, type_name


def test_messages_by_their_roles(tmp_path):
    sent = {m.topic: m for m in departure()}
    read = read_departure(Recorder(tmp_path).record_departure(list(sent.values()), METADATA))
    for role, topic in read.yaml('inputs').items():
        assert fields(read.recorded(role)) == fields(sent[topic])
        assert_same(message_of(sent[topic]), read.message(role))


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (lambda data: data[:-9], 'not a Path'),
        (lambda data: data[:4], 'not a Path'),
        (lambda data: data + bytes(4), 'bytes where a Path of its fields has'),
        (lambda data: data[:4] + b'\xff' * (len(data) - 4), 'not a Path'),
    ],
)
def test_data_that_is_not_of_its_type(tmp_path, data, reason):
    sent = small_departure()
    sent[3] = replace(sent[3], data=data(sent[3].data))
    read = read_departure(Recorder(tmp_path).record_departure(sent, METADATA))
    with pytest.raises(UnreadableRecording, match=reason):
        read.message('path')


def test_padding_at_the_end_of_data_is_no_fault(tmp_path):
    sent = small_departure()
    sent[3] = replace(sent[3], data=serialize_message(path_message()) + bytes(3))
    read = read_departure(Recorder(tmp_path).record_departure(sent, METADATA))
    assert_same(path_message(), read.message('path'))


def test_roles_that_are_not_there(tmp_path):
    def refused(messages, inputs, role, reason):
        metadata = METADATA | {'inputs': inputs}
        read = read_departure(Recorder(tmp_path).record_departure(messages, metadata))
        with pytest.raises(UnreadableRecording, match=reason):
            read.message(role)

    sent = small_departure()
    refused(sent, METADATA['inputs'], 'spare', "names no topic for 'spare'")
    refused(sent, '[', 'map', "entry 'inputs' is not YAML")
    refused(sent, '3', 'map', "names no topic for 'map'")
    refused(sent[1:], METADATA['inputs'], 'map', "0 messages in the role 'map'")
    refused([*sent, sent[0]], METADATA['inputs'], 'map', "2 messages in the role 'map'")
    unknown = [replace(sent[0], topic='/other'), *sent[1:]]
    refused(unknown, '{map: [1]}', 'map', '0 messages')


def test_a_type_that_is_not_recorded_and_entries_that_are_missing(tmp_path):
    read = read_departure(Recorder(tmp_path).record_departure(small_departure(), METADATA))
    for type_ in ('no_such_msgs/msg/Thing', 'nav_msgs/msg/Odometry', 'Path', 'nav_msgs/srv/X'):
        with pytest.raises(UnreadableRecording, match='the planner records nothing of type'):
            read.decode(replace(read.messages[0], type=type_))
    with pytest.raises(UnreadableRecording) as caught:
        read.decode(replace(read.messages[0], topic='/\x1b[2J' + 'x' * 999, type='\x1b[2J' * 99))
    assert str(caught.value).isprintable() and len(str(caught.value)) < 500
    with pytest.raises(UnreadableRecording, match="no entry 'trip'"):
        read.yaml('trip')
    with pytest.raises(UnreadableRecording, match="no attachment 'strategy.npz'"):
        read.attachment('strategy.npz')


def test_a_stamp_that_is_no_time_is_refused():
    for stamp in (-1, 2**63):
        with pytest.raises(ValueError, match='not a ROS time'):
            replace(small_departure()[0], stamp_ns=stamp)


def test_names_of_types():
    for message in (path_message(), trigger_events()[0]):
        assert type_name(message) == type_name(type(message))
    assert type_name(path_message()) == 'nav_msgs/msg/Path'
    assert type_name(trigger_events()[0]) == 'std_srvs/srv/Trigger_Event'
