"""``ambush_audit``: do recorded departures follow their strategy, and do they show patterns?"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import exit_code

EPILOG = """\
The departures of each strategy are tested together: whether stretches are driven as often as
published, whether routes are as likely as they should be, whether the order shows a rhythm, and
whether routes repeat. It also says what an observer would have learnt. Standard output and
audit.txt have the result in words, audit.csv the numbers; audit_<strategy>.png shows published
and recorded frequencies on the map, audit_<strategy>_passages.csv has them edge by edge.
The pictures and tables show secret routes: files have mode 0600, a new folder 0700.
Fewer than five departures of one strategy are too few to tell, which is no finding, unless one of
them cannot have been drawn at all.
Exit code: 0 nothing suspicious; 1 a finding, or something that could not be read or audited;
2 wrong usage.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Audit recordings and return the exit code."""
    options = _parser().parse_args(arguments)
    place = options.recordings.resolve()
    output = options.output or place.parent / f"{place.name}_audit"

    def run() -> bool:
        from .audit_run import run_audit

        return run_audit(options.recordings, output, options.false_alarm_rate, options.replace)

    return exit_code("ambush_audit", "jazzy,figures", run)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ambush_audit",
        description="Test recorded departures: do they follow the strategy, do they show patterns?",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "recordings",
        type=Path,
        metavar="FOLDER",
        help="a session folder, or the recording.directory with all of them",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="where the results go; made if missing (default: FOLDER_audit, beside FOLDER)",
    )
    parser.add_argument(
        "--false-alarm-rate",
        type=_rate,
        default=0.01,
        metavar="RATE",
        help="chance of any finding where there is nothing to find (default: %(default)s)",
    )
    parser.add_argument(
        "--replace", action="store_true", help="replace the files of an earlier audit in DIR"
    )
    return parser


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0.001 <= rate <= 0.5:
        raise argparse.ArgumentTypeError(f"must be a number from 0.001 to 0.5, got {text!r}")
    return rate


if __name__ == "__main__":
    sys.exit(main())
