# SPDX-License-Identifier: Apache-2.0
"""Ends test runs that hang or lose a worker, and the processes that tests leave behind."""

import faulthandler
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest

# Environment variable that all processes of a run inherit.
NAME = 'AMBUSH_PLANNER_TEST_RUN'


def pytest_addoption(parser):
    parser.addini('session_limit', 'seconds after which the whole run is ended', default='2400')


def pytest_configure(config):
    faulthandler.register(signal.SIGUSR1, os.dup(2))
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in `make test &`
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, 'workerinput'):
        config.pluginmanager.register(Watchdog(float(config.getini('session_limit'))), 'watchdog')


class Watchdog:
    """Watches a run from its main process."""

    def __init__(self, limit):
        self.limit = limit
        self.mark = mark_processes()
        self.running, self.lost = set(), []
        self.stderr = os.dup(2)  # not yet that of a test
        self.asked_to_end, self.ended = threading.Event(), threading.Event()
        self.watch = threading.Thread(target=self._watch, daemon=True)

    def pytest_sessionstart(self):
        signal.signal(signal.SIGTERM, lambda *_: self.asked_to_end.set())
        self.watch.start()

    def pytest_runtest_logstart(self, nodeid):
        self.running.add(nodeid)

    def pytest_runtest_logfinish(self, nodeid):
        self.running.discard(nodeid)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node, error):
        if error:
            self.lost.append(node.gateway.id)

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        # xdist's report of the test in which a worker died; xdist itself would wait for ever.
        if report.when == '???':
            end_processes(self.mark)
            pytest.exit(f'{report.longrepr}', returncode=1)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session):
        self.ended.set()
        self.asked_to_end.set()
        if self.lost and not session.exitstatus:
            session.exitstatus = 1
        end_processes(self.mark)

    def _watch(self):
        why = 'ended by SIGTERM' if self.asked_to_end.wait(self.limit) else (
            f'no end within {self.limit:g} s')
        if self.ended.is_set():
            return
        said = f'\n{why}; running: {sorted(self.running)}\n'
        os.write(self.stderr, said.encode())
        # The tests print where they are; other processes end.
        for pid in (os.getpid(), *marked(self.mark)):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGUSR1)
        self.ended.wait(1.0)
        end_processes(self.mark)
        if not self.ended.wait(2.0):
                os._exit(1)


def mark_processes():
    """Mark all later descendants of this process; return the mark."""
    mark = uuid4().hex
    # A run inside another one keeps both marks.
    os.environ[NAME] = os.environ.get(NAME, '') + mark
    return mark


def marked(mark):
    """Return the process ids of all others with the mark."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            words = (folder / 'environ').read_bytes().split(b'\0')
        except OSError:  # it has ended, or belongs to another user
            continue
        if any(word.startswith(NAME.encode()) and mark.encode() in word for word in words):
            found.append(int(folder.name))
    return [pid for pid in found if pid != os.getpid()]


def end_processes(mark, seconds=5.0):
    """Kill the marked processes until none is left."""
    end = time.monotonic() + seconds
    while (found := marked(mark)) and time.monotonic() < end:
        for pid in found:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)
