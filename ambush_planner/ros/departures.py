# SPDX-License-Identifier: Apache-2.0
"""Draws and publishes departures and diversions, and keeps track of the robots on them."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any
from uuid import uuid4

import numpy as np
from nav_msgs.msg import Path
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.time import Time

from ..arrays import FloatArray, IndexArray
from ..errors import AmbushPlannerError
from ..maps.ros_messages import pose_from_ros
from ..planning.moved_start import other_rest, whole_route
from ..planning.trip_under_way import Sighting, TripUnderWay, trip_on
from ..recordings.metadata import Diversion, RecordedCall
from ..routes.driven_path import Ends, tight_turns
from .departure_record import Answer, Departure
from .diagnostics import Reporter
from .displayed_plan import DisplayedPlan
from .inputs import Inputs
from .plan_cache import CachedPlan, Fit
from .recordings import Recordings
from .topics import Publishers
from .trip import Trip, TripRequest

# Maximum number of trips of one robot that are kept, each with its plan. Asking for a path to
# another goal does not end the present trip.
_MAX_TRIPS = 4


@dataclass(eq=False)
class Pending:
    """A request for a path, by a ``client`` ('': unknown).

    If it ``draws``, its answer is a departure even for a robot on its way.
    """

    call: RecordedCall
    trip_request: TripRequest
    client: str
    draws: bool
    answer: Future[Answer] = field(default_factory=Future)
    solves: int = 0


@dataclass(eq=False)
class RobotTrip:
    """A trip, its departure or the last diversion of that, and the whole route (K,).

    ``left`` is done once the path is published; with ``recording.required`` that takes a while.
    ``begun``: whether a request has come since then. The first one lets a robot that drove on
    meanwhile join the path from where it is.
    ``before`` is the trip that this one diverts, until it has left. A tour that ends where it
    begins is ``recorded`` when the robot has set out, because Nav2's controllers can take it to be
    at the end.
    """

    track: TripUnderWay
    departure: Departure
    request: TripRequest
    route: IndexArray
    left: Future[None]
    recorded: bool
    before: RobotTrip | None = None
    begun: bool = field(init=False)

    def __post_init__(self) -> None:
        self.begun = self.left.done()

    def is_continued_by(self, trip: Trip) -> bool:
        """Whether a request for a trip continues this one."""
        if trip.destination.frames != self.track.destination.frames:
            return False
        if not self.begun:
            self.begun = self.left.done()
            self.track.drive_on(trip.start_xy)
        return self.track.continues(trip.destination, trip.start_xy, trip.request.goal_tolerance)

    def settled(self) -> RobotTrip | None:
        """Return this trip, or the one before it if its departure has failed to leave."""
        if not self.left.done():
            return self
        before, self.before = self.before, None  # earlier diversions would keep their maps alive
        return before if self.left.exception() else self


class RobotTrips:
    """The trips of robots; call all methods on the departures thread.

    ``set_out`` is called, about once a second, with each trip whose robot has set out.
    """

    def __init__(self, inputs: Inputs, set_out: Callable[[RobotTrip], None]) -> None:
        self._inputs, self._set_out = inputs, set_out
        self._trips: list[RobotTrip] = []  # the newest one first

    def continued_by(self, trip: Trip) -> RobotTrip | None:
        """Return the trip under way that a request for this trip continues, if there is one."""
        self._trips = [each for one in self._trips if (each := one.settled()) is not None]
        return next((each for each in self._trips if each.is_continued_by(trip)), None)

    def add(self, new: RobotTrip) -> None:
        """Keep a trip, and the robot's last ones to other goals unless one of them has ended."""
        to = new.track.destination
        own = [each for each in self._trips if each.track.destination.frames == to.frames]
        others = [each for each in own if each.track.destination.goal != to.goal]
        if any(each.track.arrived for each in own):
            others = []
        self._trips = [new, *others[:_MAX_TRIPS - 1],
                       *(each for each in self._trips if each not in own)]

    def watch(self) -> None:
        """Note how far the robots have come; to be called about once a second, and at the end."""
        for each in self._trips:
            with suppress(AmbushPlannerError):  # TF does not know where the robot is
                at = self._inputs.locate(each.request).start_pose
                seconds = Time.from_msg(at.header.stamp).nanoseconds / 1e9
                each.track.watch(Sighting(*pose_from_ros(at.pose), seconds))
                if each.track.progress > each.track.tolerance:
                    self._set_out(each)


class Departures:
    """Makes departures, which leave one after the other while the node is active.

    Call all methods on the departures thread. ``check_active`` raises what refuses requests, if
    anything does; that must not begin while a departure is ``leaving``. ``trips`` are those that
    robots are on.
    """

    def __init__(self, displayed: DisplayedPlan, inputs: Inputs, publishers: Publishers,
                 recordings: Recordings, reporter: Reporter, logger: RcutilsLogger,
                 check_active: Callable[[], None]) -> None:
        self._displayed, self._publishers, self._recordings = displayed, publishers, recordings
        self._reporter, self._logger, self._check_active = reporter, logger, check_active
        self.trips = RobotTrips(inputs, self._record)
        self._count = 0
        self.leaving = Lock()

    def draw(self, fit: Fit, pending: Pending) -> bool:
        """Draw a route and publish its path; False if hardly any route is clear."""
        self._recordings.wait_for_room()
        self._check_active()
        self._displayed.show(fit)
        source = _entropy_source(fit.trip.parameters.values['seed'], self._count + 1)
        drawn = fit.draw(source)
        if drawn is None:
            return False
        if not pending.answer.set_running_or_notify_cancel():
            return True
        self._count += 1
        route, rows = drawn.nodes, _from_robot(drawn.poses, fit.trip)
        remarks = (f'the path joins the routes of an earlier start: value '
                   f'{fit.assessment.value:.4g}, from there {fit.cached.plan.value:.4g}'
                   ) if fit.joined else ''
        path, driven = self._driven(fit.trip, fit.cached, pending, source, route, rows, fit.ends)
        departure = Departure(
            id=str(uuid4()), number=self._count, held=fit.cached, joined=fit.joined is not None,
            markers=self._displayed.markers, assessment=fit.assessment, remarks=remarks, **driven)
        track = trip_on(fit.cached.plan, route, rows, fit.trip.destination)
        self._set_out(track, departure, path, route, pending)
        return True

    def divert(self, under_way: RobotTrip, trip: Trip, pending: Pending) -> bool:
        """Take the rest of another route of the same plan; False if none is clear."""
        before, track, held = under_way.departure, under_way.track, under_way.departure.held
        if not trip.map.same_ground(held.trip.map):
            return False
        self._recordings.wait_for_room()
        number = before.diversion.number + 1 if before.diversion else 1
        source = _entropy_source(trip.parameters.values['seed'], before.number, number)
        x, y = track.path[-1, :2].tolist()
        ends, ahead = (trip.start_xy, (x, y)), track.nodes_ahead(trip.start_xy)
        drawn = other_rest(held.ground, trip.map, ends, ahead, source,
                           trip.parameters.values['route.path_spacing'])
        if drawn is None:
            return False
        if not pending.answer.set_running_or_notify_cancel():
            return True
        self._record(under_way)
        path, driven = self._driven(trip, held, pending, source, drawn.nodes, drawn.poses, ends)
        departure = replace(
            before, joined=False, markers=(),
            diversion=Diversion(number, tuple(under_way.route.tolist()), tuple(ahead.tolist())),
            remarks=f'departure {before.number} diverted: its path is no longer clear, and another '
                    'route of its plan is', **driven)
        self._set_out(
            trip_on(held.plan, drawn.nodes, drawn.poses, track.destination, track.passed),
            departure, path, whole_route(under_way.route, drawn.nodes), pending, under_way)
        return True

    def _driven(self, trip: Trip, held: CachedPlan, pending: Pending, source: list[int],
                route: IndexArray, rows: FloatArray, ends: Ends) -> tuple[Path, dict[str, Any]]:
        """Return a path, and the fields of its departure that say what is driven, for whom."""
        # The times of a departure ascend, even if the clock is set back.
        leaving = max(pending.call.request_ns, self._publishers.clock.now().nanoseconds)
        path = trip.path(rows, leaving)
        # It is recorded on its topic, or under the service that returns it.
        topic = '' if trip.parameters.values['path.publish'] else f'{pending.call.service}/path'
        return path, {
            'call': replace(pending.call, response_ns=leaving), 'trip': trip, 'ends': ends,
            'entropy_source': source, 'route': route,
            'published': self._publishers.as_recorded('path', path, topic),
            'tight_turns': tight_turns(rows, held.plan.options.drive.turning_radius),
        }

    def _set_out(self, track: TripUnderWay, departure: Departure, path: Path, route: IndexArray,
                 pending: Pending, before: RobotTrip | None = None) -> None:
        """Publish a departure, at once or when it is recorded; it is under way from now on.

        ``before`` is the trip that it diverts.
        """
        self.trips.watch()  # a tour that this one ends is recorded before
        departure = self._reporter.departing(departure)
        trip, answer = departure.trip, pending.answer

        def leave() -> None:
            with self.leaving:
                self._check_active()
                if trip.parameters.values['path.publish']:
                    for topic in ('path', 'plan'):  # Nav2's RViz shows the latter
                        self._publishers.publish(topic, departure.published.data)
                self._reporter.departed(departure)
            diverted = ' diverted' if departure.diversion else ''
            self._logger.info(f'departure {departure.number} ({departure.id}){diverted}')
            took_ns = departure.call.response_ns - departure.call.request_ns
            answer.set_result(Answer(path, departure.remarks, took_ns, departure))

        def refuse_unless_left(left: Future[None]) -> None:
            if error := left.exception():
                answer.set_exception(error)

        at_once = (before is not None or not (trip.moves and trip.stops_xy)
                   or trip.parameters.recording.required
                   or math.dist(trip.start_xy, trip.goal_xy) > track.tolerance)
        left = self._recordings.publish(departure, leave, record=at_once)
        if trip.moves:
            self.trips.add(RobotTrip(track, departure, pending.trip_request, route, left, at_once,
                                    before))
        left.add_done_callback(refuse_unless_left)

    def _record(self, under_way: RobotTrip) -> None:
        if not under_way.recorded:
            under_way.recorded = True
            self._recordings.publish(under_way.departure, lambda: None)


def _from_robot(rows: FloatArray, trip: Trip) -> FloatArray:
    """Return the path (L, 3) with the robot's place before it, if it begins elsewhere."""
    at = trip.start_pose.pose.position
    return rows if (at.x, at.y) == trip.start_xy else np.vstack(((at.x, at.y, rows[0, 2]), rows))


def _entropy_source(seed: int, *numbers: int) -> list[int]:
    """Return the seed of the random generator of one departure, or of one diversion of it.

    With seed -1 this is 256 bits from the operating system. With a fixed seed it follows from the
    numbers, so that each route can be reproduced on its own. Nothing else goes in: no time, no
    input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, *numbers]
