"""Checks a recorded departure: planned and drawn again from what was recorded, is it the same?

Each check leans on the one before: the stated hashes hold for what was recorded; the trip follows
from the recorded poses; the map, the trip and the parameters give the recorded network and
strategy; the recorded strategy and the source of randomness give the recorded route; and all that
was published follows from these. It shows that a recording is consistent with itself and with the
planner, not who made it: a recording that was made anew as a whole, say from another seed with
the route and the path that follow from it, is as consistent as the first. Nor does it show that
times are right, but only their order: the request first, then the path, the answer last. Nor can
it show a change of what has no effect on the departure: of cells far from every node, of
``max_planning_time``, of quality-of-service profiles, of the stamps of markers and inputs, of the
versions that are noted. In the diagnostics, the state, the level beyond whether it is an error,
what the node was called and problems of its surroundings (also where the answer repeats them) are
not checked, nor topics that were remapped; nor, of a goal pose in another frame than the map's,
its orientation and height.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..core.errors import AmbushPlannerError
from ..core.planner import PlanningOptions, PlanRequest
from ..core.strategy import Strategy
from ..recording.departure import RecordedDeparture
from ..recording.errors import UnreadableRecording
from ..recording.reader import read_departure
from ..recording.strategy_file import STRATEGY_FILE
from ..ros.conversions import occupancy_from_ros
from ..ros.departure_record import planner_version, software_versions
from .departures import DepartureRecord, record_from, strategy_from
from .verify_file import file_faults
from .verify_messages import (
    marker_faults,
    message_faults,
    path_faults,
    service_faults,
    status_faults,
)
from .verify_plan import PlannedAgain
from .verify_strategy import (
    certificate_faults,
    route_faults,
    source_faults,
    strategy_faults,
)
from .verify_times import time_faults
from .verify_trip import PosedTrip, metadata_faults, posed_trip

# There and back again, as the node keeps plans.
_KEPT = 4


@dataclass(frozen=True)
class Verdict:
    """What was found about one recorded departure.

    Attributes:
        path: The file.
        number: Which departure of its session it is; 0 if that could not be read.
        summary: The same in words, with its strategy; empty if it could not be read.
        problems: What does not hold; each begins with the part of the recording that it is about.
        notes: What could not be checked, and how the computers differ.
    """

    path: Path
    number: int
    summary: str
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether all that was checked holds."""
        return not self.problems


class Verifier:
    """Verifies departures one after the other; those of one strategy take one solve.

    Args:
        planning: Called with a file before it is planned again, which may take long.
    """

    def __init__(self, planning: Callable[[Path], None] = lambda path: None) -> None:
        self._planning = planning
        self._kept = {kind: _Cache() for kind in ('strategy', 'plan', 'comparison', 'markers')}
        self._seen: dict[str, tuple[Path, Any]] = {}

    def verify(self, path: Path) -> Verdict:
        """Verify one file; never raises for what is in it."""
        check = _Check(path)
        try:
            self._check(check)
        except UnreadableRecording as error:
            check.problems.append(error.reason)
        except AmbushPlannerError as error:
            check.problems.append(str(error))
        except (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError,
                ValueError) as error:
            # A forger can put numbers of any type and size where they stop a computation. The
            # error's own words are left out: they may hold what belongs into no log.
            check.problems.append(f'it cannot be computed again ({type(error).__name__})')
        return check.verdict()

    def _check(self, check: _Check) -> None:
        recorded = read_departure(check.path)
        record = record_from(recorded)
        check.number, check.summary = record.number, f'departure {record.number}'
        check.problems += file_faults(check.path)
        check.problems += metadata_faults(recorded, record)
        check.problems += self._copy_faults(record)
        check.problems += message_faults(recorded)
        check.problems += service_faults(recorded, record)
        check.problems += time_faults(recorded)
        strategy = self._strategy(recorded, record)
        check.summary += f', {len(strategy.network.points)} nodes, value {strategy.value:.6g}'
        check.problems += self._marker_faults(recorded, record, strategy)
        check.problems += source_faults(record)
        certificate = certificate_faults(strategy, record.parameters.planning.strategy)
        check.problems += certificate or route_faults(record, strategy)
        trip = posed_trip(recorded, record)
        check.problems += trip.faults
        check.notes += [*trip.notes, *_version_notes(record)]
        self._check_plan(check, recorded, record, strategy, trip)

    def _check_plan(
        self,
        check: _Check,
        recorded: RecordedDeparture,
        record: DepartureRecord,
        strategy: Strategy,
        trip: PosedTrip,
    ) -> None:
        """Plan again, and compare; the rest cannot be checked where that fails.

        The game is solved only on the network that was recorded.
        """
        key = _plan_key(record, trip)
        try:
            again = self._kept['plan'].get(key, lambda: self._plan(recorded, record, trip))
            if again.goal_xy != record.trip.goal_xy:
                check.problems.append(
                    'trip: its goal is not where the goal pose and the tolerance lead to'
                )
            check.problems += path_faults(recorded, record, strategy, again.spacing, trip)
            if faults := again.network_faults(strategy.network):
                check.problems += faults
                return
            plan = again.plan
        except AmbushPlannerError as error:
            check.problems.append(f'map, trip and parameters cannot be planned with: {error}')
            return
        faults, notes = self._kept['comparison'].get(
            (key, _strategy_key(record)),
            lambda: strategy_faults(recorded.attachment(STRATEGY_FILE), strategy, plan.strategy),
        )
        check.problems += [*faults, *status_faults(recorded, record, plan)]
        check.notes += notes

    def _plan(
        self, recorded: RecordedDeparture, record: DepartureRecord, trip: PosedTrip
    ) -> PlannedAgain:
        self._planning(recorded.path)
        return PlannedAgain(PlanRequest(
            *occupancy_from_ros(recorded.message('map')),
            record.parameters.occupancy,
            trip.start_xy,
            trip.goal_xy,
            record.trip.tolerance,
            _options(record),
        ))

    def _strategy(self, recorded: RecordedDeparture, record: DepartureRecord) -> Strategy:
        return self._kept['strategy'].get(
            _strategy_key(record), lambda: strategy_from(recorded, record)
        )

    def _marker_faults(
        self, recorded: RecordedDeparture, record: DepartureRecord, strategy: Strategy
    ) -> list[str]:
        """Markers are made once for a strategy: the same bytes stand in each of its departures."""
        data = tuple(
            (each.topic, each.data) for each in recorded.messages
            if each.type.endswith('/MarkerArray')
        )
        return self._kept['markers'].get(
            (_strategy_key(record), record.frame, data),
            lambda: marker_faults(recorded, record.frame, strategy),
        )

    def _copy_faults(self, record: DepartureRecord) -> list[str]:
        path, hashes = self._seen.setdefault(record.id, (record.path, record.sha256))
        if hashes == record.sha256:
            return []
        return [f'departure_id: it is also that of {path.name}, which holds something else']


class _Check:
    """What is being found out about one file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number, self.summary = 0, ''
        self.problems: list[str] = []
        self.notes: list[str] = []

    def verdict(self) -> Verdict:
        return Verdict(
            self.path, self.number, self.summary, tuple(self.problems), tuple(self.notes)
        )


class _Cache:
    """The last few results by what they follow from."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return what is kept under the key, or make it."""
        if key not in self._kept:
            self._kept[key] = make()
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def _strategy_key(record: DepartureRecord) -> Hashable:
    return record.sha256['strategy'], record.parameters.planning.game


def _plan_key(record: DepartureRecord, trip: PosedTrip) -> Hashable:
    return (
        record.sha256['map'], trip.start_xy, trip.goal_xy, record.trip.tolerance,
        record.parameters.occupancy, _options(record),
    )


def _options(record: DepartureRecord) -> PlanningOptions:
    """The recorded options; whoever verifies has all the time that it takes."""
    options = record.parameters.planning
    return replace(options, strategy=replace(options.strategy, time_limit=math.inf))


def _version_notes(record: DepartureRecord) -> list[str]:
    """Tell what was recorded with another version than it is verified with."""
    here = {'ambush_planner': planner_version(), **software_versions()}
    there = {'ambush_planner': record.planner_version, **record.versions}
    others = [name for name in here if there.get(name) != here[name]]
    if not others:
        return []
    return [f'recorded with {_in_words(there, others)}, verified with {_in_words(here, others)}']


def _in_words(versions: Mapping[str, Any], names: list[str]) -> str:
    return ' and '.join(f'{name} {str(versions.get(name))[:20]!r}' for name in names)
