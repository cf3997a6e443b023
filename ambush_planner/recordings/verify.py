"""Checks a recorded departure: planned and drawn again from what was recorded, is it the same?

Each check leans on the one before: the stated hashes hold for what was recorded; the trip follows
from the recorded poses; the map, the trip and the parameters give the recorded network and
strategy; the recorded strategy and the source of randomness give the recorded route; and all that
was published follows from these. What that cannot show stands in the help of ``ambush_verify``.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import AmbushPlannerError
from ..game.strategy import Strategy
from ..maps.ros_messages import occupancy_from_ros
from ..planning.plan import PlanningOptions, PlanRequest, WarmStart
from ..ros.departure_record import planner_version, software_versions
from ..worker.process import WorkerProcess
from . import UnreadableRecording, read_departure
from .bag_folder import BagFile, describe_file
from .metadata import Metadata
from .recorded_case import Case
from .verify_file import file_faults
from .verify_messages import (
    call_faults,
    kind_faults,
    marker_faults,
    path_faults,
    solve_seconds,
    status_faults,
    time_faults,
)
from .verify_plan import (
    PlannedAgain,
    certificate_faults,
    changed_route_faults,
    ground_then,
    route_faults,
    source_faults,
    strategy_faults,
    was_hurried,
)
from .verify_trip import PosedTrip, ends_faults, metadata_faults, posed_trip

# There and back again, as the node keeps plans.
_KEPT = 4


@dataclass(eq=False)
class Verdict:
    """What was found about one recorded departure, or is being found out.

    Attributes
    ----------
    path
        The file.
    sha256
        Of the file; empty if it could not be read.
    nodes, value
        Of its strategy; 0 and nan if that could not be read.
    problems
        What does not hold; each begins with the part of the recording that it is about.
    notes
        What could not be checked, and how the computers differ.
    metadata, file
        What the file says, and how ``metadata.yaml`` lists it; None if it could not be read.
    """

    path: Path
    sha256: str = ''
    nodes: int = 0
    value: float = math.nan
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    metadata: Metadata | None = field(default=None, repr=False)
    file: BagFile | None = field(default=None, repr=False)

    @property
    def number(self) -> int:
        """Which departure of its session it is; 0 if that could not be read."""
        return self.metadata.number if self.metadata else 0

    @property
    def holds(self) -> bool:
        """Whether all that was checked holds."""
        return not self.problems

    @property
    def readable(self) -> bool:
        """Whether it is a departure at all."""
        return self.metadata is not None


class Verifier:
    """Verifies departures one after the other; those of one strategy take one solve.

    Solves run in a worker process like the node's, with its number of threads, as another number
    rounds otherwise. Also a context manager, which ends it.

    Parameters
    ----------
    planning
        Called with a file before it is planned again, which may take long.
    """

    def __init__(self, planning: Callable[[Path], None] = lambda path: None) -> None:
        self._planning = planning
        self._kept = {kind: _Cache() for kind in ('strategy', 'plan', 'comparison', 'markers')}
        self._seen: dict[str, tuple[Path, Mapping[str, str]]] = {}
        self._worker: WorkerProcess | None = None

    def __enter__(self) -> Verifier:
        return self

    def __exit__(self, *_: object) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def verify(self, path: Path) -> Verdict:
        """Verify one file; never raises for what is in it."""
        check = Verdict(path)
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
        return check

    def _check(self, check: Verdict) -> None:
        recorded = read_departure(check.path)
        check.metadata, check.sha256 = recorded.metadata, recorded.sha256
        check.file = describe_file(check.path.name, recorded.content)
        case = Case(recorded)
        check.problems += file_faults(recorded)
        check.problems += self._copy_faults(case.metadata, check.path)
        for faults in (metadata_faults, kind_faults, call_faults, time_faults, source_faults):
            check.problems += faults(case)
        strategy = self._kept['strategy'].get(_strategy_key(case), case.strategy)
        check.nodes, check.value = len(strategy.network.points), strategy.value
        check.problems += self._marker_faults(case, strategy)
        certificate = certificate_faults(strategy, case.parameters.planning)
        check.problems += certificate
        if not certificate and not case.recorded.map_changes:
            check.problems += route_faults(case, strategy)
        trip = posed_trip(case)
        check.problems += trip.faults
        check.notes += [*trip.notes, *_version_notes(case.metadata)]
        if case.parameters.seed >= 0:
            check.notes.append('drawn with a fixed seed: who knows it can foretell the route')
        self._check_plan(check, case, strategy, trip)

    def _check_plan(
        self, check: Verdict, case: Case, strategy: Strategy, trip: PosedTrip
    ) -> None:
        """Plan again, and compare; the rest cannot be checked where that fails.

        The game is solved only on the network that was recorded.
        """
        start: WarmStart | None = None
        key = (*_plan_key(case, trip), start and _strategy_key(case))
        try:
            again = self._kept['plan'].get(key, lambda: self._plan(case, trip, start))
            if again.goal_xy != case.metadata.trip.goal_xy:
                check.problems.append(
                    'trip: its goal is not where the goal pose and the tolerance lead to'
                )
            apart = ends_faults(case, again.spacing)
            check.problems += apart
            if faults := again.network_faults(strategy.network):
                check.problems += faults
                return
            plan = again.plan
        except AmbushPlannerError as error:
            check.problems.append(f'map, trip and parameters cannot be planned with: {error}')
            return
        hurried = was_hurried(strategy, case.parameters.planning, solve_seconds(case))
        if plan.stops_xy != case.metadata.trip.stops:
            if hurried:
                check.notes.append(
                    'not checked: whether another order of the stops follows, as its solve took '
                    'long for its max_planning_time'
                )
            else:
                check.problems.append('trip: its stops are visited in another order than follows')
            return
        faults, notes = self._kept['comparison'].get(
            (key, _strategy_key(case), hurried),
            lambda: strategy_faults(strategy, plan.strategy, hurried),
        )
        # On the recorded strategy, which may differ by rounding, or where time was up.
        used = replace(plan, strategy=strategy)
        check.problems += [*faults, *status_faults(case, used if hurried else plan, hurried)]
        check.notes += notes
        if apart:
            return
        ground, newest = ground_then(case, used)
        if not check.problems and case.recorded.map_changes:
            check.problems += changed_route_faults(case, ground, newest)
        fitted = ground.fitted(newest, case.metadata.ends)
        check.problems += path_faults(case, fitted, trip)

    def _plan(self, case: Case, trip: PosedTrip, start: WarmStart | None) -> PlannedAgain:
        self._planning(case.path)
        if self._worker is None or not self._worker.alive:
            self._worker = WorkerProcess()
        return PlannedAgain(PlanRequest(
            *occupancy_from_ros(case.message('map')),
            case.parameters.occupancy,
            case.metadata.trip.start_xy,
            trip.goal_xy,
            case.metadata.trip.tolerance,
            _options(case),
            trip.stops_xy,
            case.parameters.trip_order,
            start,
        ), case.metadata.trip.stops, self._worker.solve)

    def _marker_faults(self, case: Case, strategy: Strategy) -> list[str]:
        """Markers are made once for a strategy: the same bytes stand in each of its departures."""
        data = tuple(
            (each.topic, each.data) for each in case.recorded.messages
            if each.type.endswith('/MarkerArray')
        )
        return self._kept['markers'].get(
            (_strategy_key(case), case.metadata.frame, data), lambda: marker_faults(case, strategy)
        )

    def _copy_faults(self, metadata: Metadata, path: Path) -> list[str]:
        first, hashes = self._seen.setdefault(metadata.id, (path, metadata.sha256))
        if hashes == metadata.sha256:
            return []
        return [f'departure_id: it is also that of {first.name}, which holds something else']


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


def _strategy_key(case: Case) -> Hashable:
    return case.metadata.sha256['strategy'], case.parameters.planning.game


def _plan_key(case: Case, trip: PosedTrip) -> tuple[Hashable, ...]:
    return (
        case.metadata.sha256['map'], case.metadata.trip, trip.goal_xy, trip.stops_xy,
        case.parameters.trip_order, case.parameters.occupancy, _options(case),
    )


def _options(case: Case) -> PlanningOptions:
    """The recorded options; whoever verifies has all the time that it takes."""
    options = case.parameters.planning
    return replace(options, strategy=replace(options.strategy, time_limit=math.inf))


def _version_notes(metadata: Metadata) -> list[str]:
    """Tell what was recorded with another version than it is verified with."""
    here = {'ambush_planner': planner_version(), **software_versions()}
    there = {'ambush_planner': metadata.planner_version, **metadata.versions}
    others = [name for name in here if there.get(name) != here[name]]
    if not others:
        return []
    return [f'recorded with {_in_words(there, others)}, verified with {_in_words(here, others)}']


def _in_words(versions: Mapping[str, Any], names: list[str]) -> str:
    return ' and '.join(f'{name} {str(versions.get(name))[:20]!r}' for name in names)
