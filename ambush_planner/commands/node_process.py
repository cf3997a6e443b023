"""A planner node as a process of its own, in a ROS domain of its own."""

from __future__ import annotations

import fcntl
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import TextIO

# Fast DDS finds others in domain d on UDP port 7400 + 250 d. Above domain 101 these ports are ones
# that Linux gives to anybody; those up to 50 are left to people and tests.
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250
FIRST_UNICAST, PARTICIPANTS = 10, 8
DOMAINS = range(51, 102)
# The node promises to end within 2 s.
STOP_TIMEOUT = 10.0
LOG_LINES = 12


class NodeFailed(Exception):
    """The node did not start, did not last, or did not end as it should."""


@contextmanager
def free_domain() -> Iterator[int]:
    """A ROS domain id, at random, that nobody on this machine is in or has from this function.

    Raises
    ------
    NodeFailed
        All are taken.
    """
    for domain in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        # Whoever has just chosen a domain is not in it yet.
        if (lock := lock_domain(domain)) is None:
            continue
        with lock:
            if is_free(domain):
                yield domain
                return
    raise NodeFailed('no ROS domain id is free on this machine')


def lock_domain(domain: int) -> TextIO | None:
    """Lock a domain for as long as the file is open; None where somebody else has it."""
    with ExitStack() as unless_locked:
        try:
            path = Path(tempfile.gettempdir(), f'ambush_planner_domain_{domain}.lock')
            file = unless_locked.enter_context(path.open('w'))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return None
        unless_locked.pop_all()
        return file


def is_free(domain: int) -> bool:
    """Tell whether nobody on this machine listens where ROS domain ``domain`` meets.

    By the DDS rules a domain has one port for discovery by multicast and, a pair a participant,
    ports for discovery on this machine alone, where ``FIRST_UNICAST`` is the first.
    """
    base = FIRST_PORT + PORTS_PER_DOMAIN * domain
    participants = range(FIRST_UNICAST, FIRST_UNICAST + 2 * PARTICIPANTS, 2)
    return all(_can_bind(base + offset) for offset in (0, *participants))


def _can_bind(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
    return True


class NodeProcess:
    """Runs ``ambush_planner.ros.planner_node`` with the given parameters until the ``with`` ends.

    What the node prints goes to ``log``.

    Raises
    ------
    NodeFailed
        At the end, if the node did not exit with 0 on SIGINT. Errors in the ``with`` go first.
    """

    def __init__(self, parameters: Mapping[str, object], domain: int, log: Path) -> None:
        self._log = log
        self._arguments = ['--ros-args', '--log-level', 'warn']
        for name, value in parameters.items():
            # JSON is YAML, which ROS reads parameters as, with all quotes in place.
            self._arguments += ['-p', f'{name}:={json.dumps(value)}']
        # A crash in native code leaves a traceback in the log.
        extra = {'ROS_DOMAIN_ID': str(domain), 'PYTHONFAULTHANDLER': '1'}
        self._environment = {**os.environ, **extra}

    def __enter__(self) -> NodeProcess:
        with self._log.open('wb') as log:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'ambush_planner.ros.planner_node', *self._arguments],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                # Ctrl-C is for the caller, which then stops the node.
                start_new_session=True,
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        code = self._stop()
        if error is None and code != 0:
            raise NodeFailed(f'the node ended with exit code {code} on SIGINT{self._last_words()}')

    @property
    def pid(self) -> int:
        """The node's process id."""
        return self._process.pid

    def check(self) -> None:
        """Raise NodeFailed if the node has ended."""
        code = self._process.poll()
        if code is not None:
            raise NodeFailed(f'the node ended early, exit code {code}{self._last_words()}')

    def _stop(self) -> int:
        self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _last_words(self) -> str:
        lines = self._log.read_text(errors='replace').splitlines()[-LOG_LINES:]
        return '; its last words:\n' + '\n'.join(lines) if lines else ''
