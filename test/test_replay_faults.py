"""ambush_replay where files or arguments are wrong, clocks jump, listeners hang."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
import yaml
from damage import flips, truncations
from forging import NEW_ROUTE, Forger, record_runs
from rclpy.qos import QoSProfile
from ros_harness import free_domain

from ambush_planner.commands import replay
from ambush_planner.commands.replay import main
from ambush_planner.commands.replay_player import CannotPublish, Channel, Player, qos_from_yaml
from ambush_planner.recordings.mcap_file import decode
from ambush_planner.recordings.qos_text import qos_to_yaml

LISTENER = """
import rclpy
from geometry_msgs.msg import PoseStamped
rclpy.init()
node = rclpy.create_node('listener')
node.create_subscription(PoseStamped, '/goal_pose', lambda _: print('received', flush=True), 10)
print('listening', flush=True)
rclpy.spin(node)
"""


@pytest.fixture(scope='module')
def departure(tmp_path_factory):
    return record_runs(tmp_path_factory)[NEW_ROUTE]


@pytest.fixture
def domain(monkeypatch):
    """A domain of its own for commands in this process; they wait for no listeners."""
    with free_domain() as number:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        monkeypatch.setattr(replay, '_DISCOVERY', 0.0)
        yield number


def run(*arguments):
    try:
        return main([str(each) for each in arguments])
    except SystemExit as stop:
        return stop.code


def spread(departure, path, *gaps):
    """A copy of the departure with these pauses [s] after its first messages."""
    forger = Forger(departure)
    ordered = sorted(forger.messages, key=lambda message: message.stamp_ns)
    places = [sum(gaps[:k]) for k in range(len(ordered))]
    forger.messages = [
        replace(message, stamp_ns=round(place * 1e9))
        for message, place in zip(ordered, places, strict=True)
    ]
    return forger.save(path)


def test_a_topic_of_two_types(departure, tmp_path, domain, capfd):
    forger = Forger(departure)
    other = replace(forger.messages[forger.place('path')], topic='/diagnostics')
    forger.messages.append(other)
    path = forger.save(tmp_path / 'two.mcap')
    assert run(path) == 3
    err = capfd.readouterr().err
    assert 'ambush_replay: /diagnostics cannot be published as' in err and 'after --' in err
    assert run(path, '--rate', 1000, '--', '/path') == 0


@pytest.mark.parametrize(('arguments', 'words'), [
    (['--enclave', 'x'], 'Enclave name is not valid'),
    (['-r', '__ns:=' + os.fsdecode(b'/\xff')], 'after --ros-args'),
])
def test_what_ros_is_told_cannot_be_done(departure, domain, capfd, arguments, words):
    assert run(departure, '--ros-args', *arguments) == 2
    assert words in capfd.readouterr().err


@pytest.mark.parametrize('changed', [
    {'history': 'unknown'}, {'reliability': 'unknown'}, {'durability': 'unknown'},
    {'liveliness': 'unknown'}, {'depth': -1}, {'depth': 2**31}, {'depth': 2**70},
    {'deadline': {'sec': 9223372036, 'nsec': 854775808}},
    {'lifespan': {'sec': 1e300, 'nsec': 0}},
])
def test_profiles_that_no_publisher_can_have(changed):
    (fields,) = yaml.safe_load(qos_to_yaml(QoSProfile(depth=1)))
    with pytest.raises(ValueError):
        qos_from_yaml(yaml.safe_dump([{**fields, **changed}]))


@pytest.mark.parametrize('error', [RuntimeError('no\nmore'), TypeError('no'), OverflowError('no')])
def test_what_the_middleware_refuses_is_told(error):
    class Refusing:
        def create_publisher(self, *_):
            raise error

    with pytest.raises(CannotPublish, match='^/path cannot be published as .*: no; name'):
        Player(Refusing()).advertise(
            Channel('/path', 'nav_msgs/msg/Path', qos_to_yaml(QoSProfile(depth=1)))
        )


def test_signals_are_handled_as_before_when_it_has_ended(departure, tmp_path, domain):
    def mine(*_):
        pass

    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, mine) for number in numbers]
    try:
        for path in (departure, tmp_path / 'none'):
            run(path, '--rate', 1000)
            assert [signal.getsignal(number) for number in numbers] == [mine, mine]
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


@pytest.mark.parametrize('seed', range(5))
def test_damaged_files_are_refused(seed, departure, tmp_path, domain, capfd):
    """200 truncations and 500 flipped bits in all: every byte of a recording is covered."""
    data = departure.read_bytes()
    path = tmp_path / 'damaged.mcap'
    cases = truncations(data, 200)[seed::5] + [*flips(data, 100, np.random.default_rng(seed))]
    for changed in cases:
        path.write_bytes(changed)
        code = run(path, '--rate', 10**9)
        said = capfd.readouterr().err
        assert 'Traceback' not in said
        if code:
            assert f'ambush_replay: {path} is not readable as a recording: ' in said
        else:  # a bit that no reader minds
            same = decode(changed)
            same.library = decode(data).library
            assert same == decode(data)


@pytest.mark.slow
def test_a_listener_that_stands_still_for_a_while_loses_nothing(departure, tmp_path):
    for name in ('1.mcap', '2.mcap'):
        spread(departure, tmp_path / name)
    with free_domain() as domain, ExitStack() as stack:
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}

        def started(*arguments, **pipes):
            process = subprocess.Popen([sys.executable, *arguments], env=environment, text=True,
                                       **pipes)
            stack.callback(process.communicate)
            stack.callback(process.kill)
            return process

        listener = started('-c', LISTENER, stdout=subprocess.PIPE)
        assert listener.stdout.readline() == 'listening\n'
        replay = started('-m', 'ambush_planner.commands.cli', 'replay', str(tmp_path),
                         '--every', '10', '--', '/goal_pose', stderr=subprocess.PIPE)
        assert listener.stdout.readline() == 'received\n'
        listener.send_signal(signal.SIGSTOP)
        for name in ('1.mcap', '2.mcap'):
            wait_for_line(replay, f'{name}: 1 message')
        # Longer than it takes to send; the publisher must outlast it.
        time.sleep(3.0)
        assert replay.poll() is None
        listener.send_signal(signal.SIGCONT)
        _, said = replay.communicate(timeout=60)
        assert (replay.returncode, said) == (0, '')
        assert listener.stdout.readline() == 'received\n'


def wait_for_line(process, word):
    for line in process.stderr:
        if word in line:
            return
    raise AssertionError(f'it did not say {word}')
