"""The worker process as its owner sees it: started, asked, killed."""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import TIMEOUT_MAX, Timer
from typing import Any

from ..errors import AmbushPlannerError
from ..planning.plan import Plan, PlanRequest
from .child import PICKLE_PROTOCOL
from .solve_errors import WorkerFailed, no_plan_in

# Importing numpy and scipy from a cold disk takes its time.
_START_LIMIT = 60.0
# What a solve may take over its time limit: it ends by itself, with what was reached by then.
_GRACE, _MARGIN = 1.2, 2.0  # of the limit, s
# The node is on the other cores; the solver's own code gains nothing from more threads.
_ONE_THREAD = {f'{name}_NUM_THREADS': '1' for name in ('OMP', 'OPENBLAS', 'MKL')}


class WorkerProcess:
    """A process that works plans out one after the other; dies with the thread that made it.

    ``solve`` belongs to one thread; ``kill`` may be called from any other.

    Raises
    ------
    OSError
        The process could not be started.
    """

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = self._start(theirs)
        self._socket = ours
        self._stream = ours.makefile('rwb')
        self._ready = self._killed = False

    def _start(self, connection: socket.socket) -> subprocess.Popen[bytes]:
        # The same modules as here, wherever this process has them from.
        start = (
            f'import sys; sys.path[:] = {sys.path!r}; '
            'from ambush_planner.worker.child import main; main()'
        )
        return subprocess.Popen(
            [sys.executable, '-c', start, str(connection.fileno())],
            pass_fds=[connection.fileno()],
            stdin=subprocess.DEVNULL,
            env={**_ONE_THREAD, **os.environ},
            # Ctrl-C in a terminal is for the node, which then ends this process.
            start_new_session=True,
        )

    @property
    def alive(self) -> bool:
        """Whether the process runs and is wanted to."""
        return not self._killed and self._process.poll() is None

    def solve(self, request: PlanRequest) -> Plan:
        """Have a plan worked out, in little more than the strategy's ``time_limit``.

        Raises
        ------
        TimeLimit
            The time passed; where the solve did not end by itself, the process has been killed.
        WorkerFailed
            The process died, or met an error that is not the planner's own.
        AmbushPlannerError
            As ``plan_from_request`` raises them.
        """
        limit = request.options.strategy.time_limit
        late = no_plan_in(limit)
        if not self._ready:
            slow = WorkerFailed(f'the worker process did not start in {_START_LIMIT:g} s')
            with self._killed_after(_START_LIMIT, slow):
                pickle.load(self._stream)
            self._ready = True
        with self._killed_after(_GRACE * limit + _MARGIN, late):
            pickle.dump(request, self._stream, PICKLE_PROTOCOL)
            self._stream.flush()
            answer: Any = pickle.load(self._stream)
        if isinstance(answer, AmbushPlannerError):
            raise answer
        return answer

    def kill(self) -> None:
        """End the process at once; a ``solve`` that is waiting raises WorkerFailed."""
        self._killed = True
        self._process.kill()

    def close(self) -> None:
        """End the process, and wait until nothing is left of it."""
        self.kill()
        self._process.wait()
        with suppress(OSError):  # what was not sent yet is lost with it
            self._stream.close()
        self._socket.close()

    @contextmanager
    def _killed_after(self, seconds: float, late: AmbushPlannerError) -> Iterator[None]:
        """Kill the process if the exchange takes longer, wherever it hangs, and raise ``late``."""
        expired = False

        def expire() -> None:
            nonlocal expired
            expired = True
            self.kill()

        timer = Timer(min(seconds, TIMEOUT_MAX), expire)
        timer.start()
        try:
            yield
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            raise (late if expired else WorkerFailed(self._last_words())) from error
        finally:
            timer.cancel()
            timer.join()  # or one that expires just now would kill the next solve's process

    def _last_words(self) -> str:
        code = self._process.wait()
        how = f'by signal {-code}' if code < 0 else f'with exit code {code}'
        return (
            f'the worker process ended {how}; a new one is started. If memory ran out, choose a '
            'larger network.spacing'
        )
