"""An advisory lock on a folder, which the kernel takes back when its holder dies."""

from __future__ import annotations

import fcntl
import os
import weakref
from contextlib import suppress
from pathlib import Path


class FolderLock:
    """Holds the exclusive ``flock`` of a folder until ``release``.

    It stays locked when it is renamed; ``wait`` says whether to wait for another holder.

    Raises
    ------
    BlockingIOError
        Another one holds it, and ``wait`` is False.
    OSError
        There is no such folder, or (only with ``wait`` False) its file system has no locks; a
        recorder that waits goes on without one there, as ``repair`` then fails to get one, too,
        and leaves the folder alone.
    """

    def __init__(self, folder: Path, *, wait: bool = True) -> None:
        self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        # Also when the owner is forgotten: nobody else could close the descriptor then.
        self.release = weakref.finalize(self, os.close, self._descriptor)
        if wait:
            with suppress(OSError):
                fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            return
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.release()
            raise

    def is_of(self, folder: Path) -> bool:
        """Whether ``folder`` names the very folder that is locked, and not a later one."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(folder))
        except OSError:
            return False
