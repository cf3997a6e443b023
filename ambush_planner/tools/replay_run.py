"""The work of ``ambush_replay``: publishers first, then message after message in time."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..core.errors import AmbushPlannerError
from ..recording import RecordedMessage, UnreadableRecording, recordings_in
from ..recording.types import INPUT_TYPES
from ..ros.replay import Player, sleep_until
from .audit_files import say
from .replay_timeline import Channel, Part, Unreadable, messages, timeline

NODE_NAME = "ambush_replay"
# Discovery takes up to 3.3 s, and RViz listens to some topics only; a planner that is to be fed may
# just be starting, and needs all inputs.
_DISCOVERY, _PATIENCE = 5.0, 1.0  # s
_DISCOVERY_OF_INPUTS = 10.0  # s
_LAST_RECEIPTS = 2.0  # s
_LOOP_PAUSE = 1.0  # s
_LONG_PAUSE = 5.0  # s


class NothingToPublish(AmbushPlannerError):
    """The recordings have no message that was asked for."""


class WrongArguments(ValueError):
    """What follows --ros-args is wrong."""


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
    """Raised like a flag by SIGINT and SIGTERM, which end nothing by themselves."""

    def __init__(self) -> None:
        self._stopped = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def going_on(self) -> bool:
        """Whether neither a signal nor the end of the context has come."""
        return not self._stopped and rclpy.ok()

    def _on_signal(self, *_: object) -> None:
        self._stopped = True


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments that are not for ROS.

    Raises
    ------
    WrongArguments
        Those for ROS cannot be read.
    """
    try:
        return list(remove_ros_args([NODE_NAME, *arguments])[1:])
    except RuntimeError as error:
        raise WrongArguments(f"after --ros-args: {error}") from error


def run_replay(replay: Replay, arguments: Sequence[str]) -> int:
    """Publish what was recorded, and return the exit code.

    Raises
    ------
    UnreadableRecording, NothingToPublish
        There is nothing to read, or nothing to publish.
    """
    stop = _Stop()
    unreadable: dict[Path, UnreadableRecording] = {}

    def note(error: UnreadableRecording) -> None:
        if error.path not in unreadable:
            unreadable[error.path] = error
            say(f"{NODE_NAME}: {error}")

    rclpy.init(args=[NODE_NAME, *arguments], signal_handler_options=SignalHandlerOptions.NO)
    node = None
    try:
        paths = takewhile(lambda _: stop.going_on(), recordings_in(replay.recordings))
        parts = timeline(paths, note)
        if stop.going_on():
            channels = _wanted(replay, parts)
            node = Node(NODE_NAME, start_parameter_services=False)
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
        begin, published_to = time.monotonic(), None
        for part, placed in messages(self._parts, start, note):
            wanted = [
                (at - start, message) for at, message in placed
                if self._replay.wants(Channel.of(message))
            ]
            if not wanted:
                continue
            self._tell_pause(wanted[0][0] - (published_to or 0))
            if not self._publish(wanted, begin):
                return False
            published_to = wanted[-1][0]
            self._tell_progress(part, start + published_to, len(wanted))
        if published_to is None:
            say("nothing was published")
        return published_to is not None

    def _publish(self, placed: list[tuple[int, RecordedMessage]], begin: float) -> bool:
        """Publish messages, each when its time after ``begin`` has come; False if cut short."""
        for at, message in placed:
            if not sleep_until(begin + at / 1e9 / self._replay.rate, self._going_on):
                return False
            self._player.publish(Channel.of(message), message.data)
        return True

    def _tell_pause(self, nanoseconds: int) -> None:
        seconds = nanoseconds / 1e9 / self._replay.rate
        if seconds > _LONG_PAUSE:
            say(f"a pause of {seconds:.0f} s")

    def _tell_progress(self, part: Part, place: int, count: int) -> None:
        total = self._parts[-1].end_ns
        say(f"{place / 1e9:.1f} of {total / 1e9:.1f} s: {part.path.name[:120]!r}, {count} messages")

    def rest(self) -> bool:
        """Wait a moment, so that short recordings do not flood those who listen."""
        return sleep_until(time.monotonic() + _LOOP_PAUSE, self._going_on)

    def finish(self) -> None:
        """Let the last messages arrive before their publishers go."""
        received = self._player.wait_until_received(_LAST_RECEIPTS, self._going_on)
        if not received and self._going_on():
            say("not everybody who listens has received everything")


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
