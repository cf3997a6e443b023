"""What the worker process does: read a request, work the plan out, send it back, again.

Requests and plans travel as pickles of protocol 5, in which an array is its raw bytes and comes
out as it went in: read-only arrays stay read-only.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import socket
import sys
from contextlib import suppress
from io import BufferedRWPair
from pathlib import Path

from ..errors import AmbushPlannerError, TimeLimit
from ..planning.plan import Plan, PlanRequest
from ..planning.trip import plan_from_request
from .solve_errors import WorkerFailed, no_plan_in, unexpected

PICKLE_PROTOCOL = 5
READY = 'ready'
_PR_SET_PDEATHSIG = 1  # Linux' prctl.h
_NICENESS = 5
_FIRST_OUT_OF_MEMORY = '500'


def main() -> None:
    """Work on the socket whose descriptor is the first argument."""
    work_on(socket.socket(fileno=int(sys.argv[1])))


def work_on(connection: socket.socket) -> None:
    """Be a worker process until the socket is closed."""
    _lower_priority()
    # The other side may be gone at any time, also when the stream is flushed as it is closed; then
    # there is nobody left to work for.
    with (
        suppress(EOFError, ConnectionError),
        connection,
        connection.makefile('rwb') as stream,
    ):
        serve(stream)


def serve(stream: BufferedRWPair) -> None:
    """Answer one request after the other; raises EOFError when there are no more."""
    _send(READY, stream)
    while True:
        _send(_answer(pickle.load(stream)), stream)


def _answer(request: PlanRequest) -> Plan | AmbushPlannerError:
    try:
        return plan_from_request(request)
    except TimeLimit as late:
        if late.strategy is None:
            return no_plan_in(request.options.strategy.time_limit)
        return TimeLimit(str(late))  # what was reached is of no use, and large
    except AmbushPlannerError as error:
        return error
    except MemoryError:
        return WorkerFailed('not enough memory to plan; choose a larger network.spacing')
    except Exception as error:
        return unexpected(error)


def _send(answer: object, stream: BufferedRWPair) -> None:
    pickle.dump(answer, stream, PICKLE_PROTOCOL)
    stream.flush()


def _lower_priority() -> None:
    # The node's callbacks go first.
    os.nice(_NICENESS)
    if sys.platform == 'linux':
        # Whatever happens to the node, nobody is left behind, also in the middle of a solve.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        # When memory runs out, it is the solve that goes, and not the node.
        with suppress(OSError):
            Path('/proc/self/oom_score_adj').write_text(_FIRST_OUT_OF_MEMORY)


if __name__ == '__main__':
    main()
