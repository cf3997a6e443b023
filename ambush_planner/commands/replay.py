# SPDX-License-Identifier: Apache-2.0
"""``ambush replay``: publish recorded departures again, as they were published."""

from __future__ import annotations

import argparse
import signal
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AmbushPlannerError, shown
from . import cli, readers

if TYPE_CHECKING:
    from ..recordings.messages import Channel
    from ..recordings.recording_file import RecordingFile

    Publishers = Mapping[Channel, Any]

NODE_NAME = 'ambush_replay'
EPILOG = """\
Publishes the recorded bytes on the recorded topics, with the recorded quality of service and
timing; departures are --every seconds apart. First waits for listeners on each topic, for up to
3.5 s. Keeps latched messages for late joiners until all listeners have them (for 30 s at most), or
until Ctrl-C with --keep. Remapping and node options follow --ros-args at the end, as for any ROS
executable:
  ambush replay FOLDER --keep --ros-args -r /path:=/convoy/way
Some topics only, or another rate: ros2 bag play FILE.mcap --topics /alpha_map --rate 2
--json: {"verdict", "published": {topic: messages}, "unreadable"}
Ctrl-C ends it with exit code 0.
"""
# Longest wait for listeners [s]; discovery takes up to 3.3 s.
_DISCOVERY = 3.5
# A listener that was discovered discovers the publisher a little later [s].
_SETTLING = 0.5
# Longest wait for receipts [s]: a listener loses messages when their publisher goes.
_LAST_RECEIPTS = 30.0
_STEP = 0.1  # s; how soon the end of a wait is noticed
_ENDS = signal.SIGINT, signal.SIGTERM


class NothingToPublish(AmbushPlannerError):
    """None of the recordings can be read."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'replay', 'Publish recorded departures again, for RViz.', EPILOG)
    made.add_argument('-e', '--every', type=cli.number(0.0, 1e6), default=5.0, metavar='SECONDS',
                      help='time from one departure to the next (default: %(default)s)')
    made.add_argument('-k', '--keep', action='store_true',
                      help='keep latched messages until Ctrl-C')
    made.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                      help='arguments of the ROS node')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # Handlers are set even where a shell's background job would ignore SIGINT.
    for number in _ENDS:
        signal.signal(number, _end_once)
    files, unreadable = _files(options.recordings, console)
    published: Counter[str] = Counter()
    try:
        try:
            rclpy.init(args=[NODE_NAME, '--ros-args', *options.ros_args],
                       signal_handler_options=SignalHandlerOptions.NO)
        except (RuntimeError, UnicodeError) as error:
            raise cli.UsageError(f'after --ros-args: {error}') from error
        node = rclpy.create_node(NODE_NAME, start_parameter_services=False)
        try:
            publishers = {channel: publisher_of(node, channel)
                          for channel in sorted(set().union(*files.values()))}
            console.say(cli.count(len(files), 'departure'))
            if unheard := _wait_for_listeners(publishers.values()):
                console.say(f'nobody listens to {", ".join(unheard)}')
            _publish(files, publishers, options.every, published, console)
            if missing := _wait_for_receipts(publishers.values()):
                console.say(f'some listeners have not received all of {", ".join(missing)}')
            while options.keep:
                console.say('everything is published; Ctrl-C ends it')
                signal.pause()
        finally:
            node.destroy_node()
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()
    console.result = {'published': dict(published), 'unreadable': unreadable}
    return cli.Exit.UNREADABLE if unreadable else cli.Exit.HOLDS


def _files(place: Path, console: cli.Console) -> tuple[Mapping[Path, set[Channel]], list[str]]:
    """Return the readable files with their channels, and the errors of the others."""
    from ..recordings.recorded_departures import recordings_in
    from ..recordings.recording_errors import UnreadableRecording
    from ..recordings.recording_file import read_recording

    found, unreadable = {}, []
    for path in console.progress(recordings_in(place), 'read'):
        try:
            found[path] = own_channels(read_recording(path))
        except UnreadableRecording as error:
            unreadable.append(str(error))
            console.error(error)
    if not found:
        raise NothingToPublish('none of the recordings can be read')
    return found, unreadable


def _publish(files: Iterable[Path], publishers: Publishers, every: float, published: Counter[str],
             console: cli.Console) -> None:
    """Publish all messages in time, and count them by topic."""
    from ..recordings.recording_file import read_recording

    due = 0.0
    for path in files:
        messages = read_recording(path).messages
        _sleep_until(due)
        begin = time.monotonic()
        due = begin + every
        for each in messages:
            _sleep_until(begin + (each.stamp_ns - messages[0].stamp_ns) / 1e9)
            publishers[each.channel].publish(each.data)
            published[each.topic] += 1
        console.say(f'{cli.place(path)}: {cli.count(len(messages), "message")}')


def _wait_for_listeners(publishers: Iterable[Any]) -> list[str]:
    """Wait until each topic has a listener; return the topics without one."""
    end, unheard = time.monotonic() + _DISCOVERY, [*publishers]
    while unheard and time.monotonic() < end:
        time.sleep(_STEP)
        unheard = [each for each in unheard if not each.get_subscription_count()]
    time.sleep(_SETTLING)
    return sorted({each.topic_name for each in unheard})


def _wait_for_receipts(publishers: Iterable[Any]) -> list[str]:
    """Wait until all reliable listeners have everything; return the topics that lack some."""
    from rclpy.duration import Duration

    end, waiting = time.monotonic() + _LAST_RECEIPTS, [*publishers]
    while waiting and time.monotonic() < end:
        waiting = [each for each in waiting
                   if not each.wait_for_all_acked(Duration(seconds=_STEP))]
    return sorted({each.topic_name for each in waiting})


def own_channels(file: RecordingFile) -> set[Channel]:
    """Return the channels of a recording; raises UsageError if it holds others than ours do."""
    from ..recordings.metadata import typed
    from ..recordings.recording_errors import part
    from ..recordings.schemas import DIAGNOSTICS, MARKER_NAMES, MARKERS, ROLE_TYPES

    roles: Mapping[str, str] = part(file.path, 'topics', lambda: typed(
        file.entries['topics'], Mapping[str, str], 'topics'))
    own = {(kind, topic) for role, topic in roles.items() for kind in ROLE_TYPES.get(role, ())}
    own.add(DIAGNOSTICS)
    found = {each.channel for each in file.messages}
    for topic, kind, _ in sorted(found):
        marker = kind == MARKERS and topic.rpartition('/')[2] in MARKER_NAMES
        if not marker and (kind, topic) not in own:
            raise cli.UsageError(
                f'{cli.place(file.path)} would publish {shown(kind)} on {shown(topic)}, which no '
                'recording of this planner does; nothing is published. If you trust the file, '
                'play it with ros2 bag play')
    return found


def publisher_of(node: Any, channel: Channel) -> Any:
    """Return a publisher like the recorded one; raises UsageError if there can be none."""
    try:
        return node.create_publisher(_message_class(channel.type), channel.topic,
                                     qos_from_yaml(channel.qos))
    except Exception as error:  # names and quality of service are whatever the file says
        raise cli.UsageError(f'{shown(channel.topic)} cannot be published: its name or its quality '
                             f'of service is invalid ({type(error).__name__})') from error


def qos_from_yaml(text: str) -> Any:
    """Return the profile (rclpy) of a channel; those of recordings are all reliable."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    from ..recordings.messages import fields_from_yaml

    fields = fields_from_yaml(text)
    return QoSProfile(depth=fields['depth'],
                      durability=DurabilityPolicy.get_from_short_key(fields['durability']))


def _message_class(name: str) -> Any:
    """Return the class of a recorded type such as ``nav_msgs/msg/Path``, one of ours."""
    package, kind, short_name = name.split('/')
    return getattr(import_module(f'{package}.{kind}'), short_name)


def _end_once(*_: object) -> None:
    """Interrupt the replay; a second signal must not interrupt its end."""
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _sleep_until(end: float) -> None:
    """Sleep until ``time.monotonic()`` is ``end``."""
    time.sleep(max(0.0, end - time.monotonic()))


main = cli.command(parser, _work)
