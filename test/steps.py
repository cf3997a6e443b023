"""How much Python does: the same on every machine, however busy."""

import sys
import threading


def steps(function, *arguments):
    """Count the lines that a call runs in this thread, including every turn of a loop.

    A loop over what an array holds counts as many as it has entries; numpy counts one.
    """
    count, before, thread = 0, sys.gettrace(), threading.get_ident()

    def trace(*_):
        nonlocal count
        count += threading.get_ident() == thread
        return trace

    sys.settrace(trace)
    try:
        function(*arguments)
    finally:
        sys.settrace(before)
    return count
