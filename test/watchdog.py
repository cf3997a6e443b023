"""No run hangs, goes on without a worker that has died, or leaves processes and shared memory.

What processes that were killed leave behind: their children, and shared memory of Fast DDS.
"""

import faulthandler
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

import pytest

# Each process inherits it: so they are found, whoever started them.
NAME = 'AMBUSH_PLANNER_TEST_RUN'
SHARED = Path('/dev/shm')


def pytest_addoption(parser):
    parser.addini('session_limit', 'seconds after which the whole run is ended', default='2400')


def pytest_configure(config):
    faulthandler.register(signal.SIGUSR1, os.dup(2))
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in `make test &`
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, 'workerinput'):
        config.pluginmanager.register(Watchdog(float(config.getini('session_limit'))), 'watchdog')


class Watchdog:
    """Watches over a run from its first process, which is the only one without xdist."""

    def __init__(self, limit):
        self.limit, self.began = limit, time.time()
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
        # What xdist makes of the test that a worker died in. It would let the others finish what
        # they have, and forgets some of that and waits for it for ever.
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
        remove_shared_memory(self.began)

    def _watch(self):
        why = 'ended by SIGTERM' if self.asked_to_end.wait(self.limit) else (
            f'no end within {self.limit:g} s')
        if self.ended.is_set():
            return
        said = f'\n{why}; running: {sorted(self.running)}\n'
        os.write(self.stderr, said.encode())
        # Where the tests are; what is no test is ended by it.
        for pid in (os.getpid(), *marked(self.mark)):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGUSR1)
        # With its workers dead xdist ends the run, as above.
        self.ended.wait(1.0)
        end_processes(self.mark)
        if not self.ended.wait(5.0):
            remove_shared_memory(self.began)
            os._exit(1)


def mark_processes():
    """Mark all that this process starts from now on, and what those start; return the mark."""
    mark = uuid4().hex
    # A run inside another keeps the other's mark.
    os.environ[NAME] = os.environ.get(NAME, '') + mark
    return mark


def marked(mark):
    """Process ids of all others that bear the mark."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            words = (folder / 'environ').read_bytes().split(b'\0')
        except OSError:  # it has just ended, or is somebody else's
            continue
        if any(word.startswith(NAME.encode()) and mark.encode() in word for word in words):
            found.append(int(folder.name))
    return [pid for pid in found if pid != os.getpid()]


def end_processes(mark, seconds=5.0):
    """Kill them, and those that they start meanwhile, and see them off."""
    end = time.monotonic() + seconds
    while (found := marked(mark)) and time.monotonic() < end:
        for pid in found:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)


def remove_shared_memory(since):
    """Remove what Fast DDS has made since then, if no process maps it any more."""
    found = [path for path in SHARED.glob('fastrtps_*')
             if not path.name.endswith(('_el', '_sl')) and _is_ours(path, since)]
    if unused := set(found) - _mapped():
        time.sleep(0.5)  # another run may be about to map it
        unused -= _mapped()
    for path in unused:
        beside = [f'{path.name}_el', f'{path.name}_sl', f'sem.{path.name}_mutex']
        for each in (path, *map(path.with_name, beside)):
            each.unlink(missing_ok=True)


def _mapped():
    found = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        try:
            lines = maps.read_text().splitlines()
        except OSError:
            continue
        found.update(Path(line.split()[5]) for line in lines if f' {SHARED}/' in line)
    return found


def _is_ours(path, since):
    with suppress(FileNotFoundError):
        found = path.stat()
        return found.st_uid == os.getuid() and found.st_ctime >= since
    return False
