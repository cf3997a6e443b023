# SPDX-License-Identifier: Apache-2.0
"""Shared parts of commands that read recordings: arguments and departures."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from .cli import existing, new_parser
from .console import Console, place

if TYPE_CHECKING:
    from ..recordings.recorded_departure import RecordedDeparture
    from ..recordings.recording_errors import UnreadableRecording


def reader_parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a command that reads recordings."""
    parser = new_parser(command, description, epilog)
    parser.add_argument('recordings', type=existing, metavar='FILE_OR_FOLDER',
                        help='a recording, a session folder, or the recording.directory with all '
                        'sessions')
    return parser


def read_all(place: Path, console: Console) -> tuple[
        list[RecordedDeparture], list[UnreadableRecording], dict[Path, str]]:
    """Return the departures below ``place`` in order of time, errors, and files struck, and why."""
    from ..recordings.recorded_departures import read_departures, recordings_in

    errors: list[UnreadableRecording] = []
    struck: dict[Path, str] = {}
    departures = read_departures(console.progress(recordings_in(place), 'read'), errors.append,
                                 lambda each, why: struck.update({each.path: why}))
    return departures, errors, dict(sorted(struck.items()))


def struck_note(struck: Mapping[Path, str], total: int) -> str:
    """Say which of all departures were struck, and why; those without a reason are suspicious."""
    names = ', '.join(each.stem + (f' ({why})' if why else '') for each, why in struck.items())
    doubt = ('' if all(struck.values()) else
             ' A planner who draws until he likes the route does this: ask why.')
    return f'Struck as unused: {names} ({len(struck)} of {total}).{doubt}'


def struck_json(struck: Mapping[Path, str]) -> dict[str, str]:
    """Return the files struck, and why."""
    return {place(path): why for path, why in struck.items()}
