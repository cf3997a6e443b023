"""The owner's side of the worker process: start it, have it solve, kill it."""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import TIMEOUT_MAX, Timer

from ..errors import AmbushPlannerError
from ..planning.plan import Plan, PlanRequest
from .child import PICKLE_PROTOCOL
from .solve_errors import WorkerFailed, no_plan_in

# Time limit for the worker's start [s]; imports from a cold disk are slow.
_START_LIMIT = 60.0
# Grace period before killing a solve that overran its limit: a factor, and seconds to add.
_GRACE, _MARGIN = 1.2, 2.0
# The worker uses one thread; the solver gains nothing from more, and the node needs the cores.
_ONE_THREAD = {f'{name}_NUM_THREADS': '1' for name in ('OMP', 'OPENBLAS', 'MKL')}


class WorkerProcess:
    """A process that solves one request at a time; it dies with the thread that made it.

    Call ``solve`` from one thread only; ``kill`` is safe from any. Raises OSError if the process
    cannot be started.
    """

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = self._start(theirs)
        self._socket = ours
        self._stream = ours.makefile('rwb')
        self._ready = self._killed = False

    def _start(self, connection: socket.socket) -> subprocess.Popen[bytes]:
        # The worker imports the same modules as this process.
        start = (f'import sys; sys.path[:] = {sys.path!r}; '
                 'from ambush_planner.worker.child import main; main()')
        return subprocess.Popen(
            [sys.executable, '-c', start, str(connection.fileno())],
            pass_fds=[connection.fileno()],
            stdin=subprocess.DEVNULL,
            env={**_ONE_THREAD, **os.environ},
            start_new_session=True,  # Ctrl-C reaches only the node, which then ends the worker
        )

    @property
    def alive(self) -> bool:
        """Whether the process runs and was not killed."""
        return not self._killed and self._process.poll() is None

    def solve(self, request: PlanRequest) -> Plan:
        """Solve a request, in little more than the strategy's ``time_limit``.

        Raises the errors of ``plan_from_request``; TimeLimit if the solve overran its limit and was
        killed; WorkerFailed if the process died.
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
            answer: Plan | AmbushPlannerError = pickle.load(self._stream)
        if isinstance(answer, AmbushPlannerError):
            raise answer
        return answer

    def kill(self) -> None:
        """Kill the process; a waiting ``solve`` raises WorkerFailed."""
        self._killed = True
        self._process.kill()

    def close(self) -> None:
        """Kill the process and wait for its end."""
        self.kill()
        self._process.wait()
        with suppress(OSError):  # from flushing unsent bytes
            self._stream.close()
        self._socket.close()

    @contextmanager
    def _killed_after(self, seconds: float, late: AmbushPlannerError) -> Iterator[None]:
        """Kill the process and raise ``late`` if the exchange takes longer than ``seconds``."""
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
            timer.join()  # an expiring timer must not kill the next solve

    def _last_words(self) -> str:
        code = self._process.wait()
        how = f'by signal {-code}' if code < 0 else f'with exit code {code}'
        return (
            f'the worker process ended {how}; a new one is started. If memory ran out, choose a '
            'larger network.spacing'
        )
