"""``ambush_replay``: publish recorded departures again, as they were published."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..errors import AmbushPlannerError
from ..recordings import RecordedMessage, UnreadableRecording, read_departure, recordings_in
from ..recordings.recorded_case import INPUT_TYPES
from . import cli
from .replay_player import Channel, Player, check_channels

NODE_NAME = 'ambush_replay'
EPILOG = """\
The recorded bytes go out on the recorded topics, with the recorded quality of service and at the
recorded distances in time; from one departure to the next it is --every seconds. Publishers are
made first and wait for listeners on each topic: up to 5 s, or 1 s where only some are listened to;
with --inputs-only up to 10 s. Calls of services go out as what they were recorded as, messages on
<service>/_service_event; nobody is called. Latched messages are kept for late joiners until the
command ends, when all that listen have all (30 s later if not), or until Ctrl-C with --keep.
Topics to publish, by the names they were recorded under, follow --; remapping and node options
follow --ros-args, as for any ROS executable:
  ambush_replay FOLDER --keep -- /alpha_map /path
  ambush_replay FOLDER --inputs-only --ros-args -r /alpha_map:=/convoy/alpha_map
--json: {"verdict", "published": {topic: messages}, "unreadable"}
""" + cli.EXIT_CODES + ' Ctrl-C ends it with 0.'
# Discovery takes up to 3.3 s, and RViz listens to some topics only; a planner that is to be fed may
# just be starting, and needs all inputs.
_DISCOVERY, _PATIENCE = 5.0, 1.0  # s
_DISCOVERY_OF_INPUTS = 10.0  # s
# A message is lost to a listener that lacks it when its publisher goes. A loaded machine may take
# seconds; one that died without a word is forgotten by then.
_LAST_RECEIPTS = 30.0  # s
# A recording may state any times, and the system takes only so much at once.
_LONGEST_SLEEP = 1e6  # s
_ENDS = signal.SIGINT, signal.SIGTERM


class NothingToPublish(AmbushPlannerError):
    """The recordings have no message that was asked for."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay recordings and return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    own, topics, for_ros = _split(given)

    def work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
        # Shells start what is to run behind the prompt with SIGINT ignored.
        before = [signal.signal(number, _end_once) for number in _ENDS]
        try:
            return _Replay(options, topics, console).run(for_ros)
        finally:
            for number, handler in zip(_ENDS, before, strict=True):
                if signal.getsignal(number) is _end_once:
                    signal.signal(number, handler)

    return cli.run(parser, work, own)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser(
        'replay', 'Publish recorded departures again, for RViz or for a running planner.', EPILOG
    )
    made.usage = '%(prog)s [options] FILE_OR_FOLDER [-- TOPIC ...] [--ros-args ...]'
    made.add_argument(
        '-e', '--every', type=cli.number(0.0, 1e9), default=5.0, metavar='SECONDS',
        help='from one departure to the next (default: %(default)s)',
    )
    made.add_argument(
        '-d', '--departure', type=int, metavar='N',
        help='only the one of this number, from 1; from the end if negative',
    )
    made.add_argument(
        '-r', '--rate', type=cli.number(1e-9, 1e9), default=1.0,
        help='how many times as fast as it was recorded (default: %(default)s)',
    )
    made.add_argument(
        '-l', '--loop', action='store_true', help='begin anew after the end, until Ctrl-C'
    )
    made.add_argument(
        '-k', '--keep', action='store_true', help='keep latched messages there until Ctrl-C'
    )
    made.add_argument(
        '--inputs-only', action='store_true',
        help='publish only map, start, stops and goal, so that a running planner can be fed',
    )
    return made


class _Replay:
    """Publishers first, then message after message in time."""

    def __init__(
        self, options: argparse.Namespace, topics: Sequence[str], console: cli.Console
    ) -> None:
        self._options, self._topics, self._console = options, topics, console
        self._unreadable: dict[Path, str] = {}
        self._published: Counter[str] = Counter()

    def run(self, for_ros: Sequence[str]) -> cli.Exit:
        """Publish what was recorded, until Ctrl-C at the latest, and return the exit code.

        Raises
        ------
        UnreadableRecording, NothingToPublish, CannotPublish
            There is nothing to read, or nothing that can be published.
        cli.UsageError
            What stands after --ros-args cannot be followed.
        """
        node = None
        try:
            _init(for_ros)
            files = self._files()
            node = Node(NODE_NAME, start_parameter_services=False)
            self._play(node, files)
        except KeyboardInterrupt:
            pass
        finally:
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
        code = cli.Exit.UNREADABLE if self._unreadable else cli.Exit.HOLDS
        self._console.result = {
            'published': dict(self._published), 'unreadable': list(self._unreadable.values()),
        }
        return code

    def _files(self) -> dict[Path, set[Channel]]:
        """The files to be played, with their channels."""
        paths = recordings_in(self._options.recordings)
        if (number := self._options.departure) is not None:
            if not (0 < number <= len(paths) or 0 < -number <= len(paths)):
                raise NothingToPublish(f'there are {cli.count(len(paths), "departure")}')
            paths = [paths[number - (number > 0)]]
        found = {}
        for path in self._console.progress(paths, 'read'):
            if messages := self._messages(path):
                found[path] = set(map(Channel.of, messages))
        if not found:
            raise NothingToPublish('none of the recordings can be read')
        return found

    def _messages(self, path: Path) -> Sequence[RecordedMessage]:
        try:
            messages = read_departure(path).messages
            check_channels(path, set(map(Channel.of, messages)))
            return messages
        except UnreadableRecording as error:
            if path not in self._unreadable:
                self._unreadable[path] = str(error)
                self._console.error(error)
            return ()

    def _play(self, node: Node, files: dict[Path, set[Channel]]) -> None:
        channels = self._wanted(files)
        player = Player(node)
        for channel in channels:
            player.advertise(channel)
        self._console.say(f'{cli.count(len(files), "departure")}')
        longest, patience = _DISCOVERY, _PATIENCE
        if self._options.inputs_only:
            longest = patience = _DISCOVERY_OF_INPUTS
        if unheard := player.wait_for_listeners(longest, patience):
            self._console.say(f'nobody listens to {", ".join(unheard)}')
        while self._round(files, player) and self._options.loop:
            self._console.say('again from the beginning')
        if lacking := player.wait_until_received(_LAST_RECEIPTS):
            self._console.say(f'not everybody who listens has everything on {", ".join(lacking)}')
        if self._options.keep:
            self._console.say('all is published; Ctrl-C ends it')
            while True:
                signal.pause()

    def _round(self, files: Iterable[Path], player: Player) -> bool:
        """Publish everything once; return False if nothing is left."""
        published, due = False, time.monotonic()
        for path in files:
            messages = [each for each in self._messages(path) if self._wants(Channel.of(each))]
            if not messages:
                continue
            if published:
                _sleep_until(due)
            begin, first = time.monotonic(), messages[0].stamp_ns
            for each in messages:
                at = begin + (each.stamp_ns - first) / 1e9 / self._options.rate
                _sleep_until(at)
                player.publish(Channel.of(each), each.data)
                self._published[each.topic] += 1
            published, due = True, max(begin + self._options.every, time.monotonic())
            self._console.say(f'{cli.place(path)}: {cli.count(len(messages), "message")}')
        if not published:
            self._console.say('nothing was published')
        elif self._options.loop:
            _sleep_until(due)
        return published

    def _wants(self, channel: Channel) -> bool:
        named = not self._topics or channel.topic in self._topics
        return named and (channel.type in INPUT_TYPES or not self._options.inputs_only)

    def _wanted(self, files: dict[Path, set[Channel]]) -> list[Channel]:
        """Return the channels that are to be published, in a fixed order."""
        known = set().union(*files.values())
        topics = sorted({channel.topic for channel in known})
        for topic in self._topics:
            if topic not in topics:
                raise NothingToPublish(
                    f'nothing is recorded on {topic[:60]!r}, only on {", ".join(topics)}'
                )
        wanted = sorted(filter(self._wants, known), key=lambda c: (c.topic, c.type, c.qos))
        if not wanted:
            raise NothingToPublish('none of these topics is an input')
        return wanted


def _end_once(*_: object) -> None:
    """Interrupt the replay; a second signal must not interrupt its end."""
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the command's own arguments, the topics after --, and those from --ros-args on."""
    place = _index(arguments, '--ros-args')
    own, for_ros = list(arguments[:place]), list(arguments[place:])
    try:
        own += remove_ros_args([NODE_NAME, *for_ros])[1:]
    except (RuntimeError, UnicodeError):
        pass  # said when ROS is given them
    place = _index(own, '--')
    return own[:place], own[place + 1 :], for_ros


def _index(arguments: Sequence[str], mark: str) -> int:
    return arguments.index(mark) if mark in arguments else len(arguments)


def _init(for_ros: Sequence[str]) -> None:
    try:
        rclpy.init(args=[NODE_NAME, *for_ros], signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, UnicodeError) as error:
        # Names of files need not be UTF-8, and ROS takes nothing else.
        raise cli.UsageError(f'after --ros-args: {error}') from error


def _sleep_until(end: float) -> None:
    """Sleep until ``time.monotonic()`` is ``end``."""
    while (left := end - time.monotonic()) > 0.0:
        time.sleep(min(left, _LONGEST_SLEEP))
