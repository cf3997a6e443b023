"""Memory that was freed goes back to the system, as far as the C library is glibc.

Measured by benchmarks/node_soak.py: without it the node grows in thousands of departures.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress

_M_ARENA_MAX = -8  # malloc.h
_C = ctypes.CDLL(None)


def share_one_heap() -> None:
    """Keep glibc from giving each thread a heap, which keeps what was freed in it."""
    with suppress(AttributeError):
        _C.mallopt(_M_ARENA_MAX, 1)


def give_back() -> None:
    """Return what lies free between what is in use; takes milliseconds."""
    with suppress(AttributeError):
        _C.malloc_trim(0)
