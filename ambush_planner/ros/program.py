# SPDX-License-Identifier: Apache-2.0
"""The program ``ambush_planner``: the node in a process that has one heap."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3  # from glibc's malloc.h


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    with suppress(AttributeError):  # not glibc
        # One heap for all threads, without large arrays: freed memory is used again or given back.
        # With glibc's defaults the node grew by 10 % in half an hour.
        for option, value in ((_M_ARENA_MAX, 1), (_M_MMAP_THRESHOLD, 2**18)):
            ctypes.CDLL(None).mallopt(option, value)
    # Not before: rclpy's libraries start threads, and heaps that these had first would be shared.
    from .planner_node import main as run
    return run(args)


if __name__ == '__main__':
    sys.exit(main())
