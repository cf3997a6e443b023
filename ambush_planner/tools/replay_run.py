"""The work of ``ambush_replay``: publishers first, then message after message in time."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..core.errors import AmbushPlannerError
from ..recording import RecordedMessage, UnreadableRecording, recordings_in
from ..recording.types import INPUT_TYPES
from ..ros.replay import CannotPublish, Player, sleep_until
from .audit_files import say
from .replay_timeline import Channel, Part, Unreadable, messages, timeline

NODE_NAME = "ambush_replay"
# Discovery takes up to 3.3 s, and RViz listens to some topics only; a planner that is to be fed may
# just be starting, and needs all inputs.
_DISCOVERY, _PATIENCE = 5.0, 1.0  # s
_DISCOVERY_OF_INPUTS = 10.0  # s
# A message is lost to a listener that lacks it when its publisher goes. A loaded machine may take
# seconds; one that died without a word is forgotten by then.
_LAST_RECEIPTS = 30.0  # s
_LOOP_PAUSE = 1.0  # s
_LONG_PAUSE = 5.0  # s
_DAY = 86400.0  # s


class NothingToPublish(AmbushPlannerError):
    """The recordings have no message that was asked for."""


class WrongArguments(ValueError):
    """What follows --ros-args is wrong."""

    def __init__(self, reason: object) -> None:
        super().__init__(f"after --ros-args: {reason}")


FAILURES = (AmbushPlannerError, OSError)


@dataclass(frozen=True)
class Replay:
    """What is to be replayed; the fields are the command's options."""

    recordings: Path
    rate: float
    loop: bool
    topics: Sequence[str]
    inputs_only: bool
    start_at: float

    def wants(self, channel: Channel) -> bool:
        """Whether what is on a channel is to be published."""
        named = not self.topics or channel.topic in self.topics
        return named and (channel.type in INPUT_TYPES or not self.inputs_only)


class _Stop:
    """Raised like a flag by SIGINT and SIGTERM, which end nothing by themselves while it holds."""

    def __init__(self) -> None:
        self._stopped = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Stop:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def going_on(self) -> bool:
        """Whether neither a signal nor the end of the context has come."""
        return not self._stopped and rclpy.ok()

    def _on_signal(self, *_: object) -> None:
        self._stopped = True


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the command's own arguments, and those from --ros-args on.

    Raises
    ------
    WrongArguments
        Those for ROS cannot be read.
    """
    # Names of files need not be UTF-8, and ROS takes nothing else.
    own = list(takewhile(lambda each: each != "--ros-args", arguments))
    for_ros = list(arguments[len(own):])
    try:
        return own + remove_ros_args([NODE_NAME, *for_ros])[1:], for_ros
    except (RuntimeError, UnicodeError) as error:
        raise WrongArguments(error) from error


def run_replay(replay: Replay, for_ros: Sequence[str]) -> int:
    """Publish what was recorded, and return the exit code.

    Raises
    ------
    UnreadableRecording, NothingToPublish, CannotPublish
        There is nothing to read, or nothing that can be published.
    WrongArguments
        Those for ROS cannot be followed.
    """
    with _Stop() as stop:
        return _run(replay, for_ros, stop)


def _run(replay: Replay, for_ros: Sequence[str], stop: _Stop) -> int:
    unreadable: dict[Path, UnreadableRecording] = {}

    def note(error: UnreadableRecording) -> None:
        if error.path not in unreadable:
            unreadable[error.path] = error
            say(f"{NODE_NAME}: {error}")

    node = None
    try:
        _init(for_ros)
        paths = takewhile(lambda _: stop.going_on(), recordings_in(replay.recordings))
        parts = timeline(paths, note)
        if stop.going_on():
            channels = _wanted(replay, parts)
            node = Node(NODE_NAME, start_parameter_services=False)
            _check_types(node, channels)
            run = _Run(replay, parts, Player(node), stop)
            run.advertise(channels)
            while run.play(note) and replay.loop and run.rest():
                say("again from the beginning")
            run.finish()
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 1 if unreadable else 0


class _Run:
    """The publishers, and one round after the other through the timeline."""

    def __init__(self, replay: Replay, parts: list[Part], player: Player, stop: _Stop) -> None:
        self._replay, self._parts, self._player = replay, parts, player
        self._going_on = stop.going_on

    def advertise(self, channels: Iterable[Channel]) -> None:
        """Make all publishers, and wait a little for those who listen."""
        say(f"{_seconds(self._parts[-1].end_ns / 1e9)} in {len(self._parts)} recordings")
        for channel in channels:
            self._player.advertise(channel, channel.topic, channel.type, channel.qos)
        longest, patience = _DISCOVERY, _PATIENCE
        if self._replay.inputs_only:
            longest = patience = _DISCOVERY_OF_INPUTS
        if unheard := self._player.wait_for_listeners(longest, patience, self._going_on):
            say(f'nobody listens to {", ".join(unheard)}')

    def play(self, note: Unreadable) -> bool:
        """Publish everything once; return False if it was cut short, or nothing is left."""
        start = round(self._replay.start_at * 1e9)
        begin, published = time.monotonic(), False
        for part, placed in messages(self._parts, start, note):
            wanted = [
                (at, message) for at, message in placed if self._replay.wants(Channel.of(message))
            ]
            if not wanted:
                continue
            if not self._publish(wanted, start, begin):
                return False
            published = True
            self._tell_progress(part, wanted[-1][0], len(wanted))
        if not published:
            say("nothing was published")
        return published

    def _publish(
        self, placed: list[tuple[int, RecordedMessage]], start: int, begin: float
    ) -> bool:
        """Publish messages, the one at ``start`` at the time ``begin``; False if cut short."""
        for at, message in placed:
            due = begin + (at - start) / 1e9 / self._replay.rate
            _tell_pause(due - time.monotonic(), at)
            if not sleep_until(due, self._going_on):
                return False
            self._player.publish(Channel.of(message), message.data)
        return True

    def _tell_progress(self, part: Part, place: int, count: int) -> None:
        total = self._parts[-1].end_ns
        say(f"{place / 1e9:.1f} of {total / 1e9:.1f} s: {part.path.name[:120]!r}, {count} messages")

    def rest(self) -> bool:
        """Wait a moment, so that short recordings do not flood those who listen."""
        return sleep_until(time.monotonic() + _LOOP_PAUSE, self._going_on)

    def finish(self) -> None:
        """Let the last messages arrive before their publishers go."""
        lacking = self._player.wait_until_received(_LAST_RECEIPTS, self._going_on)
        if lacking and self._going_on():
            say(f'not everybody who listens has received everything on {", ".join(lacking)}')


def _init(for_ros: Sequence[str]) -> None:
    try:
        rclpy.init(args=[NODE_NAME, *for_ros], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise WrongArguments(error) from error


def _check_types(node: Node, channels: Iterable[Channel]) -> None:
    """Raise where a name would have two types: a node can publish only one."""
    first: dict[str, Channel] = {}
    for channel in channels:
        name = node.resolve_topic_name(channel.topic)
        other = first.setdefault(name, channel)
        types = f"{other.type} and {channel.type}"
        if other.type == channel.type:
            continue
        if other.topic != channel.topic:
            raise WrongArguments(
                f"{other.topic} and {channel.topic} would both be {name}, as {types}"
            )
        raise CannotPublish(
            f"{channel.topic} is recorded as {types}, and a node can publish only one of them; "
            "leave it out with --topics, or replay the files one by one"
        )


def _tell_pause(seconds: float, end_ns: int) -> None:
    if seconds > _LONG_PAUSE:
        begin_after = math.floor(end_ns / 1e8) / 10
        say(f"a pause of {_seconds(seconds)}; --start-at {begin_after:.1f} skips it")


def _seconds(number: float) -> str:
    days = f" ({number / _DAY:.0f} days)" if number >= _DAY else ""
    return f"{number:.1f} s{days}"


def _wanted(replay: Replay, parts: list[Part]) -> list[Channel]:
    """Return the channels that are to be published, in a fixed order."""
    if not parts:
        raise NothingToPublish("none of the recordings can be read")
    known = {channel for part in parts for channel in part.channels}
    topics = sorted({channel.topic for channel in known})
    for topic in replay.topics:
        if topic not in topics:
            raise NothingToPublish(f'nothing is recorded on {topic}, only on {", ".join(topics)}')
    if replay.start_at * 1e9 > parts[-1].end_ns:
        raise NothingToPublish(
            f"--start-at {replay.start_at:g} is after the end, {parts[-1].end_ns / 1e9:.1f} s"
        )
    wanted = sorted(filter(replay.wants, known), key=lambda c: (c.topic, c.type, c.qos_yaml))
    if not wanted:
        raise NothingToPublish("none of these topics is an input")
    return wanted
