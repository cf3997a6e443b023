# SPDX-License-Identifier: Apache-2.0
"""Draws and publishes departures and diversions."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any
from uuid import uuid4
from weakref import ref

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger

from ..arrays import FloatArray
from ..planning.moved_start import other_rest, whole_route
from ..planning.plan import Route
from ..planning.trip_under_way import TripUnderWay, trip_on
from ..recordings.metadata import Diversion, RecordedCall, numbers_of
from ..routes.driven_path import Ends, tight_turns
from .departure_record import Answer, Departure
from .diagnostics import Reporter
from .displayed_plan import DisplayedPlan
from .gate import Gate
from .inputs import Inputs
from .plan_cache import CachedPlan, Fit
from .recordings import Recordings
from .robot_trips import RobotTrip, RobotTrips
from .serial_executor import SerialExecutor
from .topics import Publishers
from .trip import Trip, TripRequest


@dataclass(eq=False)
class Pending:
    """A request for a path, by a ``client`` ('': unknown).

    If it ``draws``, its answer is a departure even for a robot on its way. ``tries`` counts plans
    and routes that were out of date; ``since`` is when it began to wait for the disk [s].
    """

    call: RecordedCall
    trip_request: TripRequest
    client: str
    draws: bool
    answer: Future[Answer] = field(default_factory=Future)
    tries: int = 0
    since: float | None = None

    def is_wanted(self) -> bool:
        """Return whether an answer is still wanted; from then on it cannot be cancelled."""
        return self.answer.running() or self.answer.set_running_or_notify_cancel()


class OutOfDate(Exception):
    """The map has changed since a route was drawn, and blocks its path."""


class Departures:
    """Makes departures, which leave one after the other while the ``gate`` is open.

    Call all methods on the departures thread, which is ``thread``. A request whose route is out of
    date before it leaves is given to ``retry``. ``trips`` are those that robots are on, and
    ``unsettled`` the futures, by robot, of departures that have not left, being recorded first.
    """

    def __init__(self, displayed: DisplayedPlan, inputs: Inputs, publishers: Publishers,
                 recordings: Recordings, reporter: Reporter, logger: RcutilsLogger, gate: Gate,
                 thread: SerialExecutor, retry: Callable[[Pending], None]) -> None:
        self._displayed, self._inputs, self._publishers = displayed, inputs, publishers
        self._recordings, self._reporter, self._logger = recordings, reporter, logger
        self._gate, self._thread, self._retry = gate, thread, retry
        self.trips = RobotTrips(inputs, lambda: publishers.clock.now().nanoseconds / 1e9)
        self.unsettled: dict[str, Future[None]] = {}
        self._count = 0

    def draw(self, fit: Fit, pending: Pending) -> bool:
        """Draw a route and publish its path; False if hardly any route is clear."""
        self._displayed.show(fit)
        source = _entropy_source(fit.trip.parameters.values['seed'], self._count + 1)
        drawn = fit.draw(source)
        if drawn is None:
            return False
        if not pending.is_wanted():
            return True
        self._count += 1
        route, rows = drawn.route, drawn.poses
        at = fit.trip.start_pose.pose.position
        if (at.x, at.y) != fit.trip.start_xy:  # the path begins where the robot is
            rows = np.vstack(((at.x, at.y, rows[0, 2]), rows))
        remarks = (f'the path joins the routes of an earlier start: value '
                   f'{fit.assessment.value:.4g}, from there {fit.cached.plan.value:.4g}'
                   ) if fit.joined else ''
        track = (trip_on(fit.cached.plan, route, rows, fit.trip.destination)
                 if fit.trip.robot else None)
        left = self._depart(
            pending, fit.trip, fit.cached, source, rows, route, route, fit.ends, track,
            id=str(uuid4()), number=self._count, joined=fit.joined is not None,
            markers=self._displayed.markers, assessment=fit.assessment, remarks=remarks)
        if left.done() and left.exception():
            self._count -= 1  # it has not left, so the next one has its number
        return True

    def divert(self, under_way: RobotTrip, trip: Trip, pending: Pending) -> bool:
        """Take the rest of another route of the same plan; False if it is gone or none is clear."""
        held, track = under_way.plan(), under_way.track
        if held is None or not trip.map.same_ground(held.trip.map):
            return False
        number = under_way.diversions + 1
        source = _entropy_source(trip.parameters.values['seed'], under_way.number, number)
        x, y = track.path[-1, :2].tolist()
        ends, (leg, ahead) = (trip.start_xy, (x, y)), track.nodes_ahead(trip.start_xy)
        drawn = other_rest(held.ground, trip.map, ends, leg, ahead, source,
                           trip.parameters.values['route.path_spacing'])
        if drawn is None:
            return False
        if not pending.is_wanted():
            return True
        self._depart(
            pending, trip, held, source, drawn.poses, drawn.route,
            whole_route(under_way.route, drawn.route), ends,
            trip_on(held.plan, drawn.route, drawn.poses, track.destination, track.passed),
            id=under_way.id, number=under_way.number, joined=False, markers=(),
            assessment=under_way.assessment,
            diversion=Diversion(number, numbers_of(under_way.route), tuple(ahead.tolist())),
            remarks=f'departure {under_way.number} diverted: its path is no longer clear, and '
                    'another route of its plan is')
        return True

    def _depart(self, pending: Pending, trip: Trip, held: CachedPlan, source: list[int],
                rows: FloatArray, route: Route, full_route: Route, ends: Ends,
                track: TripUnderWay | None, **fields: Any) -> Future[None]:
        """Publish a departure, at once or when it is recorded; return the future of its leaving.

        It is driven along ``rows`` (L, 3). A diversion's ``route`` is the rest of the full one.
        Only a robot has a ``track``, and is under way on it once the departure has left; ``fields``
        are the other ones of the departure.
        """
        # The times of a departure ascend, even if the clock is set back.
        leaving = max(pending.call.request_ns, self._publishers.clock.now().nanoseconds)
        path, publishes = trip.path(rows, leaving), trip.parameters.values['path.publish']
        # It is recorded on its topic, or under the service that returns it.
        topic = '' if publishes else f'{pending.call.service}/path'
        departure = self._reporter.prepare(Departure(
            call=replace(pending.call, response_ns=leaving), trip=trip, held=held, ends=ends,
            entropy_source=source, route=route,
            published=self._publishers.as_recorded('path', path.data, topic),
            tight_turns=tight_turns(rows, held.plan.options.drive.turning_radius), **fields))
        diversions = departure.diversion.number if departure.diversion else 0
        under_way = None if track is None else RobotTrip(
            track, replace(pending.trip_request, parameters=trip.parameters), departure.id,
            departure.number, diversions, departure.assessment, ref(held), full_route,
            (self.trips.now(), trip.stamp))

        def leave() -> None:
            with self._gate.leaving:
                self._gate.check()
                self._check_clear(trip, path.poses)
                if publishes:
                    for topic in ('path', 'plan'):  # Nav2's RViz shows the latter
                        self._publishers.publish(topic, departure.published.data)
                self._reporter.publish(departure)
            if under_way and trip.parameters.recording.required:  # in the recordings' thread
                self._thread.submit(lambda: self.trips.add(under_way))
            elif under_way:
                self.trips.add(under_way)
            took_ns = departure.call.response_ns - departure.call.request_ns
            pending.answer.set_result(Answer(path, departure.remarks, took_ns, departure))

        def settle(left: Future[None]) -> None:
            if self.unsettled.get(trip.robot) is left:
                del self.unsettled[trip.robot]
            if isinstance(error := left.exception(), OutOfDate):
                self._thread.submit(lambda: self._retry(pending), pending.answer)
            elif error:
                pending.answer.set_exception(error)
            else:  # last: to find out who logs takes rclpy longer than all else
                diverted = ' diverted' if departure.diversion else ''
                self._logger.info(f'departure {departure.number} ({departure.id}){diverted}')

        left = self._recordings.publish(departure, leave)
        if trip.robot:
            self.unsettled[trip.robot] = left
        left.add_done_callback(settle)
        return left

    def _check_clear(self, trip: Trip, rows: FloatArray) -> None:
        """Raise OutOfDate if a path (L, 3) is blocked on a map that came since it was drawn."""
        newest = self._inputs.current_map()
        if newest is not trip.map and not (
                newest.frame == trip.map.frame
                and replace(trip, map=newest).ground.drivable_steps(rows[:, :2]).all()):
            raise OutOfDate


def _entropy_source(seed: int, *numbers: int) -> list[int]:
    """Return the seed of the random generator of one departure, or of one diversion of it.

    With seed -1 this is 256 bits from the operating system. With a fixed seed it follows from the
    numbers, so that each route can be reproduced on its own. Nothing else goes in: no time, no
    input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, *numbers]
