"""Ends a test run that loses a worker, and the processes that tests leave behind."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest

# Environment variable that all processes of a run inherit.
NAME = 'AMBUSH_PLANNER_TEST_RUN'


class Watchdog:
    """Watches a run from its main process."""

    def __init__(self):
        self.mark = uuid4().hex
        # A run inside another one keeps both marks.
        os.environ[NAME] = os.environ.get(NAME, '') + self.mark
        self.lost = []

    def pytest_sessionstart(self):
        # As for an interrupt: fixtures and pytest_sessionfinish are to run.
        signal.signal(signal.SIGTERM, signal.default_int_handler)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node, error):
        if error:
            self.lost.append(node.gateway.id)

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        # xdist's report of the test in which a worker died; xdist itself would wait for ever.
        if report.when == '???':
            self.end_processes()
            pytest.exit(f'{report.longrepr}', returncode=1)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session):
        if self.lost and not session.exitstatus:
            session.exitstatus = 1
        self.end_processes()

    def end_processes(self, seconds=5.0):
        """Kill this run's processes until none is left."""
        end = time.monotonic() + seconds
        while (found := self._others()) and time.monotonic() < end:
            for pid in found:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(0.05)

    def _others(self):
        """The ids of all other processes with the mark."""
        found = []
        for folder in Path('/proc').glob('[0-9]*'):
            with suppress(OSError):  # it has ended, or belongs to another user
                words = (folder / 'environ').read_bytes().split(b'\0')
                if any(word.startswith(NAME.encode()) and self.mark.encode() in word
                       for word in words):
                    found.append(int(folder.name))
        return [pid for pid in found if pid != os.getpid()]
