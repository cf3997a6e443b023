"""The chain of recordings: each states the SHA-256 of the one before it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

from ..errors import shown
from .bag_folder import FILE_NAME, bag_of, listed_files, read_bag
from .recorded_departures import source_findings
from .verify import Verdict


def together(verdicts: Sequence[Verdict], expected: str = '') -> tuple[list[str], list[str]]:
    """Check files of a folder against each other and the folder: (faults, notes).

    Parameters
    ----------
    verdicts
        Of all files, in their order.
    expected
        The SHA-256 of a recording that was noted elsewhere, or ''.
    """
    faults, notes = chain_faults(verdicts)
    faults += folder_faults(verdicts)
    faults += [
        f'random source: {each}' for each in source_findings(
            SimpleNamespace(path=each.path, id=each.metadata.id,
                            route_entropy_source=each.metadata.route_entropy_source)
            for each in verdicts if each.metadata
        )
    ]
    if expected:
        hashes = [each.sha256 for each in verdicts]
        if expected not in hashes:
            faults.append('the recording of the expected hash is not here: it or its hash changed')
        elif later := len(hashes) - 1 - hashes.index(expected):
            notes.append(f'{later} recordings are newer than the one of the expected hash')
    return faults, notes


def chain_faults(verdicts: Sequence[Verdict]) -> tuple[list[str], list[str]]:
    """Follow the chain through files in their order, named as they are in it.

    Returns
    -------
    (list of str, list of str)
        What is wrong: files that are missing, exchanged, moved or inserted. And what is no fault:
        where the chain comes from.
    """
    by_hash = {each.sha256: each for each in verdicts if each.sha256}
    names = [each.path.name for each in verdicts]
    faults, notes = [], []
    followed: dict[str, list[str]] = {}
    for number, (name, each) in enumerate(zip(names, verdicts, strict=True)):
        if each.metadata is None:
            continue
        link = each.metadata.link
        if link.file != name:
            faults.append(f'{_shown(name)} is moved: it was recorded as {_shown(link.file)}')
        if not link.follows:
            # Nodes that started in the same second named their sessions alike.
            earlier = {_place(before) for before in verdicts[:number]}
            if _place(each) in earlier:
                faults.append(f'{_shown(name)} is inserted: it follows nothing')
            elif earlier:
                notes.append(f'{_shown(name)} begins a chain of its own')
            continue
        followed.setdefault(link.sha256, []).append(name)
        if before := by_hash.get(link.sha256):
            if before.metadata and before.metadata.link.file != link.follows:
                faults.append(f'{_shown(name)} states another name of the file before it')
            continue
        what, is_fault = _unfollowed(name, link.follows, names, number)
        (faults if is_fault else notes).append(what)
    for together_after in followed.values():
        # Two sessions may begin after the same file; in one session nothing has two successors.
        sessions = list(map(_session, together_after))
        if len(set(sessions)) < len(sessions):
            said = _shown(' and '.join(together_after))
            faults.append(f'{said} follow the same file: one of them is inserted')
    return faults, notes


def _unfollowed(name: str, before: str, names: Sequence[str], number: int) -> tuple[str, bool]:
    """What it means that the file before one is not there, and whether that is a fault."""
    if before in names:
        return f'{_shown(before)} is exchanged: {_shown(name)} followed another one', True
    if number == 0 and _session(before) != _session(name):
        return f'the first, {_shown(name)}, follows {_shown(before)}, which is not here', False
    return f'{_shown(before)} is missing: {_shown(name)} followed it', True


def folder_faults(verdicts: Sequence[Verdict]) -> list[str]:
    """Check that each folder's ``metadata.yaml`` says just what the recordings in it are."""
    faults = []
    for folder in dict.fromkeys(each.path.parent for each in verdicts):
        inside = [each for each in verdicts if each.path.parent == folder]
        faults += _number_faults(inside)
        bag, listed = read_bag(folder), listed_files(folder)
        yaml = _shown(folder / FILE_NAME)
        if listed is None:
            if (folder / FILE_NAME).exists():
                faults.append(f'{yaml} lists no files')
            continue
        present = {name for name in os.listdir(folder) if name.endswith('.mcap')}
        for name in sorted(present - set(listed)):
            faults.append(f'{_shown(folder / name)} is there, but {FILE_NAME} does not name it')
        for name in sorted(set(listed) - present):
            faults.append(f'{_shown(folder / name)} is not there, but {FILE_NAME} names it')
        if len(listed) > len(set(listed)):
            faults.append(f'{yaml} names a file twice')
        files = {each.path.name: each.file for each in inside if each.file}
        if 'version' in bag and set(files) == set(listed):
            known = bag_of(files[name] for name in listed)
            wrong = [key for key in {**known, **bag}
                     if key != 'ros_distro' and bag.get(key) != known.get(key)]
            faults += [f'{yaml}: {_shown(key)} is not that of the files' for key in wrong]
    return faults


def _number_faults(verdicts: Sequence[Verdict]) -> list[str]:
    first: dict[int, str] = {}
    return [
        f'{_shown(each.path.name)} has the number of {_shown(other)}, departure {each.number}'
        for each in verdicts
        if each.number and (other := first.setdefault(each.number, each.path.name))
        != each.path.name
    ]


def _place(verdict: Verdict) -> tuple[Path, str]:
    return verdict.path.parent, _session(verdict.path.name)


def _session(name: str) -> str:
    return name.rpartition('_')[0]


def _shown(name: Path | str) -> str:
    return shown(str(name)[:200])
