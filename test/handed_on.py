# SPDX-License-Identifier: Apache-2.0
"""Worker processes that serve one node of a test after the other."""

import os
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
    def _idle(cls):
        while cls.idle:
            if (worker := cls.idle.pop()).alive:
                return worker
        return None

    def solve(self, *given):
        """Solve, also if the worker was halted while it had nothing to do."""
        self._continue()
        return super().solve(*given)

    def close(self):
        """Only a worker that has nothing to do is alive here: ``kill`` ends a solve."""
        self.at_work.remove(self)
        if self.alive:
            # It may have been halted before the solve got to it.
            self._continue()
            self.idle.append(self)
        else:
            super().close()

    def _continue(self):
        if self.alive and self._pidfd is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGCONT)


def process_id(worker):
    """The process id of a worker that has started."""
    (line,) = [line for line in Path(f'/proc/self/fdinfo/{worker._pidfd}').read_text().splitlines()
               if line.startswith('Pid:')]
    return int(line.split()[1])


def workers():
    """Process ids of the workers that nodes of this process have."""
    return [process_id(worker) for worker in HandedOn.at_work if worker._pidfd is not None]


def halt_workers():
    """Let solves of minutes, which nobody waits for, take no processor time."""
    for pid in workers():
        os.kill(pid, signal.SIGSTOP)
