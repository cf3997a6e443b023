"""A departure with every kind of message, and independent readers to compare it with."""

import array

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.recording import RecordedMessage

START_NS = 1_700_000_000_123_456_789
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
VOLATILE = QoSProfile(depth=10)
METADATA = {'planner_version': '0.1.0', 'seed': '7', 'input_sha256': 'ab' * 32}


def pose(x, y):
    message = PoseStamped(header=Header(frame_id='map'))
    message.pose.position.x, message.pose.position.y = x, y
    return message


def risk_map(height=40, width=60):
    message = OccupancyGrid(header=Header(frame_id='map'))
    message.info.width, message.info.height, message.info.resolution = width, height, 0.5
    cells = np.random.default_rng(1).integers(-1, 101, width * height, dtype=np.int8)
    message.data = array.array('b', cells.tobytes())
    return message


def markers():
    lines = Marker(header=Header(frame_id='map'), ns='edges', type=Marker.LINE_LIST)
    lines.points = [Point(x=float(i), y=0.25 * i) for i in range(8)]
    lines.colors = [ColorRGBA(r=1.0, g=0.5, b=0.0, a=i / 8) for i in range(8)]
    return MarkerArray(markers=[lines])


def diagnostics():
    values = [KeyValue(key='value', value='0.35'), KeyValue(key='état', value='prêt')]
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name='planner', values=values)
    return DiagnosticArray(status=[status])


def departure(start_ns=START_NS):
    """Every kind of message that a departure has, a millisecond apart."""
    path = PathMessage(
        header=Header(frame_id='map'), poses=[pose(i / 3, -float(i)) for i in range(5)]
    )
    rows = [
        ('/alpha_map', risk_map(), LATCHED),
        ('/start_pose', pose(1.5, 2.5), VOLATILE),
        ('/goal_pose', pose(-7.25, 1e-9), VOLATILE),
        ('/edge_probabilities', markers(), LATCHED),
        ('/path', path, LATCHED),
        ('/diagnostics', diagnostics(), VOLATILE),
    ]
    return [
        RecordedMessage(topic, message, qos, start_ns + i * 1_000_000)
        for i, (topic, message, qos) in enumerate(rows)
    ]


def assert_same(sent, read):
    """Compare a message of rclpy with one of another reader, field by field."""
    if hasattr(sent, 'get_fields_and_field_types'):
        for field in sent.get_fields_and_field_types():
            assert_same(getattr(sent, field), getattr(read, field))
    elif isinstance(sent, (list, tuple, array.array)):
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
        assert_same(message.message, row[2])


def read_with_rosbags(path):
    with AnyReader([path]) as reader:
        return [
            (connection.topic, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]


def read_with_mcap_ros2(path):
    with path.open('rb') as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
