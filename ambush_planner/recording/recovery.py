"""Whole files from broken ones: what ``ambush_recover`` does."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .bag_metadata import FILE_NAME, BagMetadata, describe_file
from .durable import create_durably, make_private_folder
from .encoding import encode_content
from .errors import RecordingFailed, UnreadableRecording, reading_from
from .mcap_content import read_summary
from .mcap_records import DamagedRecord
from .reader import natural_order, read_bytes
from .salvage import Loss, Salvage, salvage

# What the recorder, its repair and their crashes leave: x.mcap, x.mcap.tmp, x.mcap.broken-2 ...
_NAME = re.compile(r'(?P<stem>.+?)\.mcap(\.tmp|\.broken)*(-\d+)?(\.broken)?')

Progress = Callable[[Path, float], None]


@dataclass(frozen=True)
class Recovered:
    """What became of one file.

    Attributes:
        source: The file.
        target: Where what was saved of it is; None if nothing was, or nothing had to be.
        found: What was saved and lost.
    """

    source: Path
    target: Path | None
    found: Salvage


def default_target(source: Path) -> Path:
    """Return where the recovered content of a file or folder goes if nothing else is said."""
    if source.is_dir():
        # '.' and '..' have no name of their own to put anything beside.
        folder = source.resolve()
        return folder.parent / f'{folder.name}.recovered'
    return source.with_name(f'{_stem(source)}.recovered.mcap')


def recover_file(source: Path, target: Path | None, progress: Progress) -> Recovered:
    """Save what is whole in ``source`` as the new file ``target`` (mode 0600).

    Nothing is written where nothing could be saved.

    Args:
        source: Any file; it is not changed.
        target: Must not be there yet. None for ``default_target``; then a recording that is
            whole under its proper name is left without a copy, for a second one beside it would
            count as another departure of the session.
        progress: Called now and then with the file and the fraction of it that is done.

    Raises:
        UnreadableRecording: The file cannot be read at all.
        RecordingFailed: The target is already there, or cannot be written.
    """
    data, found = _salvage(source, progress)
    if target is None and found.is_whole and source.suffix == '.mcap':
        return Recovered(source, None, found)
    return _save(source, target or default_target(source), data, found)


def recover_folder(source: Path, target: Path | None, progress: Progress) -> list[Recovered]:
    """Save what is whole in the files of a session folder in the new folder ``target``.

    A folder of session folders becomes one, too. Files that are whole are copied as they are. The
    new folders have mode 0700 and a metadata.yaml, so that ``ros2 bag`` takes them.

    Args:
        source: The folder; it is not changed.
        target: Must not be there yet. None for ``default_target``.
        progress: Called now and then with a file and the fraction of it that is done.

    Raises:
        UnreadableRecording: The folder cannot be read, or has no recordings.
        RecordingFailed: The target is already there, or cannot be written.
    """
    target = target or default_target(source)
    sessions = {source: target} if _files_in(source) else {}
    with reading_from(source):
        folders = [] if sessions else sorted(p for p in source.iterdir() if p.is_dir())
    sessions |= {folder: target / folder.name for folder in folders if _files_in(folder)}
    if not sessions:
        raise UnreadableRecording(source, 'there is nothing to recover: no .mcap file, no session')
    if source not in sessions:
        _make_folder(target)
    return [
        each
        for folder, new in sessions.items()
        for each in _recover_session(folder, new, progress)
    ]


def _recover_session(source: Path, target: Path, progress: Progress) -> list[Recovered]:
    _make_folder(target)
    metadata = BagMetadata()
    done = []
    for path in _files_in(source):
        try:
            data, found = _salvage(path, progress)
        except UnreadableRecording as error:
            done.append(Recovered(path, None, Salvage.nothing(error.reason)))
            continue
        done.append(_save(path, _free(target / f'{_stem(path)}.mcap'), data, found))
        if (written := done[-1].target) is not None:
            metadata.add(describe_file(written.name, written.read_bytes()))
    if not metadata.is_empty():
        _create(target / FILE_NAME, metadata.text())
    return done


def _salvage(source: Path, progress: Progress) -> tuple[bytes, Salvage]:
    data = read_bytes(source)
    found = salvage(data, lambda offset: progress(source, offset / len(data)))
    if found.is_whole and not _has_summary(data):
        # Valid, but nothing that reads the summary first can play it.
        found.rebuilt = 'the index at the end of the file'
        _drop_undefined(found)
    return data, found


def _has_summary(data: bytes) -> bool:
    try:
        read_summary(data)
    except DamagedRecord:
        return False
    return True


def _drop_undefined(found: Salvage) -> None:
    """Leave out messages without a schema, which MCAP allows and ROS cannot read."""
    content = found.content
    defined = {k for k, channel in content.channels.items() if channel.schema_id in content.schemas}
    kept = [message for message in content.messages if message.channel_id in defined]
    if dropped := len(content.messages) - len(kept):
        found.losses.append(Loss(0, 0, f'{dropped} messages have no schema'))
        content.messages = kept


def _save(source: Path, target: Path, data: bytes, found: Salvage) -> Recovered:
    content = found.content
    if not (content.messages or content.metadata or content.attachments):
        return Recovered(source, None, found)
    _create(target, data if found.is_whole else encode_content(content))
    return Recovered(source, target, found)


def _files_in(folder: Path) -> list[Path]:
    with reading_from(folder):
        found = [p for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_file()]
    return sorted(found, key=natural_order)


def _stem(path: Path) -> str:
    match = _NAME.fullmatch(path.name)
    return match['stem'] if match else path.name


def _free(wanted: Path) -> Path:
    """``wanted``, or it with a number: x.mcap and x.mcap.tmp may both hold something."""
    path, number = wanted, 2
    while path.exists():
        path = wanted.with_name(f'{wanted.stem}-{number}{wanted.suffix}')
        number += 1
    return path


def _make_folder(path: Path) -> None:
    _written(path, lambda: make_private_folder(path))


def _create(path: Path, data: bytes) -> None:
    _written(path, lambda: create_durably(path, data))


def _written(path: Path, write: Callable[[], None]) -> None:
    try:
        write()
    except FileExistsError as error:
        raise RecordingFailed(path, 'it is already there; name another output (-o)') from error
    except OSError as error:
        raise RecordingFailed(path, error.strerror or str(error)) from error
