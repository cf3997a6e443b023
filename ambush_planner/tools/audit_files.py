"""What ``ambush_audit`` and ``ambush_report`` share: reading recordings, writing private files."""

from __future__ import annotations

import sys
from pathlib import Path

from ..core.errors import AmbushPlannerError
from ..recording.durable import make_private_folders, write_durably
from ..recording.errors import UnreadableRecording
from ..recording.reader import recordings_in
from ..review.departures import Campaign, read_campaigns


class OutputRefused(AmbushPlannerError):
    """A file of the output is there already, and nobody said that it may be replaced."""


def say(text: str) -> None:
    """Tell the progress, on standard error: standard output is for results."""
    print(text, file=sys.stderr, flush=True)


def read_all(place: Path) -> tuple[list[Campaign], list[UnreadableRecording]]:
    """Return the departures below ``place`` by strategy, and the errors of unreadable files.

    Raises
    ------
    UnreadableRecording
        There is nothing to read at all.
    """
    paths = recordings_in(place)
    say(f"reading {len(paths)} recording{'s' * (len(paths) != 1)}")
    errors: list[UnreadableRecording] = []
    return read_campaigns(paths, errors.append), errors


def refuse_existing(folder: Path, names: list[str], replace: bool) -> None:
    """Check, before the work is done, that no file would be lost.

    Raises
    ------
    OutputRefused
        A file of one of the ``names`` exists in the folder, and ``replace`` is False.
    """
    existing = [name for name in names if (folder / name).exists()]
    if existing and not replace:
        raise OutputRefused(
            f"{folder / existing[0]} exists already; add --replace, or name another folder with -o"
        )


def write_private(folder: Path, files: dict[str, bytes]) -> None:
    """Write files (mode 0600) to the folder, which is made with mode 0700 if missing."""
    make_private_folders(folder.resolve())
    for name, data in files.items():
        write_durably(folder / name, data)
