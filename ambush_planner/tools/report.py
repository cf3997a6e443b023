"""``ambush_report``: recorded departures on one HTML page that any browser shows offline."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import exit_code, parser_of

EPILOG = """\
The page, report.html, has the map, the strategy, the routes, how they compare with planners that
leave no choice, and what is promised, in words. It holds its pictures itself, needs no network and
runs no scripts. It shows secret routes: it has mode 0600, a new folder 0700.
Exit code: 0; 1 if anything could not be read or written; 2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report and return the exit code."""
    options = _parser().parse_args(arguments)

    def run() -> bool:
        from .report_run import run_report

        return run_report(options.recordings, options.output, options.replace)

    return exit_code("ambush_report", "jazzy,figures", run)


def _parser() -> argparse.ArgumentParser:
    parser = parser_of(
        "ambush_report",
        "Recorded departures on one HTML page, for people without RViz or Foxglove.",
        EPILOG,
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="where report.html goes; made if missing",
    )
    parser.add_argument(
        "--replace", action="store_true", help="replace the report.html that DIR holds already"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
