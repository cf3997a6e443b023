# SPDX-License-Identifier: Apache-2.0
"""The node's status, published on /diagnostics: stable keys, and never a route or a seed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from threading import RLock
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from ..planning.changed_ground import Assessment
from ..planning.concerns import concerns, plan_numbers
from ..planning.plan import Plan
from .departure_record import Departure
from .errors import OK_CODE, code_of
from .gate import ACTIVE
from .topics import Publishers

# Time for which a failed request is reported unless one succeeds [s].
_ERROR_HOLD = 30.0
# What errors concern, the most important first.
_ERRORS = ('request', 'alpha_map', 'costmap', 'join', 'recording')


class Problem(NamedTuple):
    """A problem: the code of its error, '' if it is a warning, and a message."""

    code: str
    message: str

    @classmethod
    def of(cls, wrong: Exception | str) -> Problem:
        """Return the problem that an error or a warning is."""
        if isinstance(wrong, str):
            return cls('', wrong)
        return cls(code_of(wrong), str(wrong) or type(wrong).__name__)

    @property
    def level(self) -> bytes:
        """The level of a status; a solve that was cancelled on request has not failed."""
        return DiagnosticStatus.WARN if self.code in ('', 'CANCELLED') else DiagnosticStatus.ERROR


@dataclass(frozen=True)
class Status:
    """The node's status.

    ``problems`` are by what they concern: errors of a 'request', of a map ('alpha_map', 'costmap'),
    of the 'join' of both or of a 'recording'; warnings of a topic's 'qos', of updates of a
    map that were lost ('alpha_map_updates', 'costmap_updates'), of a costmap that has 'stopped', of
    a map without 'risk' and of a 'disk'. ``assessment`` is of the displayed plan
    on the current map, and ``stale`` says why that plan is stale, if it is. The
    ``last_answer`` to a request may have been the rest of the path of the ``last`` departure.
    ``records``: whether departures are recorded.
    """

    lifecycle: str = ACTIVE
    missing: tuple[str, ...] = ()
    solving: bool = False
    refining: bool = False
    problems: Mapping[str, Problem] = field(default_factory=dict)
    plan: Plan | None = None
    assessment: Assessment | None = None
    stale: str = ''
    last: Departure | None = None
    last_answer: str = ''
    records: bool = False

    @property
    def state(self) -> str:
        """'solving', 'waiting' (for inputs) or 'ready'; if not active, the lifecycle state."""
        if self.lifecycle != ACTIVE:
            return self.lifecycle
        if self.solving:
            return 'solving'
        return 'waiting' if self.missing else 'ready'

    @property
    def recording_state(self) -> str:
        """'on' or 'off'; 'failed' if the last one did."""
        if not self.records:
            return 'off'
        return 'failed' if 'recording' in self.problems else 'on'

    def noting(self, concern: str, wrong: Exception | str | None) -> Status:
        """Return the status with an error or a warning as the problem of ``concern``, or none."""
        others = {key: value for key, value in self.problems.items() if key != concern}
        return replace(self, problems={**others, concern: Problem.of(wrong)} if wrong else others)


class Reporter:
    """Keeps the status of the node called ``name``, and publishes it on change; thread-safe.

    ``present`` returns the fields of the status that it looks up each time: the lifecycle state,
    what is missing, and whether a solve or a refinement runs or waits. A request's error is
    reported for ``_ERROR_HOLD``, everything else as long as it lasts.
    """

    def __init__(self, name: str, publishers: Publishers,
                 present: Callable[[], Mapping[str, Any]]) -> None:
        self._name, self._publishers = name, publishers
        self._present = present
        self._failed_at = 0.0
        self._status = Status()
        self._lock = RLock()  # also while publishing, which keeps the reports in order

    def report(self) -> None:
        """Publish the present status."""
        with self._lock:
            if time.monotonic() - self._failed_at > _ERROR_HOLD:
                self._status = self._status.noting('request', None)
            self._status = replace(self._status, **self._present())
            message = status_to_ros(self._status, self._name, self._publishers.clock.now().to_msg())
            self._publishers.publish('/diagnostics', message)

    def set(self, **fields: Any) -> None:
        """Set fields of the status; publish it if they or those looked up have changed."""
        self._change(lambda status: replace(status, **fields))

    def forget(self) -> None:
        """Clear everything except whether departures are recorded."""
        self._change(lambda status: Status(records=status.records))

    def note(self, concern: str, wrong: Exception | str | None) -> None:
        """Set the error or warning of a concern of ``Status.problems``; None and '' clear it."""
        with self._lock:
            if wrong and concern == 'request':
                self._failed_at = time.monotonic()
            self._change(lambda status: status.noting(concern, wrong))

    def prepare(self, departure: Departure) -> Departure:
        """Return a departure that is about to leave, with its report and what this remarks.

        The report is not published. With ``recording.required`` it says that the recording is done.
        """
        with self._lock:
            status = self._left(departure)
            if departure.trip.parameters.recording.required:
                status = status.noting('recording', None)
            message = status_to_ros(status, self._name, self._publishers.clock.now().to_msg())
            report = self._publishers.as_recorded('/diagnostics', message)
        trouble = status.problems.get('recording')
        remarks = '; '.join(filter(None, (departure.remarks, trouble and trouble.message)))
        return replace(departure, report=report, remarks=remarks)

    def publish(self, departure: Departure) -> None:
        """Publish the report of a departure that leaves, made by ``prepare``."""
        assert departure.report is not None
        with self._lock:
            self._status = self._left(departure)
            self._publishers.publish('/diagnostics', departure.report.data)

    def _left(self, departure: Departure) -> Status:
        return replace(self._status.noting('request', None), last=departure,
                       last_answer='diverted' if departure.diversion else 'new')

    def _change(self, change: Callable[[Status], Status]) -> None:
        """Change the status, and publish it if it differs."""
        with self._lock:
            before = self._status
            self._status = replace(change(before), **self._present())
            if self._status != before:
                self.report()


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
        'departure_value': f'{last.assessment.value:.9g}' if last else '',
        'departure_gap': f'{last.assessment.gap:.9g}' if last else '',
        'last_answer': status.last_answer,
        'tight_turns': str(last.tight_turns) if last else '0',
        'recording': status.recording_state,
    }
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    entry = DiagnosticStatus(level=level, name=f'{name}: planning', hardware_id=name,
                             message=message, values=pairs)
    return DiagnosticArray(header=Header(stamp=stamp), status=[entry])


def _summary(status: Status) -> tuple[bytes, str, str]:
    """Return (level, code, message): errors first, that of the last request before others."""
    found = [status.problems[each] for each in _ERRORS if each in status.problems]
    code = found[0].code if found else OK_CODE
    if warnings := _warnings(status):
        ready = status.lifecycle == ACTIVE and not status.missing and not found
        found += map(Problem.of, [*([status.state] if ready else []), *warnings])
    return (max((each.level for each in found), default=DiagnosticStatus.OK), code,
            '; '.join(dict.fromkeys(each.message for each in found)) or status.state)


def _warnings(status: Status) -> list[str]:
    """Return everything that is worth a warning; about plans only while the node is active."""
    found = [each.message for each in status.problems.values() if not each.code]
    if status.lifecycle == ACTIVE:
        waiting = f'waiting for {", ".join(status.missing)}' if status.missing else ''
        length = status.assessment.concern if status.assessment else ''
        found = [waiting, *found, status.stale, length, *_departure_warnings(status.last),
                 *(concerns(status.plan) if status.plan else ())]
    return [text for text in found if text]


def _departure_warnings(last: Departure | None) -> list[str]:
    """Return what is worse about the last departure than about its plan."""
    if last is None:
        return []
    planned, turns, found = last.held.plan.value, last.tight_turns, []
    if last.assessment.value > planned * (1.0 + last.trip.parameters.planning.max_gap):
        found.append(f'the last departure has a value of {last.assessment.value:.4g}, its plan had '
                     f'{planned:.4g} when it was solved (strategy.max_gap)')
    if turns:
        are = '1 turn of the last path is' if turns == 1 else f'{turns} turns of the last path are'
        found.append(f'{are} tighter than route.turning_radius, for lack of room; increase '
                     'network.clearance or network.spacing')
    return found
