"""Puts session folders right that a crash or a power cut left behind."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

from ..core.errors import AmbushPlannerError
from .bag_metadata import (
    FILE_NAME,
    MOST_METADATA_BYTES,
    BagFile,
    BagMetadata,
    can_be_listed,
    describe_file,
    listed_files,
)
from .durable import flush_folder, write_durably
from .encoding import encode_content
from .errors import UnreadableRecording
from .folder_lock import FolderLock
from .mcap_content import read_content
from .mcap_records import DamagedRecord
from .reader import natural_order, read_bytes
from .recorder import SESSION_PREFIX
from .salvage import salvage
from .yaml_text import BadYaml

_RECORDING = '.mcap'
_TEMPORARY = '.tmp'
_BROKEN = '.broken'


@dataclass(frozen=True)
class Repair:
    """One thing that was done, or could not be done.

    Attributes:
        path: The file or folder, under the name that it has now (or had, if it is removed).
        action: ``finished`` (a whole temporary file got its name), ``salvaged`` (what was whole of
            one did), ``removed`` (a temporary file with no whole message), ``set aside`` (a
            broken recording, renamed to ``*.broken``), ``listed`` (metadata.yaml was written
            anew) or ``failed``.
        detail: More on it, without anything that was recorded.
    """

    path: Path
    action: str
    detail: str = ''

    def __str__(self) -> str:
        return f'{self.path}: {self.action}' + (f' ({self.detail})' if self.detail else '')


def repair(directory: Path | str) -> list[Repair]:
    """Put right every session folder below a recording.directory that no recorder holds.

    Temporary files that a dying recorder left are finished, salvaged or removed, broken
    recordings are set aside, and metadata.yaml lists again exactly the files that are there, so
    that ``ros2 bag`` takes the folder. Folders of living recorders are left alone.

    Returns:
        What was done, and what could not be done (``failed``); nothing is raised for it.
    """
    directory = Path(directory).expanduser()
    done: list[Repair] = []
    try:
        with os.scandir(directory) as entries:
            folders = sorted(
                Path(entry.path)
                for entry in entries
                if entry.name.startswith(SESSION_PREFIX) and entry.is_dir(follow_symlinks=False)
            )
    except FileNotFoundError:
        return done
    except OSError as error:
        return [Repair(directory, 'failed', error.strerror or str(error))]
    for folder in folders:
        with _reported(folder, done):
            if not _is_in_order(folder):
                _repair_locked(folder, done)
    return done


def list_files(folder: Path, done: list[Repair]) -> None:
    """Write metadata.yaml for the recordings in ``folder``, and set broken ones aside.

    In this order: metadata.yaml never names a file that is not there, wherever this ends early,
    and the next repair, which finds files that are not listed, sets them aside.

    Raises:
        OSError: The folder cannot be read or written.
    """
    known = set(_listed(folder) or ())
    files: list[BagFile] = []
    broken: dict[Path, str] = {}
    for path in sorted(folder.glob(f'*{_RECORDING}'), key=natural_order):
        if not path.is_file() or not can_be_listed(path.name):
            continue
        try:
            files.append(_described(path, path.name in known))
        except (DamagedRecord, ValueError) as error:  # ValueError: an empty file cannot be mapped
            broken[path] = str(error)
    _list(folder / FILE_NAME, files, done)
    for path, reason in broken.items():
        _set_aside(path, reason, done)


@contextmanager
def _reported(path: Path, done: list[Repair]) -> Iterator[None]:
    """Report what cannot be done with ``path``, and go on."""
    try:
        yield
    except BlockingIOError:
        pass  # a living recorder holds the folder
    except OSError as error:
        done.append(Repair(path, 'failed', error.strerror or str(error)))
    except AmbushPlannerError as error:
        done.append(Repair(path, 'failed', str(error)))
    except Exception as error:
        # Files here may hold anything: one that a library fails on must not keep the other
        # folders, nor the node that is about to start, from their work.
        done.append(Repair(path, 'failed', type(error).__name__))


def _is_in_order(folder: Path) -> bool:
    """Whether nothing is to be done: no temporary file, and metadata.yaml lists what is there."""
    names = os.listdir(folder)
    if any(name.endswith(_TEMPORARY) for name in names):
        return False
    recordings = {name for name in names if name.endswith(_RECORDING) and can_be_listed(name)}
    if FILE_NAME not in names:
        return not recordings
    listed = _listed(folder)
    return listed is not None and len(listed) == len(recordings) and set(listed) == recordings


def _repair_locked(folder: Path, done: list[Repair]) -> None:
    lock = FolderLock(folder, wait=False)
    try:
        for temporary in sorted(folder.glob(f'*{_TEMPORARY}')):
            with _reported(temporary, done):
                _settle(temporary, done)
        if not _is_in_order(folder):
            list_files(folder, done)
    finally:
        lock.release()


def _settle(temporary: Path, done: list[Repair]) -> None:
    """Give a temporary file its name, as far as it is whole, or remove it."""
    target = temporary.with_suffix('')
    if not stat.S_ISREG(temporary.lstat().st_mode) or target.suffix != _RECORDING:
        temporary.unlink()
        done.append(Repair(temporary, 'removed'))
        return
    data = read_bytes(temporary)
    found = salvage(data)
    if not found.content.messages:
        temporary.unlink()
        done.append(Repair(temporary, 'removed', f'{len(data)} bytes without a whole message'))
        return
    if not found.is_whole:
        # In two steps that each are whole or not there: another crash in between loses nothing.
        write_durably(temporary, encode_content(found.content))
    target = _free_name(target)
    temporary.rename(target)
    flush_folder(target.parent)
    detail = '' if found.is_whole else f'{len(found.content.messages)} messages'
    done.append(Repair(target, 'finished' if found.is_whole else 'salvaged', detail))


def _free_name(wanted: Path) -> Path:
    """``wanted``, or it with a number behind it: no file is overwritten."""
    path, number = wanted, 2
    while path.exists() or path.is_symlink():
        path = wanted.with_name(f'{wanted.stem}-{number}{wanted.suffix}')
        number += 1
    return path


def _described(path: Path, known: bool) -> BagFile:
    """Describe a recording.

    One that metadata.yaml listed was finished before it, so its summary is believed; one that it
    did not list may be broken anywhere.

    Raises:
        DamagedRecord, ValueError: It is broken.
    """
    if not known:
        read_content(read_bytes(path))
    with path.open('rb') as file:
        # Only the end of the file is read. The map is closed when nothing refers to it.
        return describe_file(path.name, mmap(file.fileno(), 0, access=ACCESS_READ))


def _list(metadata: Path, files: list[BagFile], done: list[Repair]) -> None:
    """Let metadata.yaml list these files; without any there is none."""
    if files:
        write_durably(metadata, BagMetadata(files).text())
        done.append(Repair(metadata, 'listed', f'{len(files)} recordings'))
    elif metadata.exists():
        metadata.unlink()
        flush_folder(metadata.parent)
        done.append(Repair(metadata, 'removed', 'there are no recordings'))


def _set_aside(path: Path, reason: str, done: list[Repair]) -> None:
    aside = _free_name(path.with_name(path.name + _BROKEN))
    path.rename(aside)
    flush_folder(aside.parent)
    done.append(Repair(aside, 'set aside', f'{reason}; ambush_recover may save a part'))


def _listed(folder: Path) -> list[str] | None:
    """The files that the folder's metadata.yaml lists; None if it does not say."""
    try:
        return listed_files(read_bytes(folder / FILE_NAME, MOST_METADATA_BYTES))
    except (UnreadableRecording, BadYaml):
        return None
