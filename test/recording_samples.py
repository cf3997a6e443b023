# SPDX-License-Identifier: Apache-2.0
"""A departure with every kind of message, and independent readers to compare it with."""

import array
from functools import cache, partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message, serialize_message
from ros_harness import pose, risk_grid
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.recordings.encoding import encode
from ambush_planner.recordings.messages import RecordedMessage, qos_text, type_name

START_NS = 1_700_000_000_123_456_789
LATCHED, VOLATILE = qos_text(1, latched=True), qos_text(10, latched=False)
INPUTS = {'map': '/alpha_map', 'start': '/start_pose', 'goal': '/goal_pose', 'path': '/path'}
TYPES = (OccupancyGrid, PoseStamped, MarkerArray, PathMessage, DiagnosticArray)


def risk_map(*shape):
    return risk_grid(np.random.default_rng(1).integers(-1, 101, shape, dtype=np.int8))


def markers():
    lines = Marker(header=Header(frame_id='map'), ns='edges', type=Marker.LINE_LIST)
    lines.points = [Point(x=float(i), y=0.25 * i) for i in range(8)]
    lines.colors = [ColorRGBA(r=1.0, g=0.5, b=0.0, a=i / 8) for i in range(8)]
    return MarkerArray(markers=[lines])


def diagnostics():
    values = [KeyValue(key='value', value='0.35'), KeyValue(key='état', value='prêt')]
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name='planner', values=values)
    return DiagnosticArray(status=[status])


def path_message():
    poses = [pose(i / 3, -float(i)) for i in range(5)]
    return PathMessage(header=Header(frame_id='map'), poses=poses)


def recorded(topic, message, qos=VOLATILE, stamp_ns=START_NS):
    """A message of rclpy as a recording takes it."""
    return RecordedMessage(topic, type_name(message), serialize_message(message), qos, stamp_ns)


def departure(start_ns=START_NS, height=100):
    """Every kind of message that a departure has, a millisecond apart."""
    rows = [
        ('/alpha_map', risk_map(height, 2 * height), LATCHED),
        ('/start_pose', pose(1.5, 2.5), VOLATILE),
        ('/goal_pose', pose(-7.25, 1e-9), VOLATILE),
        ('/edge_probabilities', markers(), LATCHED),
        ('/path', path_message(), LATCHED),
        ('/diagnostics', diagnostics(), VOLATILE),
    ]
    return [
        recorded(topic, message, qos, start_ns + i * 1_000_000)
        for i, (topic, message, qos) in enumerate(rows)
    ]


# A departure whose file has a few kB.
small_departure = partial(departure, height=4)
ATTACHMENTS = {'strategy.npz': b'not a strategy, but bytes'}


def new_route_call(stamp_ns):
    """The entry about the call in the metadata of a departure."""
    return {
        'service': '/planner/new_route', 'type': 'std_srvs/srv/Trigger',
        'request_ns': stamp_ns, 'response_ns': stamp_ns,
        'request': {}, 'remarks': '',
    }


def metadata_entries():
    """All entries of the metadata record."""
    return {
        'departure_id': 'a5c0', 'departure': 1, 'frame': 'map',
        'versions': {'ambush_planner': '0.1.0', 'python': '3.12.3'},
        'parameters': {'seed': -1}, 'topics': INPUTS, 'route': [[0, 1]],
        'route_entropy_source': [2**255 + 1],
        'trip': {'start': [1.5, 2.5], 'goal': [3.0, 4.0], 'stops': []},
        'ends': [[1.5, 2.5], [3.0, 4.0]], 'joined': False, 'value': 0.0,
        'call': new_route_call(START_NS),
    }


def file_of(messages, compression='zstd'):
    """The bytes of a whole recording of these messages."""
    return encode(messages, metadata_entries(), ATTACHMENTS, compression)


def record(recorder, messages):
    """Record messages with the metadata of a departure."""
    return recorder.record_departure(messages, metadata_entries(), ATTACHMENTS)


def message_of(recorded):
    """The message of rclpy that was recorded."""
    (class_,) = [type_ for type_ in TYPES if type_name(type_) == recorded.type]
    return deserialize_message(recorded.data, class_)


def fields(message):
    """The parts of a recorded message that come back from a file."""
    return (message.topic, message.type, message.data, message.qos, message.stamp_ns)


def assert_same(sent, read):
    """Compare a message of rclpy with one of another reader, field by field."""
    if hasattr(sent, 'get_fields_and_field_types'):
        for field in sent.get_fields_and_field_types():
            assert_same(getattr(sent, field), getattr(read, field))
    elif isinstance(sent, (list, tuple, array.array, np.ndarray)):
        assert len(sent) == len(read)
        for one, other in zip(sent, read, strict=True):
            assert_same(one, other)
    elif isinstance(sent, bytes):  # rclpy has bytes where others have an octet's number
        assert sent == (read if isinstance(read, bytes) else bytes([read]))
    else:
        assert sent == read


def assert_departure(sent, read):
    """``read`` holds (topic, time, message) of the same departure."""
    assert [(m.topic, m.stamp_ns) for m in sent] == [row[:2] for row in read]
    for message, row in zip(sent, read, strict=True):
        assert_same(message_of(message), row[2])


@cache
def any_reader():
    """The reader of rosbags; its parsers are slow, and the tests' files share all definitions."""
    anyreader = pytest.importorskip('rosbags.highlevel.anyreader')
    anyreader.get_types_from_msg = cache(anyreader.get_types_from_msg)
    return anyreader.AnyReader


def read_with_rosbags(path):
    with any_reader()([path]) as reader:
        return [
            (connection.topic, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]


def read_with_mcap_ros2(path):
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(channel.topic, message.log_time, decoded)
                for _, channel, message, decoded in reader.iter_decoded_messages()]
