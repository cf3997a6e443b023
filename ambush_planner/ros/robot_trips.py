# SPDX-License-Identifier: Apache-2.0
"""The trips that robots are on, and when they are over."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from weakref import ref

from ..errors import AmbushPlannerError
from ..maps.ros_messages import pose_from_ros
from ..planning.changed_ground import Assessment
from ..planning.plan import Route
from ..planning.trip_under_way import Sighting, TripUnderWay
from .inputs import Inputs
from .plan_cache import CachedPlan
from .trip import Trip, TripRequest, seconds

# Maximum number of trips that are kept. Asking for a path to another goal does not end the present
# trip, so a robot may have several.
_MAX_TRIPS = 256
# A clock that goes back by more than this is that of a simulation or a bag that has restarted [s].
_RESTART = 1.0


@dataclass(eq=False)
class RobotTrip:
    """A trip as a robot ``asked`` for it: its departure or the last of its ``diversions``.

    It keeps no map: ``plan`` is that of the plan cache, and gone with it. The ``route`` is the
    full one, also of a diversion. ``moment`` is when the robot last made progress, by the node's
    clock and by TF [s].
    """

    track: TripUnderWay
    asked: TripRequest
    id: str
    number: int
    diversions: int
    assessment: Assessment
    plan: ref[CachedPlan]
    route: Route
    moment: tuple[float, float]
    _has_path: bool = field(default=False, init=False)
    _progress: float = field(default=0.0, init=False)

    def is_continued_by(self, trip: Trip) -> bool:
        """Return whether a request for a trip continues this one."""
        if trip.destination.frames != self.track.destination.frames:
            return False
        if not self._has_path:  # the robot may have driven on until it had the path
            self._has_path = True
            self.track.drive_on(trip.start_xy)
        return self.track.continues(trip.destination, trip.start_xy, trip.request.goal_tolerance)

    def is_over(self, moment: tuple[float, float]) -> bool:
        """Return whether the robot has made no progress for too long."""
        if self.track.progress > self._progress + self.track.tolerance:
            self._progress, self.moment = self.track.progress, moment
        idle = max(now - then for now, then in zip(moment, self.moment, strict=True))
        return idle > self.asked.parameters.values['trip.max_idle']


class RobotTrips:
    """The trips of robots; call all methods on the departures thread. ``clock()`` is in seconds."""

    def __init__(self, inputs: Inputs, clock: Callable[[], float]) -> None:
        self._inputs, self._clock = inputs, clock
        self._latest = -1.0
        self._trips: list[RobotTrip] = []  # the one used last first

    def continued_by(self, trip: Trip) -> RobotTrip | None:
        """Return the trip under way that a request for this trip continues, if there is one."""
        now = self.now()
        for each in list(self._trips):
            if each.is_continued_by(trip):
                self._trips.remove(each)
                if not each.is_over((now, trip.stamp)):
                    self._trips.insert(0, each)
                    return each
        return None

    def add(self, new: RobotTrip) -> None:
        """Keep a trip instead of the robot's one to the same goal; of all if one has ended."""
        to = new.track.destination
        own = [each for each in self._trips if each.track.destination.frames == to.frames]
        arrived = any(each.track.arrived for each in own)
        gone = [each for each in own if arrived or each.track.destination.goal == to.goal]
        self._trips = [new, *(each for each in self._trips if each not in gone)][:_MAX_TRIPS]

    def watch(self) -> None:
        """Note how far the robots have come; to be called about once a second."""
        now = self.now()
        for each in list(self._trips):
            with suppress(AmbushPlannerError):  # TF does not know where the robot is
                at, _ = self._inputs.start_of(each.asked)
                seen = Sighting(*pose_from_ros(at.pose), seconds(at.header.stamp))
                each.track.watch(seen)
                if each.is_over((now, seen.seconds)):
                    self._trips.remove(each)

    def now(self) -> float:
        """Return the time [s]; forget all trips if it has gone back: a simulation has restarted."""
        before, self._latest = self._latest, self._clock()
        if self._latest < before - _RESTART:
            self._trips = []
        return self._latest
