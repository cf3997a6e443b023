"""Puts session folders right that a crash or a power cut left behind."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import AmbushPlannerError
from .bag_folder import FILE_NAME, BagFile, bag_text, describe_file, listed_files
from .durable_files import flush_folder, write_durably
from .folder_lock import FolderLock
from .mcap_file import decode, encode, whole_part
from .reader import natural_order, read_bytes
from .recorder import SESSION_PREFIX
from .recording_errors import UnreadableRecording

_RECORDING = '.mcap'
_TEMPORARY = '.tmp'


@dataclass(frozen=True)
class Repair:
    """One thing that was done, or could not be done.

    Attributes
    ----------
    path
        The file or folder, under the name that it has now (or had, if it is removed).
    action
        ``finished`` (a temporary file got its name, as far as it was whole), ``removed`` (one
        without a whole message), ``listed`` (metadata.yaml was written anew) or ``failed``.
        Recordings that have their name are never renamed or removed.
    detail
        More on it, without anything that was recorded.
    """

    path: Path
    action: str
    detail: str = ''

    def __str__(self) -> str:
        return f'{self.path}: {self.action}' + (f' ({self.detail})' if self.detail else '')


def repair(directory: Path | str) -> list[Repair]:
    """Put right every session folder below a recording.directory that no recorder holds.

    Temporary files that a dying recorder left are finished or removed, and metadata.yaml lists
    again the files that are there, so that ``ros2 bag`` takes the folder. Broken recordings are
    not listed, as ``ros2 bag`` would refuse the folder for them; they keep their names. Folders of
    living recorders are left alone.

    Returns
    -------
    list of Repair
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


def list_files(folder: Path) -> tuple[int, list[str]]:
    """Write metadata.yaml for the recordings in ``folder``.

    Returns
    -------
    (int, list of str)
        How many are listed, and the names of those that are broken and are not.

    Raises
    ------
    OSError
        The folder cannot be read or written.
    """
    described = {name: _described(folder / name) for name in _recordings(folder)}
    files = [each for each in described.values() if each is not None]
    if files:
        write_durably(folder / FILE_NAME, bag_text(files))
    elif (folder / FILE_NAME).exists():
        (folder / FILE_NAME).unlink()
        flush_folder(folder)
    return len(files), [name for name, each in described.items() if each is None]


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
    recordings, listed = _recordings(folder), listed_files(folder)
    if listed is None:
        return FILE_NAME not in names and not recordings
    unlisted = set(recordings) - set(listed)
    return len(listed) + len(unlisted) == len(recordings) and not any(
        _described(folder / name) for name in unlisted
    )


def _recordings(folder: Path) -> list[str]:
    """Names that end like those of recordings; YAML has no bytes that are not UTF-8."""
    return sorted(
        (name for name in os.listdir(folder) if name.endswith(_RECORDING) and _is_utf8(name)),
        key=lambda name: natural_order(Path(name)),
    )


def _is_utf8(name: str) -> bool:
    return all(not '\ud800' <= each <= '\udfff' for each in name)


def _described(path: Path) -> BagFile | None:
    """Describe a recording; None if it is broken."""
    try:
        return describe_file(path.name, decode(read_bytes(path)))
    except (ValueError, LookupError, UnreadableRecording):
        return None


def _repair_locked(folder: Path, done: list[Repair]) -> None:
    lock = FolderLock(folder, wait=False)
    try:
        for temporary in sorted(folder.glob(f'*{_TEMPORARY}')):
            with _reported(temporary, done):
                _settle(temporary, done)
        if not _is_in_order(folder):
            count, broken = list_files(folder)
            without = f'; broken, see ambush_recover: {", ".join(broken)}' if broken else ''
            done.append(Repair(folder / FILE_NAME, 'listed', f'{count} recordings{without}'))
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
    content, fault = whole_part(data)
    if not content.messages:
        temporary.unlink()
        done.append(Repair(temporary, 'removed', f'{len(data)} bytes without a whole message'))
        return
    if fault:
        # In two steps that each are whole or not there: another crash in between loses nothing.
        write_durably(temporary, encode(content))
    number = 2
    while os.path.lexists(target):  # no file is overwritten
        target = temporary.with_name(f'{temporary.stem.removesuffix(_RECORDING)}-{number}.mcap')
        number += 1
    temporary.rename(target)
    flush_folder(target.parent)
    done.append(Repair(target, 'finished', f'{len(content.messages)} messages' if fault else ''))
