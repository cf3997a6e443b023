"""What was freed goes back to the system."""

import ctypes
from pathlib import Path

import pytest

from ambush_planner.ros.heap import give_back

PAGE = 4096


def resident():
    return int(Path('/proc/self/statm').read_text().split()[1]) * PAGE


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), 'malloc_trim'), reason='not glibc')
def test_what_lies_free_between_what_is_in_use_goes_back():
    blocks = [bytearray(10 * PAGE) for _ in range(1000)]
    kept = blocks[::10]  # so that the heap cannot shrink from its end
    del blocks
    before = resident()
    give_back()
    assert before - resident() > 500 * 10 * PAGE
    assert len(kept) == 100
