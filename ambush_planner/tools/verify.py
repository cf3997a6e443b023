"""``ambush_verify``: do recorded departures follow from their recorded inputs?"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .command_line import exit_code, parser_of

EPILOG = """\
Each departure is planned again from its recorded map, start, goal and parameters, and its route
drawn again. It holds if network, strategy, value and route are the same (numbers to 1e-9, the
probabilities to 1e-6 where another processor or release of numpy or scipy rounds otherwise), if
the strategy's certificate closes, if path, markers, answer and the strategy's numbers in the
diagnostics follow from these, if the request came first and the answer last, and if nothing
stands in the file that the planner does not record or that some readers of MCAP would not find.
Standard output has a line a departure, which names what does not hold, and one for departures
that are missing between others, which is no failure; standard error the progress. Departures of
one strategy take one solve. Numbers are compared best with the releases of all software that
recorded them; the line says where they are others.

Not shown is who made a recording: one that was made anew as a whole, say from another seed, is
found to be consistent as well, and so is a folder whose first or last file was taken away. Nor
that its times are right: only their order within a departure is checked, and all of them can be
moved together. Where that matters, sign the files. By whoever corrects the checksums, these can
be changed unnoticed, too: what had no effect on the departure (cells far from all nodes, time
limits, quality of service, stamps of markers and inputs), the versions of software; in the
diagnostics the state, the name, the kind of warning, and trouble with a map or with recording,
which the answer repeats; and the names of topics that were remapped.
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
    return parser_of(
        "ambush_verify",
        "Plan recorded departures again and compare: do they follow from their inputs?",
        EPILOG,
    )


if __name__ == "__main__":
    sys.exit(main())
