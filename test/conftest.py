"""No run hangs, goes on without a worker that has died, or leaves processes and shared memory."""

import faulthandler
import os
import sys
import threading
import time
from uuid import uuid4

import leftovers
import pytest

# Each process that a run starts inherits it: so they are found, whoever started them.
MARK = 'AMBUSH_PLANNER_TEST_RUN'


def pytest_addoption(parser):
    parser.addini('session_limit', 'seconds after which the whole run is ended', default='900')
    parser.addoption('--kills', type=int, default=4, help='nodes to kill while they record')


def pytest_configure(config):
    if not hasattr(config, 'workerinput'):
        config.pluginmanager.register(Guard(float(config.getini('session_limit'))), 'guard')


class Guard:
    """Watches over a run from its first process, which is the only one without xdist."""

    def __init__(self, limit):
        self.limit, self.began = limit, time.time()
        self.mark = os.environ[MARK] = uuid4().hex
        self.running, self.lost = set(), []
        self.ended = threading.Event()
        self.watch = threading.Thread(target=self._watch, daemon=True)

    def pytest_sessionstart(self):
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
        # What xdist makes of the test that a worker died in. It would let the others finish what
        # they have, and forgets some of that and waits for it for ever.
        if report.when == '???':
            pytest.exit(f'{report.longrepr}', returncode=1)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session):
        self.ended.set()
        if self.lost and not session.exitstatus:
            session.exitstatus = 1
        leftovers.end_processes(MARK, self.mark)
        leftovers.remove_shared_memory(self.began)

    def _watch(self):
        if self.ended.wait(self.limit):
            return
        print(f'\nno end within {self.limit:g} s; running: {sorted(self.running)}',
              file=sys.__stderr__, flush=True)
        faulthandler.dump_traceback(sys.__stderr__)
        leftovers.end_processes(MARK, self.mark)
        # With its workers dead xdist ends the run, as above.
        if not self.ended.wait(20.0):
            leftovers.remove_shared_memory(self.began)
            os._exit(1)
