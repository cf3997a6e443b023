# SPDX-License-Identifier: Apache-2.0
"""``ambush replay``: publish recorded departures again, as they were published."""

from __future__ import annotations

import argparse
import signal
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AmbushPlannerError, shown
from . import cli, readers

if TYPE_CHECKING:
    from ..recordings.messages import Channel
    from ..recordings.recording_file import RecordingFile

NODE_NAME = 'ambush_replay'
EPILOG = """\
Publishes the recorded bytes on the recorded topics, with the recorded quality of service and
timing; departures are --every seconds apart. First waits for listeners on each topic, for up to
3.5 s, or 10 s with --inputs-only. Keeps latched messages for late joiners until all listeners
have them (for 30 s at most), or until Ctrl-C with --keep. Remapping and node options follow
--ros-args at the end, as for any ROS executable:
  ambush replay FOLDER --keep --topics /alpha_map /path
  ambush replay FOLDER --inputs-only --ros-args -r /alpha_map:=/convoy/alpha_map
--json: {"verdict", "published": {topic: messages}, "unreadable"}
Ctrl-C ends it with exit code 0.
"""
# Longest wait for listeners [s]; discovery takes up to 3.3 s, and a planner may just be starting.
_DISCOVERY, _DISCOVERY_OF_INPUTS = 3.5, 10.0
# A listener that was discovered discovers the publisher a little later [s].
_SETTLING = 0.5
# Longest wait for receipts [s]: a listener loses messages when their publisher goes.
_LAST_RECEIPTS = 30.0
_STEP = 0.1  # s; how soon the end of a wait is noticed
_ENDS = signal.SIGINT, signal.SIGTERM


class NothingToPublish(AmbushPlannerError):
    """The recordings hold no message that was asked for."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = readers.reader_parser(
        'replay', 'Publish recorded departures again, for RViz or for a running planner.', EPILOG
    )
    made.add_argument('-e', '--every', type=cli.number(0.0, 1e6), default=5.0, metavar='SECONDS',
                      help='time from one departure to the next (default: %(default)s)')
    made.add_argument('-r', '--rate', type=cli.number(1e-6, 1e9), default=1.0,
                      help='how many times as fast as recorded (default: %(default)s)')
    made.add_argument('-k', '--keep', action='store_true',
                      help='keep latched messages until Ctrl-C')
    made.add_argument('--inputs-only', action='store_true',
                      help='publish only map, start, stops and goal, to feed a running planner')
    made.add_argument('--topics', nargs='+', metavar='TOPIC',
                      help='publish only these topics, by their recorded names')
    made.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[],
                      help='arguments of the ROS node')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # Handlers are set even where a shell's background job would ignore SIGINT.
    for number in _ENDS:
        signal.signal(number, _end_once)
    replay = _Replay(options, console)
    try:
        try:
            rclpy.init(args=[NODE_NAME, '--ros-args', *options.ros_args],
                       signal_handler_options=SignalHandlerOptions.NO)
        except (RuntimeError, UnicodeError) as error:
            raise cli.UsageError(f'after --ros-args: {error}') from error
        node = rclpy.create_node(NODE_NAME, start_parameter_services=False)
        try:
            replay.run(node)
        finally:
            node.destroy_node()
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()
    console.result = {'published': dict(replay.published), 'unreadable': replay.unreadable}
    return cli.Exit.UNREADABLE if replay.unreadable else cli.Exit.HOLDS


class _Replay:
    """Makes all publishers first, then publishes message after message in time."""

    def __init__(self, options: argparse.Namespace, console: cli.Console) -> None:
        self._options, self._console = options, console
        self.unreadable: list[str] = []
        self.published: Counter[str] = Counter()
        self._publishers: dict[Channel, Any] = {}
        self._due = 0.0

    def run(self, node: Any) -> None:
        """Publish until the end or until KeyboardInterrupt."""
        files = self._files()
        self._advertise(node, set().union(*files.values()))
        self._console.say(cli.count(len(files), 'departure'))
        if unheard := self._wait_for_listeners():
            self._console.say(f'nobody listens to {", ".join(unheard)}')
        self._publish(files)
        if missing := self._wait_for_receipts():
            self._console.say(f'some listeners have not received all of {", ".join(missing)}')
        if self._options.keep:
            self._console.say('everything is published; Ctrl-C ends it')
            while True:
                signal.pause()

    def _files(self) -> Mapping[Path, set[Channel]]:
        """Return the readable files with their channels."""
        from ..recordings.recorded_departures import recordings_in
        from ..recordings.recording_errors import UnreadableRecording
        from ..recordings.recording_file import read_recording

        paths = recordings_in(self._options.recordings)
        found = {}
        for path in self._console.progress(paths, 'read'):
            try:
                found[path] = own_channels(read_recording(path))
            except UnreadableRecording as error:
                self.unreadable.append(str(error))
                self._console.error(error)
        if not found:
            raise NothingToPublish('none of the recordings can be read')
        return found

    def _advertise(self, node: Any, known: set[Channel]) -> None:
        from ..recordings.schemas import INPUT_TYPES

        topics = sorted({channel.topic for channel in known})
        if missing := set(self._options.topics or topics).difference(topics):
            raise NothingToPublish(
                f'nothing is recorded on {", ".join(sorted(missing))}, only on {", ".join(topics)}'
            )
        self._publishers = {
            channel: publisher_of(node, channel) for channel in sorted(known)
            if channel.topic in (self._options.topics or topics)
            and (channel.type in chain(*INPUT_TYPES.values()) or not self._options.inputs_only)
        }
        if not self._publishers:
            raise NothingToPublish('none of these topics is an input')

    def _publish(self, files: Iterable[Path]) -> None:
        """Publish everything in time."""
        from ..recordings.recording_file import read_recording

        for path in files:
            messages = [each for each in read_recording(path).messages
                        if each.channel in self._publishers]
            if not messages:
                continue
            _sleep_until(self._due)
            begin = time.monotonic()
            self._due = begin + self._options.every
            for each in messages:
                recorded = (each.stamp_ns - messages[0].stamp_ns) / 1e9
                _sleep_until(begin + recorded / self._options.rate)
                self._publishers[each.channel].publish(each.data)
                self.published[each.topic] += 1
            self._console.say(f'{cli.place(path)}: {cli.count(len(messages), "message")}')

    def _wait_for_listeners(self) -> list[str]:
        """Wait until each topic has a listener; return the topics without one."""
        limit = _DISCOVERY_OF_INPUTS if self._options.inputs_only else _DISCOVERY
        end = time.monotonic() + limit
        while self._unheard() and time.monotonic() < end:
            time.sleep(_STEP)
        time.sleep(_SETTLING)
        return self._unheard()

    def _wait_for_receipts(self) -> list[str]:
        """Wait until all reliable listeners have everything; return the topics that lack some."""
        from rclpy.duration import Duration

        end = time.monotonic() + _LAST_RECEIPTS
        waiting = list(self._publishers.values())
        while waiting and time.monotonic() < end:
            waiting = [each for each in waiting
                       if not each.wait_for_all_acked(Duration(seconds=_STEP))]
        return sorted({each.topic_name for each in waiting})

    def _unheard(self) -> list[str]:
        publishers = self._publishers.values()
        return sorted({each.topic_name for each in publishers if not each.get_subscription_count()})


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
