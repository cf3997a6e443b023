"""``ambush_replay``: publish recorded departures again, as they were published."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

from .command_line import parser_of

EPILOG = """\
The recorded bytes go out on the recorded topics, with the recorded quality of service and at the
recorded distances in time, long pauses too, such as a clock makes that was set meanwhile: each is
told with the --start-at that skips it. The files of a folder follow each other in one timeline.
Publishers are made first and wait for listeners on each topic: up to 5 s, or 1 s where
only some are listened to; with --inputs-only up to 10 s. Calls of services go out as what they
were recorded as, messages on <service>/_service_event; nobody is called. Latched messages are
kept for late joiners until the command ends, when all that listen have all (30 s later if not):
use --loop for more.
After --ros-args follow remapping and node options as for any ROS executable, for example
  ambush_replay FOLDER --inputs-only --ros-args -r /alpha_map:=/convoy/alpha_map
Exit code: 0, also after Ctrl-C; 1 if a file could not be read (the others are published) or there
is nothing to publish; 2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay recordings and return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        return _replay(given)
    except KeyboardInterrupt:
        # Before the command's own handling of signals.
        return 0


def _replay(given: list[str]) -> int:
    try:
        # Here, so that --help and the message below need no ROS.
        from .replay_run import FAILURES, Replay, WrongArguments, run_replay, split_arguments
    except ModuleNotFoundError as error:
        _parser().parse_known_args(given)
        package = str(error.name).partition(".")[0]
        return _fail(f"{package} is not installed; try: pip install 'ambush_planner[jazzy]'")
    try:
        own, for_ros = split_arguments(given)
        return run_replay(Replay(**vars(_parser().parse_args(own))), for_ros)
    except WrongArguments as error:
        _parser().error(str(error))
    except FAILURES as error:
        return _fail(str(error))


def _parser() -> argparse.ArgumentParser:
    parser = parser_of(
        "ambush_replay",
        "Publish recorded departures again, for RViz or for a running planner.",
        EPILOG,
    )
    parser.add_argument(
        "-r", "--rate", type=_positive, default=1.0,
        help="how many times as fast as it was recorded (default: %(default)s)",
    )
    parser.add_argument(
        "-l", "--loop", action="store_true", help="begin anew a second after the end, until Ctrl-C"
    )
    parser.add_argument(
        "--topics", nargs="+", metavar="TOPIC", default=[],
        help="publish only these, by the names they were recorded under",
    )
    parser.add_argument(
        "--inputs-only", action="store_true",
        help="publish only map, start and goal, so that a running planner can be fed",
    )
    parser.add_argument(
        "--start-at", type=_not_negative, default=0.0, metavar="SECONDS",
        help="begin this long after the first message, without what comes before",
    )
    return parser


def _positive(text: str) -> float:
    number = _not_negative(text)
    if number == 0.0:
        raise argparse.ArgumentTypeError("must be over 0")
    return number


def _not_negative(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number from 0, got {text!r}")
    return number


def _fail(message: str) -> int:
    print(f"ambush_replay: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
