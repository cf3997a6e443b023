"""``ambush_verify``: do recorded departures follow from their recorded inputs?"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import exit_code

EPILOG = """\
Each departure is planned again from its recorded map, start, goal and parameters, and its route
drawn again. It holds if network, strategy, value and route are the same (numbers to 1e-9, the
probabilities to 1e-6 where another processor or release of numpy or scipy rounds otherwise), if
the strategy's certificate closes, and if all that was recorded and answered follows from these.
Standard output has a line a departure, which names what does not hold; standard error the
progress. Departures of one strategy take one solve. Numbers are compared best with the releases
of numpy and scipy that recorded them; the line says where they are others.

This shows that a recording is consistent with itself and with the planner, not who made it: one
that was made anew as a whole, say from another seed, is found to be consistent as well, and so is
a folder from which a file was taken away. Where that matters, sign the files. What had no effect
on a departure can be changed unnoticed by whoever corrects the checksums, too; so can the state,
the name and the kind of warning in the diagnostics, and the names of topics that were remapped.
Exit code: 0 all departures hold; 1 one does not, or could not be read; 2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Verify recordings and return the exit code."""
    options = _parser().parse_args(arguments)

    def run() -> bool:
        from .verify_run import run_verify

        return run_verify(options.recordings)

    return exit_code("ambush_verify", "jazzy", run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ambush_verify",
        description="Plan recorded departures again and compare: do they follow from their inputs?",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "recordings",
        type=Path,
        metavar="FILE_OR_FOLDER",
        help="a recording, a session folder, or the recording.directory with all of them",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
