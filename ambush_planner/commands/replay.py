"""``ambush_replay``: publish recorded departures again, as they were published."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import AmbushPlannerError
from ..recordings import RecordedMessage, UnreadableRecording, read_recording, recordings_in
from ..recordings.qos_text import DURATIONS, fields_from_yaml
from . import cli

NODE_NAME = 'ambush_replay'
EPILOG = """\
The recorded bytes go out on the recorded topics, with the recorded quality of service and at the
recorded distances in time; departures are --every seconds apart. Publishers are made first and
wait for listeners on each topic for up to 3.5 s, with --inputs-only for up to 10 s. Recorded
service calls go out on <service>/_service_event; no service is called. Latched messages are kept
for late joiners until all listeners have them (for 30 s at most), or until Ctrl-C with --keep.
Topics to publish, by their recorded names, follow --; remapping and node options follow
--ros-args, as for any ROS executable:
  ambush_replay FOLDER --keep -- /alpha_map /path
  ambush_replay FOLDER --inputs-only --ros-args -r /alpha_map:=/convoy/alpha_map
--json: {"verdict", "published": {topic: messages}, "unreadable"}
""" + cli.EXIT_CODES + ' Ctrl-C ends it with 0.'
INPUT_TYPES = frozenset({
    'nav_msgs/msg/OccupancyGrid', 'geometry_msgs/msg/PoseStamped',
    'geometry_msgs/msg/PoseWithCovarianceStamped', 'geometry_msgs/msg/PoseArray',
})
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


class Channel(NamedTuple):
    """A topic with one type and one quality of service."""

    topic: str
    type: str
    qos: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay recordings and return the exit code."""
    own, topics, for_ros = _split(sys.argv[1:] if arguments is None else arguments)

    def work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
        # Handlers are set even where a shell's background job would ignore SIGINT.
        before = [signal.signal(number, _end_once) for number in _ENDS]
        try:
            return _Replay(options, topics, console).run(for_ros)
        finally:
            for number, handler in zip(_ENDS, before, strict=True):
                signal.signal(number, handler)

    return cli.run(parser, work, own)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'replay', 'Publish recorded departures again, for RViz or for a running planner.', EPILOG
    )
    made.usage = '%(prog)s [options] FILE_OR_FOLDER [-- TOPIC ...] [--ros-args ...]'
    made.add_argument(
        '-e', '--every', type=cli.number(0.0, 1e6), default=5.0, metavar='SECONDS',
        help='time from one departure to the next (default: %(default)s)',
    )
    made.add_argument(
        '-d', '--departure', type=int, metavar='N',
        help='only the departure at this place, from 1; negative numbers count from the end',
    )
    made.add_argument(
        '-r', '--rate', type=cli.number(1e-6, 1e9), default=1.0,
        help='how many times as fast as recorded (default: %(default)s)',
    )
    made.add_argument(
        '-l', '--loop', action='store_true', help='start again after the end, until Ctrl-C'
    )
    made.add_argument(
        '-k', '--keep', action='store_true', help='keep latched messages until Ctrl-C'
    )
    made.add_argument(
        '--inputs-only', action='store_true',
        help='publish only map, start, stops and goal, to feed a running planner',
    )
    return made


class _Replay:
    """Makes all publishers first, then publishes message after message in time."""

    def __init__(
        self, options: argparse.Namespace, topics: Sequence[str], console: cli.Console
    ) -> None:
        self._options, self._topics, self._console = options, topics, console
        self._unreadable: dict[Path, str] = {}
        self._published: Counter[str] = Counter()
        self._publishers: dict[Channel, Any] = {}

    def run(self, for_ros: Sequence[str]) -> cli.Exit:
        """Publish until the end or Ctrl-C, and return the exit code."""
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        node = None
        try:
            try:
                rclpy.init(
                    args=[NODE_NAME, *for_ros], signal_handler_options=SignalHandlerOptions.NO
                )
            except (RuntimeError, UnicodeError) as error:
                raise cli.UsageError(f'after --ros-args: {error}') from error
            files = self._files()
            node = rclpy.create_node(NODE_NAME, start_parameter_services=False)
            self._advertise(node, files)
            self._play(list(files))
        except KeyboardInterrupt:
            pass
        finally:
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
        self._console.result = {
            'published': dict(self._published), 'unreadable': list(self._unreadable.values()),
        }
        return cli.Exit.UNREADABLE if self._unreadable else cli.Exit.HOLDS

    def _files(self) -> dict[Path, set[Channel]]:
        """Return the readable files with their channels."""
        paths = recordings_in(self._options.recordings)
        if (number := self._options.departure) is not None:
            if not (0 < number <= len(paths) or 0 < -number <= len(paths)):
                raise NothingToPublish(f'there are {cli.count(len(paths), "departure")}')
            paths = [paths[number - (number > 0)]]
        found = {path: {_channel(each) for each in self._messages(path)}
                 for path in self._console.progress(paths, 'read')}
        if not any(found.values()):
            raise NothingToPublish('none of the recordings can be read')
        return {path: channels for path, channels in found.items() if channels}

    def _messages(self, path: Path) -> Sequence[RecordedMessage]:
        try:
            return read_recording(path).messages
        except UnreadableRecording as error:
            if path not in self._unreadable:
                self._unreadable[path] = str(error)
                self._console.error(error)
            return ()

    def _advertise(self, node: Any, files: dict[Path, set[Channel]]) -> None:
        known = set().union(*files.values())
        topics = sorted({channel.topic for channel in known})
        for topic in self._topics:
            if topic not in topics:
                raise NothingToPublish(
                    f'nothing is recorded on {topic[:60]!r}, only on {", ".join(topics)}'
                )
        wanted = sorted(filter(self._wants, known))
        if not wanted:
            raise NothingToPublish('none of these topics is an input')
        self._publishers = {
            channel: node.create_publisher(
                _message_class(channel.type), channel.topic, qos_from_yaml(channel.qos)
            ) for channel in wanted
        }

    def _play(self, files: Sequence[Path]) -> None:
        self._console.say(cli.count(len(files), 'departure'))
        if unheard := self._wait_for_listeners():
            self._console.say(f'nobody listens to {", ".join(unheard)}')
        self._round(files)
        while self._options.loop and self._published:
            _sleep_until(self._due)
            self._console.say('again from the beginning')
            self._round(files)
        if missing := self._wait_for_receipts():
            self._console.say(f'some listeners have not received all of {", ".join(missing)}')
        if self._options.keep:
            self._console.say('everything is published; Ctrl-C ends it')
            while True:
                signal.pause()

    def _round(self, files: Iterable[Path]) -> None:
        """Publish everything once."""
        self._due = time.monotonic()
        for path in files:
            messages = [each for each in self._messages(path) if self._wants(_channel(each))]
            if not messages:
                continue
            _sleep_until(self._due)
            begin, first = time.monotonic(), messages[0].stamp_ns
            for each in messages:
                _sleep_until(begin + (each.stamp_ns - first) / 1e9 / self._options.rate)
                self._publishers[_channel(each)].publish(each.data)
                self._published[each.topic] += 1
            self._due = max(begin + self._options.every, time.monotonic())
            self._console.say(f'{cli.place(path)}: {cli.count(len(messages), "message")}')

    def _wants(self, channel: Channel) -> bool:
        named = not self._topics or channel.topic in self._topics
        return named and (channel.type in INPUT_TYPES or not self._options.inputs_only)

    def _wait_for_listeners(self) -> list[str]:
        """Wait until each topic has a listener; return the topics without one."""
        end = time.monotonic() + (
            _DISCOVERY_OF_INPUTS if self._options.inputs_only else _DISCOVERY
        )
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


def qos_from_yaml(text: str) -> Any:
    """Return the first profile (rclpy) in a channel's ``offered_qos_profiles``."""
    from rclpy.duration import Duration
    from rclpy.qos import (
        DurabilityPolicy,
        HistoryPolicy,
        LivelinessPolicy,
        QoSProfile,
        ReliabilityPolicy,
    )

    fields = dict(fields_from_yaml(text))
    for kind in (HistoryPolicy, ReliabilityPolicy, DurabilityPolicy, LivelinessPolicy):
        name = kind.__name__.removesuffix('Policy').lower()
        fields[name] = kind.get_from_short_key(fields[name])
    for name in DURATIONS:
        fields[name] = Duration(seconds=fields[name]['sec'], nanoseconds=fields[name]['nsec'])
    return QoSProfile(**fields)


def _message_class(name: str) -> Any:
    """Return the class of a recorded type. No other types: a file could name any module."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
    from nav_msgs.msg import OccupancyGrid, Path
    from nav_msgs.srv import GetPlan
    from std_srvs.srv import Trigger
    from visualization_msgs.msg import MarkerArray

    from ..recordings import type_name

    kinds = (
        OccupancyGrid, PoseStamped, PoseWithCovarianceStamped, PoseArray, Path, MarkerArray,
        DiagnosticArray, Trigger.Event, GetPlan.Event,
    )
    try:
        return {type_name(kind): kind for kind in kinds}[name]
    except KeyError as error:
        raise NothingToPublish(f'ambush_planner records nothing of type {name[:60]!r}') from error


def _channel(recorded: RecordedMessage) -> Channel:
    return Channel(recorded.topic, recorded.type, recorded.qos_text)


def _end_once(*_: object) -> None:
    """Interrupt the replay; a second signal must not interrupt its end."""
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the command's own arguments, the topics after --, and those from --ros-args on."""
    own, for_ros = _cut(list(arguments), '--ros-args')
    own, topics = _cut(own, '--')
    return own, topics[1:], for_ros


def _cut(arguments: list[str], mark: str) -> tuple[list[str], list[str]]:
    place = arguments.index(mark) if mark in arguments else len(arguments)
    return arguments[:place], arguments[place:]


def _sleep_until(end: float) -> None:
    """Sleep until ``time.monotonic()`` is ``end``."""
    time.sleep(max(0.0, end - time.monotonic()))
