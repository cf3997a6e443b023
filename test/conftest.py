"""No run hangs, goes on without a worker that has died, or leaves processes and shared memory."""

import faulthandler
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import leftovers
import pytest
from hypothesis import HealthCheck, settings

# How fast the machine is decides nothing; HUNT looks for new examples, as in games.py.
settings.register_profile('suite', deadline=None, derandomize='HUNT' not in os.environ,
                          database=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('suite')
# Not by shared memory: there a process that is killed could crash others, and what a process
# sends last is lost with it where the reader is slow. Demo and benchmarks set their own range.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(
    Path(__file__).resolve().parents[1] / 'config' / 'fastdds_udp.xml')
# Tests run side by side: numpy, not loaded yet, would only get in its own way with more threads.
os.environ.setdefault('OMP_NUM_THREADS', '1')


def pytest_addoption(parser):
    parser.addini('session_limit', 'seconds after which the whole run is ended', default='2400')
    parser.addoption('--kills', type=int, default=2, help='nodes to kill while they record')


def pytest_configure(config):
    faulthandler.register(signal.SIGUSR1, os.dup(2))
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in `make test &`
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.option.loadscopereorder = False  # xdist's: the files of most tests first
    if not hasattr(config, 'workerinput'):
        config.pluginmanager.register(Guard(float(config.getini('session_limit'))), 'guard')


def pytest_collection_modifyitems(items):
    """Files with slow tests first, so that in the end no worker waits for another."""
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Two workers more than there are cores: many tests wait for other processes."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.fixture
def submitted(monkeypatch):
    """The keys of solves that are submitted in this process from now on."""
    from ambush_planner.worker.solve_queue import SolveQueue  # most tests need no worker
    keys, submit = [], SolveQueue.submit

    def tell(queue, key, *rest):
        solve = submit(queue, key, *rest)
        keys.append(key)
        return solve

    monkeypatch.setattr(SolveQueue, 'submit', tell)
    return keys


@pytest.fixture(scope='module')
def fewer_draws():
    """Audits compare with as many draws as of many strategies: p-values are exact with any."""
    from ambush_planner.audit import departures
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(departures, 'RESAMPLES', departures.RESAMPLES_OF_MANY)
        yield


class Guard:
    """Watches over a run from its first process, which is the only one without xdist."""

    def __init__(self, limit):
        self.limit, self.began = limit, time.time()
        self.mark = leftovers.mark_processes()
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
        # What xdist makes of the test that a worker died in. It would let the others finish what
        # they have, and forgets some of that and waits for it for ever.
        if report.when == '???':
            leftovers.end_processes(self.mark)
            pytest.exit(f'{report.longrepr}', returncode=1)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session):
        self.ended.set()
        self.asked_to_end.set()
        if self.lost and not session.exitstatus:
            session.exitstatus = 1
        leftovers.end_processes(self.mark)
        leftovers.remove_shared_memory(self.began)

    def _watch(self):
        why = 'ended by SIGTERM' if self.asked_to_end.wait(self.limit) else (
            f'no end within {self.limit:g} s')
        if self.ended.is_set():
            return
        said = f'\n{why}; running: {sorted(self.running)}\n'
        os.write(self.stderr, said.encode())
        # Where the tests are; what is no test is ended by it.
        for pid in (os.getpid(), *leftovers.marked(self.mark)):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGUSR1)
        # With its workers dead xdist ends the run, as above.
        self.ended.wait(1.0)
        leftovers.end_processes(self.mark)
        if not self.ended.wait(5.0):
            leftovers.remove_shared_memory(self.began)
            os._exit(1)
