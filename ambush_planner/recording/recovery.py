"""Whole files from broken ones: what ``ambush_recover`` does."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

from .bag_metadata import FILE_NAME, BagFile, BagMetadata, can_be_listed, describe_file
from .durable import create_durably, make_private_folder
from .encoding import encode_content
from .errors import RecordingFailed, UnreadableRecording, reading_from
from .mcap_content import read_summary
from .mcap_records import DamagedRecord
from .reader import is_session, natural_order, read_bytes
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
        messages: How many of its messages were saved.
        metadata: How many of its metadata records were.
        attachments: How many of its attachments were.
        stated_messages: How many messages the file says it had, if it still does.
        rebuilt: What was broken, though nothing is missing for it.
        unverified: How many messages are from chunks whose checksum does not hold.
        losses: What is missing or not to be trusted.
    """

    source: Path
    target: Path | None
    messages: int
    metadata: int
    attachments: int
    stated_messages: int | None
    rebuilt: str
    unverified: int
    losses: tuple[Loss, ...]

    @classmethod
    def of(cls, source: Path, target: Path | None, found: Salvage) -> Recovered:
        """Count what was found, so that nobody has to keep it."""
        content = found.content
        counts = len(content.messages), len(content.metadata), len(content.attachments)
        return cls(
            source, target, *counts, found.stated_messages, found.rebuilt, found.unverified,
            tuple(found.losses),
        )

    @property
    def is_whole(self) -> bool:
        """Whether it was a whole file to begin with."""
        return not self.losses and not self.rebuilt


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
        return Recovered.of(source, None, found)
    return _save(source, target or default_target(source), data, found)


def recover_folder(source: Path, target: Path | None, progress: Progress) -> Iterator[Recovered]:
    """Save what is whole in the files of a session folder in the new folder ``target``.

    Session folders in it become folders in that one; those of earlier recoveries are left out.
    Files that are whole are copied as they are. The new folders have mode 0700 and a
    metadata.yaml, so that ``ros2 bag`` takes them.

    Args:
        source: The folder; it is not changed.
        target: Must not be there yet. None for ``default_target``.
        progress: Called now and then with a file and the fraction of it that is done.

    Yields:
        What became of each file, when it is done. Close the generator where it is left early:
        then, as after an error, metadata.yaml lists what was saved until then.

    Raises:
        UnreadableRecording: The folder cannot be read, or has no recordings.
        RecordingFailed: The target is already there, or cannot be written.
    """
    target = target or default_target(source)
    sessions = {source: target} if _files_in(source) else {}
    with reading_from(source):
        folders = sorted(p for p in source.iterdir() if is_session(p))
    sessions |= {folder: target / folder.name for folder in folders if _files_in(folder)}
    if not sessions:
        raise UnreadableRecording(source, 'there is nothing to recover: no .mcap file, no session')
    if source not in sessions:
        _make_folder(target)
    for folder, new in sessions.items():
        yield from _recover_session(folder, new, progress)


def _recover_session(source: Path, target: Path, progress: Progress) -> Iterator[Recovered]:
    _make_folder(target)
    metadata = BagMetadata()
    try:
        for path in _files_in(source):
            recovered = _recover_into(target, path, progress)
            if recovered.target is not None:
                metadata.add(_described(recovered.target))
            yield recovered
    finally:
        # Also where the disk is full or the user has had enough: what is there is a bag.
        if not metadata.is_empty():
            _create(target / FILE_NAME, metadata.text())


def _recover_into(folder: Path, source: Path, progress: Progress) -> Recovered:
    """Save a file in the new folder; what it holds is forgotten on return."""
    try:
        data, found = _salvage(source, progress)
    except UnreadableRecording as error:
        return Recovered.of(source, None, Salvage.nothing(error.reason))
    return _save(source, _free(folder / f'{_listable(_stem(source))}.mcap'), data, found)


def _described(path: Path) -> BagFile:
    with path.open('rb') as file:
        # Only its end is read. The map is closed when nothing refers to it.
        return describe_file(path.name, mmap(file.fileno(), 0, access=ACCESS_READ))


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
        return Recovered.of(source, None, found)
    _create(target, data if found.is_whole else encode_content(content))
    return Recovered.of(source, target, found)


def _files_in(folder: Path) -> list[Path]:
    with reading_from(folder):
        found = [p for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_file()]
    return sorted(found, key=natural_order)


def _stem(path: Path) -> str:
    match = _NAME.fullmatch(path.name)
    return match['stem'] if match else path.name


def _listable(name: str) -> str:
    """``name`` with an underscore for each character that metadata.yaml cannot hold."""
    return ''.join(each if can_be_listed(each) else '_' for each in name)


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
        reason = (
            'it is already there, perhaps half done by a run that was interrupted; remove it, or '
            'name another output (-o)'
        )
        raise RecordingFailed(path, reason) from error
    except OSError as error:
        raise RecordingFailed(path, error.strerror or str(error)) from error
