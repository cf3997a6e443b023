# SPDX-License-Identifier: Apache-2.0
"""Worker processes that serve one node of a test after the other."""

import atexit
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from ambush_planner.worker.process import WorkerParent, WorkerProcess


class HandedOn(WorkerProcess):
    """A worker process that a node leaves, idle and well, to the next one in this process."""

    idle: list[WorkerProcess] = []
    at_work: list[WorkerProcess] = []
    # The workers' parent is started by a thread that no node ends.
    _parent, _starter = WorkerParent(), ThreadPoolExecutor(1)

    @classmethod
    def take(cls, _):
        """A worker of another node, or else a new one, which is not forked from the node's own."""
        cls.at_work.append(cls._idle() or cls._starter.submit(cls, cls._parent).result())
        return cls.at_work[-1]

    @classmethod
    def end(cls):
        """End all that is idle when this process ends."""
        for worker in cls.idle:
            WorkerProcess.close(worker)
        cls._parent.close()

    @classmethod
    def _idle(cls):
        while cls.idle:
            if (worker := cls.idle.pop()).alive:
                return worker
        return None

    def solve(self, *given):
        """Solve, also if the worker was halted while it had nothing to do."""
        signal_to(self, signal.SIGCONT)
        return super().solve(*given)

    def close(self):
        """Only a worker that has nothing to do is alive here: ``kill`` ends a solve."""
        self.at_work.remove(self)
        if self.alive:
            # It may have been halted before the solve got to it.
            signal_to(self, signal.SIGCONT)
            self.idle.append(self)
        else:
            super().close()


atexit.register(HandedOn.end)


def signal_to(worker, number):
    """Send a signal to a worker if it has started and not ended.

    By its descriptor: Linux gives -1 as the process id of one that has ended, which ``os.kill``
    takes for every process of the machine.
    """
    if worker._pidfd is not None:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(worker._pidfd, number)


def process_id(worker):
    """The process id of a worker that is running."""
    (line,) = [line for line in Path(f'/proc/self/fdinfo/{worker._pidfd}').read_text().splitlines()
               if line.startswith('Pid:')]
    assert (found := int(line.split()[1])) > 0, 'the worker has ended'
    return found


def signal_workers(number):
    """Send a signal to all workers that nodes of this process have."""
    for worker in HandedOn.at_work:
        signal_to(worker, number)


def halt_workers():
    """Let solves of minutes, which nobody waits for, take no processor time."""
    signal_workers(signal.SIGSTOP)
