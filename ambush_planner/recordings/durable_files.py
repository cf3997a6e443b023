# SPDX-License-Identifier: Apache-2.0
"""Files that are either complete or absent, even after a crash or a power cut.

They are secret: only their user can read and write them. In a folder with the setgid bit, which a
group shares, the group can, too.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from itertools import takewhile
from pathlib import Path

TEMPORARY = '.tmp'


def write_all_durably(files: Mapping[Path, bytes]) -> None:
    """Put all files in place, or none if one of them cannot be written.

    The data goes to temporary files in the same folders, is flushed to the disk, and these are then
    renamed: a reader sees the old content of a file or the new one, never a part. Files have mode
    0600, missing folders 0700; in a shared folder 0660 and 2770. Raises OSError; no temporary file
    is left then.
    """
    temporary = {path: path.with_name(f'{path.name}{TEMPORARY}') for path in files}
    try:
        for path, data in files.items():
            make_private_folders(Path(os.path.abspath(path.parent)))
            try:
                temporary[path].unlink(missing_ok=True)
                _write_new_file(temporary[path], data)
            except OSError as error:
                error.filename = os.fspath(path)  # on a full disk, the error names no file
                raise
        for path, written in temporary.items():
            os.replace(written, path)
    finally:
        for written in temporary.values():
            with suppress(OSError):
                written.unlink(missing_ok=True)
    for folder in {path.parent for path in files}:
        _flush_folder(folder)


def make_private_folders(path: Path) -> None:
    """Make the folder ``path`` and the missing ones above it, with mode 0700 or 2770."""
    missing = takewhile(lambda folder: not folder.is_dir(), (path, *path.parents))
    for folder in reversed([*missing]):
        make_private_folder(folder, exist_ok=True)  # another process may make it meanwhile


def make_private_folder(path: Path, exist_ok: bool = False) -> None:
    """Make the folder ``path`` with mode 0700 or 2770 and flush its parent to the disk."""
    shared = is_shared(path.parent)
    path.mkdir(mode=0o700, exist_ok=exist_ok)
    if shared:
        path.chmod(0o2770)  # whatever the umask is
    _flush_folder(path.parent)


def is_shared(folder: Path) -> bool:
    """Return whether a folder has the setgid bit: a group shares it."""
    return bool(folder.stat().st_mode & stat.S_ISGID)


def _flush_folder(path: Path) -> None:
    """Flush the names in the folder ``path`` to the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write_new_file(path: Path, data: bytes) -> None:
    # O_EXCL and O_NOFOLLOW: never write through a link or into a file of another user.
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    with os.fdopen(os.open(path, flags, 0o600), 'wb') as file:
        if is_shared(path.parent):
            os.fchmod(file.fileno(), 0o660)  # whatever the umask is
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
