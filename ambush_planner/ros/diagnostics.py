# SPDX-License-Identifier: Apache-2.0
"""The node's status as a diagnostics message: stable keys, and never a route or a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from ..planning.changed_ground import Assessment
from ..planning.concerns import concerns, plan_numbers
from ..planning.plan import Plan
from ..worker.solve_errors import SolveCancelled
from .departure_record import Departure
from .error_codes import OK_CODE, code_of


class Problem(NamedTuple):
    """An error: its code (``error_codes.code_of``), a message, and the level."""

    code: str
    message: str
    level: bytes


@dataclass(frozen=True)
class Status:
    """The node's status.

    ``problems`` are by what they concern: 'request', 'map' or 'recording'; ``warnings`` are texts
    on 'parameters' or 'alpha_map'. ``assessment`` is of the displayed plan on the current map, and
    ``stale`` says why that plan is stale, if it is. The ``last_answer`` to a request may have been
    the rest of the path of the ``last`` departure.
    """

    lifecycle: str = 'active'
    missing: tuple[str, ...] = ()
    solving: bool = False
    refining: bool = False
    problems: Mapping[str, Problem] = field(default_factory=dict)
    warnings: Mapping[str, str] = field(default_factory=dict)
    plan: Plan | None = None
    assessment: Assessment | None = None
    stale: str = ''
    last: Departure | None = None
    last_answer: str = ''
    recording: str = 'off'

    @property
    def state(self) -> str:
        """'solving', 'waiting' (for inputs) or 'ready'; if not active, the lifecycle state."""
        if self.lifecycle != 'active':
            return self.lifecycle
        if self.solving:
            return 'solving'
        return 'waiting' if self.missing else 'ready'

    def with_problem(self, concern: str, error: Exception) -> Status:
        """Return the status with ``error`` as the problem of ``concern``."""
        # A solve that was cancelled on request has not failed.
        cancelled = isinstance(error, SolveCancelled)
        level = DiagnosticStatus.WARN if cancelled else DiagnosticStatus.ERROR
        problem = Problem(code_of(error), str(error) or type(error).__name__, level)
        return replace(self, problems={**self.problems, concern: problem})

    def without_problem(self, concern: str) -> Status:
        """Return the status without a problem of ``concern``."""
        rest = {key: value for key, value in self.problems.items() if key != concern}
        return replace(self, problems=rest)


def status_to_ros(status: Status, name: str, stamp: Time) -> DiagnosticArray:
    """Return the status as the node called ``name`` publishes it on /diagnostics."""
    level, code, message = _summary(status)
    now, last = status.assessment, status.last
    values = {
        'state': status.state,
        'code': code,
        'message': message,
        'refining': 'yes' if status.refining else 'no',
        **plan_numbers(status.plan),
        'current_value': f'{now.value:.9g}' if now else '',
        'current_gap': f'{now.gap:.9g}' if now else '',
        'current_length': f'{now.expected_length:.9g}' if now else '',
        'stale': ('yes' if status.stale else 'no') if now else '',
        'departures': str(last.number) if last else '0',
        'departure_id': last.id if last else '',
        'departure_value': f'{last.worth.value:.9g}' if last else '',
        'departure_gap': f'{last.worth.gap:.9g}' if last else '',
        'last_answer': status.last_answer,
        'tight_turns': str(last.tight_turns) if last else '0',
        'recording': status.recording,
    }
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    entry = DiagnosticStatus(level=level, name=f'{name}: planning', hardware_id=name,
                             message=message, values=pairs)
    return DiagnosticArray(header=Header(stamp=stamp), status=[entry])


def _summary(status: Status) -> tuple[bytes, str, str]:
    """Return (level, code, message): all problems first, that of the last request before others."""
    concerns = ('request', 'map', 'recording')
    problems = [status.problems[each] for each in concerns if each in status.problems]
    texts = [problem.message for problem in problems]
    levels = [problem.level for problem in problems]
    if warnings := _warnings(status):
        levels.append(DiagnosticStatus.WARN)
        waits = status.lifecycle == 'active' and not status.missing
        texts += [*([status.state] if waits and not texts else []), *warnings]
    return (max(levels, default=DiagnosticStatus.OK), problems[0].code if problems else OK_CODE,
            '; '.join(dict.fromkeys(texts)) or status.state)


def _warnings(status: Status) -> list[str]:
    """Return everything that is worth a warning; about plans only while the node is active."""
    found = list(status.warnings.values())
    if status.lifecycle == 'active':
        waiting = f'waiting for {", ".join(status.missing)}' if status.missing else ''
        length = status.assessment.concern if status.assessment else ''
        found = [waiting, *found, status.stale, length, *_departure_warnings(status.last),
                 *(concerns(status.plan) if status.plan else ())]
    return [text for text in found if text]


def _departure_warnings(last: Departure | None) -> list[str]:
    """Return what is worse about the last departure than about its plan."""
    found: list[str] = []
    if last is None:
        return found
    planned, turns = last.held.plan.strategy.value, last.tight_turns
    if last.worth.value > planned * (1.0 + last.parameters.planning.max_gap):
        found.append(f'the last departure has a value of {last.worth.value:.4g}, its plan had '
                     f'{planned:.4g} when it was solved (strategy.max_gap)')
    if turns:
        are = '1 turn of the last path is' if turns == 1 else f'{turns} turns of the last path are'
        found.append(f'{are} tighter than route.turning_radius, for lack of room; increase '
                     'network.clearance or network.spacing')
    return found
