# SPDX-License-Identifier: Apache-2.0
"""The program ``ambush_planner``: the node in a process of its own, with one heap."""

from __future__ import annotations

import os
import signal
import sys

_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3  # from glibc's malloc.h


def noted_signals() -> list[int]:
    """Have SIGINT and SIGTERM do nothing but append their numbers to the returned list.

    rclpy's handlers end the context at once, whatever its threads are doing, which crashes a
    starting node; and an Event's lock would not let one signal interrupt another. A second Ctrl-C
    does not interrupt the clean-up; a second SIGTERM ends a process that hangs.
    """
    received: list[int] = []

    def note(number: int, _: object) -> None:
        received.append(number)
        if number == signal.SIGTERM:
            signal.signal(number, signal.SIG_DFL)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, note)
    return received


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or the end of its context; return the exit code."""
    # There is nothing to end during the imports, which take a second and so come after this.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    import ctypes
    import resource
    from contextlib import suppress

    # A core dump would hold routes and the sources of their draw.
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    with suppress(AttributeError):  # not glibc
        # One heap for all threads, without large arrays: freed memory is used again or given back.
        # With glibc's defaults the node grew by 10 % in half an hour.
        for option, value in ((_M_ARENA_MAX, 1), (_M_MMAP_THRESHOLD, 2**18)):
            ctypes.CDLL(None).mallopt(option, value)
    # Not before: rclpy's libraries start threads, and heaps that these had first would be shared.
    from .planner_node import main as run
    try:
        return run(args, noted_signals())
    finally:
        # Python restores its handler at its end, and a second Ctrl-C would kill it then.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == '__main__':
    sys.exit(main())
