# SPDX-License-Identifier: Apache-2.0
"""Recorded departures in folders: listed, read, and compared with each other."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..words import count
from .metadata import Metadata
from .recorded_departure import RecordedDeparture, made_once, read_departure
from .recording_errors import UnreadableRecording, reading_from

if TYPE_CHECKING:
    from .verify import Verdict

# Minimum bit length of the 256-bit seed; honest seeds fall below it with probability 2^-64.
MIN_BITS = 192


def recordings_in(path: Path | str) -> list[Path]:
    """List the recordings in a file, a session folder or a recording.directory.

    Files of a folder come in the order of their numbers, followed by those of the session folders
    in it, in the order of time. Raises UnreadableRecording if there is none.
    """
    path = Path(path)
    with reading_from(path):
        if not path.is_dir():
            path.stat()
            return [path]
        # The names of session folders contain the times at which the sessions began.
        folders = sorted((each for each in path.iterdir() if each.is_dir()), key=_natural_order)
        found = [file
                 for folder in (path, *folders)
                 for file in sorted(folder.glob('*.mcap'), key=_natural_order)]
    if not found:
        raise UnreadableRecording(path, 'no .mcap file in this folder; name another one')
    return found


def read_departures(
    paths: Iterable[Path], unreadable: Callable[[UnreadableRecording], None],
    struck: Callable[[RecordedDeparture, str], None] = lambda each, why: None,
) -> list[RecordedDeparture]:
    """Read recordings, the earliest departure first; copies count once.

    A departure that was diverted is its last diversion, with what was recorded before it.
    ``unreadable`` is called with the error of each file that cannot be read, ``struck`` with each
    departure that is left out because a later one replaces it, and why it was not driven.
    """
    known: dict[tuple[str, int], RecordedDeparture] = {}
    once = made_once()
    for path in paths:
        try:
            found = read_departure(path, once)
        except UnreadableRecording as error:
            unreadable(error)
        else:
            diversion = found.metadata.diversion
            known.setdefault((found.metadata.departure_id, diversion.number if diversion else 0),
                             found)
    driven: dict[str, RecordedDeparture] = {}
    for (departure_id, _), each in sorted(known.items()):
        before = driven.get(departure_id)
        driven[departure_id] = replace(each, before=before) if before else each
    for each in known.values():
        day = each.metadata.day
        if day and day.replaces in driven:
            struck(driven.pop(day.replaces), day.why)
    return sorted(driven.values(), key=lambda each: (each.stamp_ns, each.metadata.departure))


def source_findings(recordings: Iterable[tuple[str, Metadata]]) -> list[str]:
    """Report what was not drawn from fresh random numbers of full length, by the names of files.

    Sources that differ only in their last 192 bits, like those of a counter, come by chance with
    probability 2^-64.
    """
    findings, sources = [], []
    for name, said in recordings:
        source = said.route_entropy_source
        if len(source) == 1 and source[0].bit_length() < MIN_BITS:
            findings.append(f'{name}: its random source has fewer than {MIN_BITS} bits')
        else:
            sources.append((source, name, said.recording_id))
    sources.sort()
    for (one, first, id_), (other, name, other_id) in zip(sources, sources[1:], strict=False):
        near = one == other or (
            len(one) == len(other) == 1 and (other[0] - one[0]).bit_length() < MIN_BITS
        )
        if near and id_ != other_id:
            same = 'the same' if one == other else 'nearly the same'
            findings.append(f'{name}: its random source is {same} as that of {first}')
    return findings


def drawn_twice(recordings: Iterable[tuple[Path, Metadata]]) -> tuple[list[str], list[str]]:
    """Name departures of one plan for one day and slot: in several folders, and in one folder.

    Those that were struck do not count. In one folder, somebody has said that both were driven; in
    several, they are drawn from copies of the plan.
    """
    known = [(path, said) for path, said in recordings if said.day and said.plan]
    struck = {said.day.replaces for _, said in known if said.day}
    same: dict[tuple[str, str, str], dict[str, Path]] = {}
    for path, said in known:
        if said.day and said.plan and said.departure_id not in struck:
            trip = same.setdefault((said.plan.id, said.day.date, said.day.slot), {})
            trip.setdefault(said.departure_id, path)
    copies, again = [], []
    for (_, date, slot), paths in sorted(same.items()):
        if len(paths) < 2:
            continue
        names = ', '.join(f'{path.parent.name}/{path.name}' for path in sorted(paths.values()))
        text = (f'{count(len(paths), "departure")} of one plan for {date}{slot and f", {slot}"}: '
                f'{names}')
        if len({path.parent for path in paths.values()}) > 1:
            copies.append(f'{text}: they were drawn from copies of the plan')
        else:
            again.append(f'{text}: the earlier one was said to have been driven, too')
    return copies, again


def together(verdicts: Iterable[Verdict]) -> tuple[list[str], list[str]]:
    """Compare the recordings of folders: what does not hold, and notes on missing numbers."""
    verdicts = list(verdicts)
    known = [(each, each.metadata) for each in verdicts if each.metadata is not None]
    unreadable = {each.path.parent for each in verdicts if each.metadata is None}
    problems = [f'random source: {each}' for each in source_findings(
        (each.path.name, said) for each, said in known)]
    first: dict[str, Path] = {}
    for each, said in known:
        if (original := first.setdefault(said.recording_id, each.path)) != each.path:
            problems.append(f'copy: {each.path.name} holds the same departure as {original.name}')
    copies, notes = drawn_twice((each.path, said) for each, said in known)
    problems += copies
    for folder in dict.fromkeys(each.path.parent for each, _ in known):
        here = {said.recording_id: (each, said) for each, said in known
                if each.path.parent == folder}
        if len(here) > 1 and folder not in unreadable:
            problems += _diversion_problems(here)
        numbers = {said.departure for _, said in here.values()}
        if missing := max(numbers) - min(numbers) + 1 - len(numbers):
            notes.append(f'{folder.name}: no recording of {count(missing, "departure")} between '
                         'the first and the last')
    return problems, notes


def _diversion_problems(here: Mapping[str, tuple[Verdict, Metadata]]) -> Iterator[str]:
    """Compare diversions with the recordings in their folder that they were diverted from."""
    for each, said in here.values():
        name, diversion = each.path.name, said.diversion
        if diversion is None:
            continue
        before = here.get(replace(said, diversion=replace(diversion, number=diversion.number - 1)
                                  if diversion.number > 1 else None).recording_id)
        if before is None:
            yield f'missing: what {name} was diverted from'
        elif before[0].route != diversion.left or not {*diversion.ahead} <= {
                *before[0].drawn[-len(said.route)]}:
            yield f'diversion: {name} does not begin on the route before it'
        elif before[1].value != said.value:
            yield f'value: {name} states another one than the departure that it diverts'


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort names with their numbers as numbers: ``run_2`` before ``run_10``."""
    parts = re.split(r'(\d+)', path.stem)
    return [(int(part), '') if part.isdecimal() else (-1, part) for part in parts]
