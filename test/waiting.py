"""Waiting for a condition, with a generous end."""

import time

# s; discovery alone may take 3, on a busy machine a multiple. Only what fails waits so long.
TIMEOUT = 60.0


def wait_until(condition, what, timeout=TIMEOUT):
    """Return the first true value of ``condition()``."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.002)
    raise AssertionError(f'not within {timeout} s: {what}')
