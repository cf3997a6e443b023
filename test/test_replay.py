# SPDX-License-Identifier: Apache-2.0
"""Recordings of a real node go out again over DDS."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import contextmanager
from dataclasses import replace
from itertools import accumulate

import pytest
from commands import run_here
from forging import NEW_ROUTE, Forger
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_harness import free_domain, ros_context, spinning
from waiting import TIMEOUT, wait_until

from ambush_planner.commands import replay
from ambush_planner.commands.replay import _message_class, qos_from_yaml
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.schemas import definitions

# The command, which finds who listens on a slow machine, too.
COMMAND = f"""
import sys
from ambush_planner.commands import replay
replay._DISCOVERY = {TIMEOUT}
sys.exit(replay.main())
"""
# A message from the network may have up to three bytes of padding at its end.
PADDING = 3


@pytest.fixture(scope='module')
def slow(files, tmp_path_factory):
    """A departure whose nine messages are 0.1 s apart."""
    return paced(files[NEW_ROUTE], [0.1] * 8, tmp_path_factory.mktemp('slow') / 'slow.mcap')


def paced(path, pauses, target):
    """The same departure with these pauses [s] between its messages."""
    forger = Forger(path)
    stamps = accumulate((round(pause * 1e9) for pause in pauses), initial=10**18)
    forger.messages = [replace(message, stamp_ns=stamp)
                       for message, stamp in zip(forger.messages, stamps, strict=True)]
    return forger.save(target)


class Listener:
    """Keeps what comes on topics, with the time, as the bytes that they are."""

    def __init__(self, node):
        self.node = node
        self.received = {}

    def listen(self, topic, kind, qos):
        got = self.received[topic] = []
        self.node.create_subscription(
            kind, topic, lambda data: got.append((time.monotonic(), data)), qos, raw=True
        )

    def count(self):
        return sum(map(len, self.received.values()))

    def span(self):
        times = sorted(at for got in self.received.values() for at, _ in got)
        return times[-1] - times[0]


@contextmanager
def listener(messages=()):
    """A listener to all topics of the messages, in a domain of its own; also that domain."""
    with free_domain() as domain, ros_context(domain) as context:
        node = Node('listener', context=context)
        found = Listener(node)
        for message in messages:
            if message.topic not in found.received:
                qos = qos_from_yaml(message.qos)
                qos.depth = max(qos.depth, 100)  # no later message takes an earlier one's place
                found.listen(message.topic, _message_class(message.type), qos)
        with spinning(node, SingleThreadedExecutor(context=context)):
            yield found, domain


@contextmanager
def replaying(domain, *arguments):
    process = subprocess.Popen(
        [sys.executable, '-c', COMMAND, *map(str, arguments)],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONFAULTHANDLER': '1'},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def replayed(domain, *arguments):
    """The exit code of the command, run in this process, and its standard error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replay, '_DISCOVERY', TIMEOUT)
        patch.setenv('ROS_DOMAIN_ID', str(domain))
        done = run_here(replay, *arguments)
    return done.code, done.err


def is_same(data, recorded):
    return data.startswith(recorded) and len(data) - len(recorded) <= PADDING


def assert_received(found, messages):
    """Each topic has received the messages on it, in their order and byte for byte."""
    try:
        wait_until(lambda: found.count() >= len(messages), 'all messages')
    except AssertionError as error:
        counts = {topic: len(got) for topic, got in found.received.items()}
        raise AssertionError(f'{error}; received: {counts}') from None
    for topic, got in found.received.items():
        sent = [message.data for message in messages if message.topic == topic]
        assert len(got) == len(sent), topic
        assert all(is_same(data, one) for (_, data), one in zip(got, sent, strict=True)), topic


def test_a_folder_is_one_timeline(slow, tmp_path):
    forger = Forger(slow)
    for k in range(3):
        one = Forger(slow)
        one.messages = [replace(m, stamp_ns=m.stamp_ns + k * 3600 * 10**9) for m in forger.messages]
        one.save(tmp_path / f'run_{k}.mcap')
    with listener(forger.messages) as (found, domain):
        code, _ = replayed(
            domain, tmp_path, '--every', '1', '--ros-args', '-r', '__node:=again')
        assert_received(found, forger.messages * 3)
        # Not the hours that passed between them.
        assert 2.0 < found.span() < 300.0
    assert code == 0


def test_listeners_get_the_same_bytes_in_order_and_latched_topics_until_sigint(slow):
    messages = read_recording(slow).messages
    names = {message.topic: message for message in messages}
    with listener(messages) as (found, domain), \
            replaying(domain, slow, '--keep') as process:  # as a user starts it
        assert_received(found, messages)
        assert process.poll() is None
        for topic, message in names.items():
            (offered,) = found.node.get_publishers_info_by_topic(topic)
            assert offered.qos_profile.durability == qos_from_yaml(message.qos).durability, topic
            assert offered.qos_profile.reliability == qos_from_yaml(message.qos).reliability, topic
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT) == 0
        said = process.stderr.read()
    assert 'nobody listens' not in said and 'Traceback' not in said
    assert 'slow.mcap: 9 messages' in said


FOREIGN = (
    ({'type': 'antigravity/msg/Any'}, 'x.mcap would publish antigravity/msg/Any on /path'),
    ({'topic': '/cmd_vel', 'type': 'geometry_msgs/msg/Twist'}, 'Twist on /cmd_vel'),
    ({'topic': '/plan'}, 'nav_msgs/msg/Path on /plan'),
    ({'type': 'geometry_msgs/msg/PoseStamped'}, 'PoseStamped on /path'),
    ({'topic': '/rosout', 'type': 'diagnostic_msgs/msg/DiagnosticArray'}, 'Array on /rosout'),
    ({'topic': '/x/markers', 'type': 'visualization_msgs/msg/MarkerArray'}, 'on /x/markers'),
    ({'topic': '/\x1b[2J'}, r'on /\x1b[2J'),
    ({'qos': '[{history: 1}]'}, '/path cannot be published'),
    ({'qos': 'x'}, '/path cannot be published'))


def test_what_recordings_do_not_hold_is_refused_and_nothing_is_published(
        slow, tmp_path, monkeypatch):
    shutil.copy(slow, tmp_path / 'a.mcap')
    path_text = definitions()['nav_msgs/msg/Path']
    monkeypatch.setattr('ambush_planner.recordings.encoding.definitions',
                        lambda: defaultdict(lambda: path_text, definitions()))
    with listener() as (found, domain):
        found.listen('/goal_pose', PoseStamped, 1)
        for change, words in FOREIGN:
            forger = Forger(slow)
            forger.messages = [replace(each, **change) if each.topic == '/path' else each
                               for each in forger.messages]
            forger.save(tmp_path / 'x.mcap')
            code, said = replayed(domain, tmp_path)
            assert (code, found.count()) == (2, 0) and words in said, said
    assert 'antigravity' not in sys.modules


def test_wrong_usage(slow):
    with free_domain() as domain:
        for arguments, code, words in (
                (['none.mcap'], 3, 'No such file'),
                ([__file__], 3, 'damaged or not an MCAP file'),
                ([slow, '--rate', '2'], 2, '--rate was removed: leave it out, or play'),
                ([slow, '--every', 'nan'], 2, '--every'),
                ([slow, '--ros-args', '-x'], 2, 'after --ros-args')):
            ended, said = replayed(domain, *arguments)
            assert ended == code and words in said, (arguments, said)
