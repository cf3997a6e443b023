# SPDX-License-Identifier: Apache-2.0
"""Worker processes, which read requests and send back their plans as pickles, and their parent.

Protocol 5 keeps read-only arrays read-only.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

from ..errors import AmbushPlannerError, TimeLimit
from ..planning.plan import Plan, PlanRequest
from ..planning.trip import Finished, plan_from_request
from .solve_errors import WorkerFailed, no_plan_in, unexpected

PICKLE_PROTOCOL = 5
_PR_SET_PDEATHSIG = 1  # from Linux' prctl.h
_OOM_SCORE = '500'  # the kernel kills the worker before the node when memory runs out
_NICE = 5  # of solves with low priority, which get a quarter of a core that others want


def main() -> None:
    """Fork a worker for each socket received over the descriptor in argv[1].

    This process has imported what a solve needs, so a worker starts in milliseconds.
    """
    _die_with_parent()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # leaves no zombies
    with socket.socket(fileno=int(sys.argv[1])) as requests:
        while True:
            _, descriptors, _, _ = socket.recv_fds(requests, 1, 1)
            if not descriptors:
                return  # the node has closed the socket
            with socket.socket(fileno=descriptors[0]) as connection, suppress(OSError):
                if os.fork() == 0:
                    requests.close()
                    return serve(connection)


def serve(connection: socket.socket) -> None:
    """Answer requests until the other side closes the socket, perhaps in the middle of one."""
    _die_with_parent()
    with suppress(OSError):  # not Linux
        Path('/proc/self/oom_score_adj').write_text(_OOM_SCORE)
    with suppress(EOFError, ConnectionError), connection.makefile('rwb') as stream:
        socket.send_fds(connection, [b'.'], [os.pidfd_open(os.getpid())])

        def send(answer: Plan | AmbushPlannerError) -> None:
            pickle.dump(answer, stream, PICKLE_PROTOCOL)
            stream.flush()

        def send_first(plan: Plan) -> None:
            send(plan)
            _lower_priority()

        while True:
            send(_answer(pickle.load(stream), send_first))


def _answer(request: PlanRequest, finished: Finished) -> Plan | AmbushPlannerError:
    try:
        return plan_from_request(request, finished)
    except TimeLimit as late:
        if late.strategy is None:
            return no_plan_in(request.options.strategy.time_limit)
        return TimeLimit(str(late))  # without the strategy, which is large
    except AmbushPlannerError as error:
        return error
    except MemoryError:
        return WorkerFailed('not enough memory to plan; choose a larger network.spacing')
    except Exception as error:
        return unexpected(error)


def _lower_priority() -> None:
    """Leave the processor to other processes, for good: only a privileged user can undo it."""
    os.nice(_NICE)
    os.setsid()  # Linux may schedule sessions, and nice values then count only within one
    with suppress(OSError):
        Path('/proc/self/autogroup').write_text(str(_NICE))


def _die_with_parent() -> None:
    """Ask Linux to kill this process when the thread that started it ends."""
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
