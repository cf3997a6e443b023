# SPDX-License-Identifier: Apache-2.0
"""A planner node in its own process and its own ROS domain."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ambush_planner.errors import AmbushPlannerError

# By the DDS rules, the first participant of domain d listens at the UDP port 7410 + 250 d.
FIRST_PORT, PORTS_PER_DOMAIN = 7410, 250
# Ports of domains above 101 are ephemeral on Linux; domains up to 50 are left to people and tests.
DOMAINS = range(51, 102)
STOP_TIMEOUT = 10.0  # [s]; the node promises to exit within 2 s
LOG_LINES = 12


class NodeFailed(AmbushPlannerError):
    """The node did not start, ended early, or did not exit with 0."""


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a random ROS domain that nobody on this machine uses; raises NodeFailed if none."""
    for domain in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        if (lock := lock_domain(domain)) is not None:
            with lock:
                if is_free(domain):
                    yield domain
                    return
    raise NodeFailed('no ROS domain id is free on this machine')


def lock_domain(domain: int) -> socket.socket | None:
    """Lock a domain until the returned socket is closed; None if another process has locked it."""
    lock = socket.socket(socket.AF_UNIX)
    try:
        lock.bind(f'\0ambush_planner_domain_{domain}')  # an abstract name of Linux, without a file
    except OSError:
        lock.close()
        return None
    return lock


def is_free(domain: int) -> bool:
    """Return whether the port of the domain's first participant is unused on this machine."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(('', FIRST_PORT + PORTS_PER_DOMAIN * domain))
    except OSError:
        return False
    return True


class NodeProcess:
    """Run the planner node until the ``with`` block ends, with its output in the file ``log``.

    The end of the block raises NodeFailed if the node does not exit with 0 on SIGINT.
    """

    def __init__(self, parameters: Mapping[str, object], domain: int, log: Path) -> None:
        self._log = log
        self._arguments = ['--ros-args', '--log-level', 'warn']
        for name, value in parameters.items():
            self._arguments += ['-p', f'{name}:={json.dumps(value)}']  # JSON is valid YAML
        self._environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}

    def __enter__(self) -> NodeProcess:
        with self._log.open('wb') as log:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'ambush_planner.ros.program', *self._arguments],
                env=self._environment, stdin=subprocess.DEVNULL, stdout=log,
                stderr=subprocess.STDOUT,
                # Ctrl-C goes to the caller only, which then stops the node.
                start_new_session=True,
            )
        self.pid = self._process.pid
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._process.send_signal(signal.SIGINT)
        try:
            code = self._process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if kind is None and code != 0:
            raise NodeFailed(f'the node exited with {code} on SIGINT{self._last_words()}')

    def check(self) -> None:
        """Raise NodeFailed if the node has ended."""
        code = self._process.poll()
        if code is not None:
            raise NodeFailed(f'the node ended early with exit code {code}{self._last_words()}')

    def _last_words(self) -> str:
        lines = self._log.read_text(errors='replace').splitlines()[-LOG_LINES:]
        return '; its last lines:\n' + '\n'.join(lines) if lines else ''
