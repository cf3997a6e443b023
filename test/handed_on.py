"""Worker processes that serve one node of a test after the other."""

from concurrent.futures import ThreadPoolExecutor

from ambush_planner.worker.process import WorkerProcess


class HandedOn(WorkerProcess):
    """A worker process that a node leaves, idle and well, to the next one in this process.

    To start one takes as long as most tests: it imports numpy and scipy.
    """

    idle: list[WorkerProcess] = []
    # A worker dies with the thread that started it, so with none that belongs to a node.
    _starter = ThreadPoolExecutor(1)

    @classmethod
    def take(cls):
        """A worker of another node, or else a new one."""
        while cls.idle:
            if (worker := cls.idle.pop()).alive:
                return worker
        return cls._starter.submit(cls).result()

    def close(self):
        """Only a worker that has nothing to do is alive here: ``kill`` ends a solve."""
        if self.alive:
            self.idle.append(self)
        else:
            super().close()
