"""Worker processes that serve one node of a test after the other."""

import multiprocessing
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from ambush_planner.worker import child
from ambush_planner.worker.process import WorkerProcess

# Forks a process that has imported what a worker needs: that takes longer than most tests.
_TEMPLATE = multiprocessing.get_context('forkserver')
_TEMPLATE.set_forkserver_preload([child.__name__, 'scipy.optimize'])


class Forked(_TEMPLATE.Process):
    """What a worker process needs of ``subprocess.Popen``."""

    def poll(self):
        return self.exitcode

    def wait(self):
        self.join()
        return self.exitcode


class HandedOn(WorkerProcess):
    """A worker process that a node leaves, idle and well, to the next one in this process."""

    idle: list[WorkerProcess] = []
    at_work: list[WorkerProcess] = []
    # The template is started by a thread that no node ends.
    _starter = ThreadPoolExecutor(1)

    @classmethod
    def take(cls):
        """A worker of another node, or else a new one."""
        cls.at_work.append(cls._idle() or cls._starter.submit(cls).result())
        return cls.at_work[-1]

    @classmethod
    def _idle(cls):
        while cls.idle:
            if (worker := cls.idle.pop()).alive:
                return worker
        return None

    def _start(self, connection):
        process = Forked(target=child.serve, args=(connection,), daemon=True)
        process.start()
        return process

    def solve(self, request):
        """Solve, also if the worker was halted while it had nothing to do."""
        if self.alive:
            os.kill(self._process.pid, signal.SIGCONT)
        return super().solve(request)

    def close(self):
        """Only a worker that has nothing to do is alive here: ``kill`` ends a solve."""
        self.at_work.remove(self)
        if self.alive:
            # It may have been halted before the solve got to it.
            with suppress(ProcessLookupError):
                os.kill(self._process.pid, signal.SIGCONT)
            self.idle.append(self)
        else:
            super().close()


def workers():
    """Process ids of the workers that nodes of this process have."""
    return [worker._process.pid for worker in HandedOn.at_work]


def halt_workers():
    """Let solves of minutes, which nobody waits for, take no processor time."""
    for pid in workers():
        os.kill(pid, signal.SIGSTOP)
