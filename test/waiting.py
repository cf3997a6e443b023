# SPDX-License-Identifier: Apache-2.0
"""Waiting for a condition, with a generous end."""

import os
import re
import time
from contextlib import contextmanager, suppress
from threading import Event
from unittest import mock

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
def held(owner, name):
    """Hold each call of a function up; yield events: one is called, and the calls may go on."""
    called, go_on, function = Event(), Event(), getattr(owner, name)

    def waits(*given, **named):
        called.set()
        assert go_on.wait(10.0 * TIMEOUT)
        return function(*given, **named)

    with mock.patch.object(owner, name, waits):
        try:
            yield called, go_on
        finally:
            go_on.set()


def answer_of(client, request):
    """Ask a service that changes nothing until it answers, and return the answer.

    The first answers are lost where the server has not yet found the client that has found it.
    """
    wait_until(client.service_is_ready, client.srv_name)
    for _ in range(int(TIMEOUT)):
        asked = client.call_async(request)
        with suppress(AssertionError):
            wait_until(asked.done, 'an answer', timeout=1.0)
            return asked.result()
    raise AssertionError(f'no answer of {client.srv_name}')


def unstamped(log):
    """A log without its times, whose digits may be any."""
    return re.sub(r'\[\d+\.\d{9}\] ', '', log)


@contextmanager
def stderr_in(path):
    """Have this process' stderr in a file, and yield what reads it so far.

    pytest's capfd empties what it has read, and loses what is written at that moment.
    """
    kept = os.dup(2)
    with path.open('wb') as file:
        os.dup2(file.fileno(), 2)
    try:
        yield lambda: unstamped(path.read_text(errors='replace'))
    finally:
        os.dup2(kept, 2)
        os.close(kept)
