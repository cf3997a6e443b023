"""Waiting for a condition, with a generous end."""

import os
import time
from contextlib import contextmanager

# s; discovery alone may take 3, on a busy machine a multiple. Only what fails waits so long.
TIMEOUT = 60.0


def wait_until(condition, what, timeout=TIMEOUT):
    """Return the first true value of ``condition()``, asked the less often the longer it takes."""
    begin = time.monotonic()
    while (waited := time.monotonic() - begin) < timeout:
        if value := condition():
            return value
        time.sleep(min(0.002 + 0.02 * waited, 0.01))
    raise AssertionError(f'not within {timeout} s: {what}')


@contextmanager
def stderr_in(path):
    """Have this process' stderr in a file, and yield what reads it so far.

    pytest's capfd empties what it has read, and loses what is written meanwhile.
    """
    kept = os.dup(2)
    with path.open('wb') as file:
        os.dup2(file.fileno(), 2)
    try:
        yield lambda: path.read_text(errors='replace')
    finally:
        os.dup2(kept, 2)
        os.close(kept)
