"""What the commands that read recordings have in common: what they take, how they print and end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path

from ..core.errors import AmbushPlannerError


def parser_of(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return a parser of a command that takes ``recordings``; ``epilog`` stands as it is."""
    parser = argparse.ArgumentParser(
        prog=command,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "recordings",
        type=Path,
        metavar="FILE_OR_FOLDER",
        help="a recording, a session folder, or the recording.directory with all of them",
    )
    return parser


def exit_code(command: str, extras: str, action: Callable[[], bool]) -> int:
    """Run ``action``; 0 if it returns True, else 1, with the reason on standard error.

    ``extras`` are what to install where a package is missing: ``action`` imports what it needs
    itself, so that ``--help`` needs nothing.
    """
    _print_any_name()
    try:
        return 0 if action() else 1
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        reason = f"{package} is not installed; try: pip install 'ambush_planner[{extras}]'"
    except (AmbushPlannerError, OSError) as error:
        reason = str(error)
    except KeyboardInterrupt:
        reason = "interrupted"
    print(f"{command}: {reason}", file=sys.stderr)
    return 1


def _print_any_name() -> None:
    """Let standard output take names of files that are not UTF-8, as standard error does."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
