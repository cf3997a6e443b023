"""``ambush_demo``: departures on real ground, through the real node; see ``tools/demo_run.py``."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

EPILOG = """\
It starts the node ambush_planner as a process of its own, publishes a risk map made from the
elevation model that comes with matplotlib, and asks for departures by service call. The folder
then holds a recording of each departure (MCAP, for ros2 bag and Foxglove), strategy.png,
routes.png, frontier.png (what other budgets would buy), frontier.csv and the node's log. Exit
code: 0, or 1 if anything went wrong.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        # Here, so that --help and the message below need no ROS and no matplotlib.
        from .demo_run import FAILURES, run_demo
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        return _fail(
            f"{package} is not installed; try: pip install 'ambush_planner[jazzy,figures]'"
        )
    # Ended from outside, it still takes its node along.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        run_demo(options.output, options.departures)
    except FAILURES as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return _fail("interrupted")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ambush_demo",
        description="Random routes on real ground: departures, recordings and pictures.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/demo"),
        metavar="FOLDER",
        help="where the results go; made if missing (default: %(default)s)",
    )
    parser.add_argument(
        "-n",
        "--departures",
        type=_positive,
        default=8,
        metavar="COUNT",
        help="number of routes to ask for (default: %(default)s)",
    )
    return parser


def _positive(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"must be a positive whole number, got {text!r}")
    return int(text)


def _fail(message: str) -> int:
    print(f"ambush_demo: {message}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
