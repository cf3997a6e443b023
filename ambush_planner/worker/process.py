# SPDX-License-Identifier: Apache-2.0
"""The owner's side of worker processes: start them, have them solve, kill them."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait
from select import POLLHUP, poll
from threading import Lock

from ..errors import AmbushPlannerError
from ..planning.plan import Plan, PlanRequest
from .child import PICKLE_PROTOCOL
from .solve_errors import WorkerFailed, no_plan_in

# Grace period before killing a solve that overran its limit: a factor, and seconds to add.
_GRACE, _MARGIN = 1.2, 2.0
_LONGEST = 2e6  # time-out that a socket takes [s]
# The worker uses one thread; the solver gains nothing from more, and the node needs the cores.
_ONE_THREAD = {f'{name}_NUM_THREADS': '1' for name in ('OMP', 'OPENBLAS', 'MKL')}
_KILLED = ('the worker process was killed; a new one is started. If memory ran out, choose a '
           'larger network.spacing')
_NOT_STARTED = ('the worker process could not be started; check the limits of processes and of '
                'memory of this user (ulimit -u, -v)')


class WorkerParent:
    """The process that workers are forked from; it is started when it is first needed.

    It and its workers die with the thread that started it.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def fork(self, connection: socket.socket) -> None:
        """Have a worker serve a socket; raises OSError if that is impossible."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = self._started()
        socket.send_fds(self._requests, [b'.'], [connection.fileno()])

    def close(self) -> None:
        """End the process and its workers."""
        if self._process is not None:
            self._requests.close()
            self._process.kill()
            self._process.wait()
            self._process = None

    def _started(self) -> subprocess.Popen[bytes]:
        self._requests, theirs = socket.socketpair()
        # It imports the same modules as this process.
        start = (f'import sys; sys.path[:] = {sys.path!r}; '
                 'from ambush_planner.worker.child import main; main()')
        with theirs, _blocked(signal.SIGINT, signal.SIGTERM):
            return subprocess.Popen(
                [sys.executable, '-c', start, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **_ONE_THREAD},
                start_new_session=True,  # Ctrl-C reaches only the node, which then ends the worker
            )


@contextmanager
def _blocked(*numbers: signal.Signals) -> Iterator[None]:
    """Block signals in this thread and in the processes that it starts.

    A service manager signals every process of a service; the node then ends its workers itself.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WorkerProcess:
    """A process that solves one request at a time.

    Call ``solve`` from one thread only; ``kill`` is safe from any. Raises OSError if the process
    cannot be started.
    """

    def __init__(self, parent: WorkerParent) -> None:
        self._parent = parent
        self._socket, theirs = socket.socketpair()
        with theirs:
            parent.fork(theirs)
        self._stream = self._socket.makefile('rwb')
        self._lock = Lock()
        self._pidfd: int | None = None  # known when the process has started

    @property
    def alive(self) -> bool:
        """Return whether the process is starting or running, and has not been killed."""
        ends = poll()
        ends.register(self._socket, POLLHUP)
        return not ends.poll(0)

    def solve(self, request: PlanRequest) -> Plan:
        """Return the plan that is wanted first, in little more than the strategy's ``time_limit``.

        If that is not the last one of the request, ``next_plan`` has to be called.

        Raises the errors of ``plan_from_request``; TimeLimit if the solve overran its limit and was
        killed; WorkerFailed if the process died.
        """
        if self._pidfd is None:
            self._begin()
        return self._received(request, sends=True)

    def next_plan(self, request: PlanRequest) -> Plan:
        """Return the plan of the request's options after its first one; raises as ``solve`` does.

        It is solved with low priority, which a process cannot leave: it is killed.
        """
        try:
            return self._received(request, sends=False)
        finally:
            self.kill()

    def _received(self, request: PlanRequest, sends: bool) -> Plan:
        """Return the next plan of a request, which this ``sends`` before."""
        limit = request.options.strategy.time_limit
        self._socket.settimeout(min(_GRACE * limit + _MARGIN, _LONGEST))
        try:
            if sends:
                pickle.dump(request, self._stream, PICKLE_PROTOCOL)
                self._stream.flush()
            answer: Plan | AmbushPlannerError = pickle.load(self._stream)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            self.kill()
            late = isinstance(error, TimeoutError)
            raise (no_plan_in(limit) if late else WorkerFailed(_KILLED)) from error
        if isinstance(answer, AmbushPlannerError):
            raise answer
        return answer

    def _begin(self) -> None:
        """Wait until the process has started; the parent of one that does not is replaced."""
        descriptors: list[int] = []
        with suppress(OSError):
            descriptors = socket.recv_fds(self._socket, 1, 1)[1]
        if not descriptors:
            self.kill()
            self._parent.close()
            raise WorkerFailed(_NOT_STARTED)
        self._pidfd = descriptors[0]

    def kill(self) -> None:
        """Kill the process; a waiting ``solve`` raises WorkerFailed."""
        with self._lock, suppress(OSError):  # it has ended
            if self._pidfd is not None:
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Kill the process and wait for its end."""
        self.kill()
        with suppress(OSError):  # from flushing unsent bytes
            self._stream.close()
        self._socket.close()
        with self._lock:
            if self._pidfd is not None:
                wait([self._pidfd])
                os.close(self._pidfd)
                self._pidfd = None
