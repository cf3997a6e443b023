"""Waiting for a condition, with a generous end."""

import time

TIMEOUT = 20.0  # s; discovery alone may take 3


def wait_until(condition, what, timeout=TIMEOUT):
    """Return the first true value of ``condition()``."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.002)
    raise AssertionError(f'not within {timeout} s: {what}')
