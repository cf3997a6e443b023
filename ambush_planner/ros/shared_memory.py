# SPDX-License-Identifier: Apache-2.0
"""Keep other users from reading the messages that Fast DDS puts into shared memory."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

# Messages of one DDS participant; ports hold none.
_SEGMENT = re.compile(r'/dev/shm/fastrtps_[0-9a-f]{16}$', re.MULTILINE)


def segments(process: int | str = 'self') -> set[Path]:
    """Return the segments with messages that a process has mapped."""
    with suppress(OSError):  # not Linux
        return {Path(each) for each in _SEGMENT.findall(Path(f'/proc/{process}/maps').read_text())}
    return set()


def hide_segments() -> None:
    """Give this process's segments mode 0600; Fast DDS makes them 0644 whatever the umask.

    To be called once there is a node, and with it the DDS participant. Other users lose nothing:
    Fast DDS writes to the shared memory that it reads, which their processes may not do anyway.
    """
    for segment in segments():
        with suppress(OSError):  # another user's, or gone
            os.chmod(segment, 0o600)
