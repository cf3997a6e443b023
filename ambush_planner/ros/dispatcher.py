"""Dispatches convoys: finds or solves the plan, draws the route, publishes the path."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any
from uuid import uuid4

from rclpy.clock import Clock
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.time import Time
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ..errors import AmbushPlannerError, InvalidOption
from ..planning.node_parameters import NodeParameters
from ..planning.plan import Plan
from ..recordings import RecordedMessage
from ..routes.driven_path import tight_turns
from ..worker.solve_errors import SolveCancelled, for_the_log
from .cdr import path_bytes
from .conversions import path_to_ros
from .course import Course
from .departure_path import draw_path, route_entropy_source
from .departure_record import Departure, ServiceCall
from .displayed_plan import DisplayedPlan
from .error_codes import GroundChanges, NotActive
from .inputs import Inputs, Trip, TripRequest
from .parameter_changes import NodeSettings
from .plan_cache import CachedPlan, Fit, PlanCache
from .publishers import Publishers
from .recordings import Recordings
from .reporter import Reporter
from .serial_executor import SerialExecutor

# Time from the start of the shutdown to the end of the last recording [s]; half of the time in
# which the node has to end.
_SHUTDOWN_TIME = 1.0
# Maximum number of solves for one departure while the map or the robot moves.
_MOST_SOLVES = 4

INACTIVE = 'the node is inactive: activate it first (ros2 lifecycle set NODE activate)'


@dataclass(eq=False)
class _Pending:
    """A requested departure; ``client`` is '' if it is not known who asked."""

    call: ServiceCall
    trip_request: TripRequest
    parameters: NodeParameters
    begin_ns: int
    client: str
    departure: Future[Departure] = field(default_factory=Future)
    solves: int = 0
    asked: Trip | None = None  # as the last solve was asked for


class Dispatcher:
    """The plans and the departures of a configured node; thread-safe.

    Departures leave one after the other on a thread of their own, and no thread waits for a solve.
    Requests are refused until ``resume`` is called.
    Methods and the futures they return raise the planner's errors, and leave the dispatcher usable.
    """

    def __init__(self, settings: NodeSettings, inputs: Inputs, publishers: Publishers,
                 reporter: Reporter, clock: Clock, logger: RcutilsLogger) -> None:
        self._settings, self._inputs, self._publishers = settings, inputs, publishers
        self._reporter, self._clock, self._logger = reporter, clock, logger
        self._plans = PlanCache(logger)
        self._departures = SerialExecutor('departures', reporter.set,
                                          lambda error: reporter.failed('request', error),
                                          _shutting_down)
        self._displayed = DisplayedPlan(self._plans, inputs, publishers, reporter, clock,
                                        self._departures)
        self._waiting: list[_Pending] = []
        self._count = 0
        self._course = Course()
        self._shutdown_began: float | None = None
        self._paused = True
        self._map_is_new = False
        self._recordings = Recordings(settings.current.recording, self._recorded, logger.warning)

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits."""
        return self._plans.solving

    def stop_solving(self) -> None:
        """Cancel all solves, and refuse all requests from now on, including waiting ones."""
        if self._shutdown_began is None:
            self._shutdown_began = time.monotonic()
        self._recordings.hurry()
        self._plans.close()
        self._departures.finish()

    def pause(self) -> None:
        """Refuse requests, including waiting ones; no route is drawn after this returns."""
        self._paused = True
        self._departures.finish()
        self._plans.cancel()

    def resume(self) -> None:
        """Accept requests."""
        self._paused = False
        if self._displayed.cached is not None:
            self.map_changed()

    def close(self) -> None:
        """Answer waiting requests, write the last recordings, and end."""
        self.stop_solving()
        self._departures.close()
        began = self._shutdown_began or 0.0
        if lost := self._recordings.close(began + _SHUTDOWN_TIME - time.monotonic()):
            self._logger.error(
                f'recording: {lost} departures could not be written before the shutdown'
            )

    def map_changed(self) -> None:
        """Assess the displayed plan on the current map, and solve it again if it is stale."""
        self._map_is_new = True
        self.review()

    def review(self) -> None:
        """Assess the displayed plan if the map has changed since; called every second.

        Not while the convoy is driving: its next plan is solved from where it will be, and each
        departure assesses its own.
        """
        if self._map_is_new and not self._course.drives:  # one review covers many updates
            self._map_is_new = False
            self._departures.submit(self._review)

    def depart(self, call: ServiceCall, trip_request: TripRequest,
               client: str = '') -> Future[Departure]:
        """Depart on a trip, unless the returned future is cancelled before the route is drawn.

        It fails with SolveCancelled if the same ``client`` asks for another goal before that.
        """
        parameters = self._settings.agreeing()
        self._refuse_unheard(call)
        pending = _Pending(call, trip_request, parameters, self._now(), client)
        self._departures.submit(lambda: self._begin(pending), pending.departure)
        return pending.departure

    def answered(self, departure: Departure, response: Any) -> None:
        """Log and record a departure that has been answered."""
        end = max(departure.end_ns, self._now())
        self._logger.info(f'departure {departure.number} ({departure.id})')
        options = departure.parameters.recording
        if options.enabled and not options.required:
            self._recordings.record(replace(departure, response=response, end_ns=end))

    def replan(self, trip_request: TripRequest) -> Future[Plan]:
        """Solve a trip on the current map, whether or not a plan is cached."""
        self._settings.agreeing()
        result: Future[Plan] = Future()

        def begin() -> None:
            self._refuse_unless_active()
            parameters = self._settings.current
            trip = self._inputs.locate(trip_request, parameters.robot)
            self._when_solved(self._plans.solve(trip, parameters), show, result)

        def show(cached: CachedPlan) -> None:
            self._displayed.show(cached)
            self._review()
            self._reporter.succeeded('request')
            result.set_result(cached.plan)

        self._departures.submit(begin, result)
        return result

    def cancel(self) -> int:
        """Cancel all solves, running and waiting; return their number."""
        return self._plans.cancel()

    def _begin(self, pending: _Pending) -> None:
        """Refuse the client's waiting requests for other goals, and try to depart."""
        self._waiting = [each for each in self._waiting if not each.departure.done()]
        for older in self._waiting:
            same = pending.trip_request.leads_to(older.trip_request)
            if pending.client == older.client != '' and not same:
                with suppress(InvalidStateError):  # it has been cancelled
                    older.departure.set_exception(SolveCancelled(
                        'a newer request for another goal has replaced this one'
                    ))
        self._waiting.append(pending)
        self._try(pending)

    def _try(self, pending: _Pending, solved: CachedPlan | None = None) -> None:
        """Depart on a suitable plan, or have one solved and try again with it."""
        if pending.departure.cancelled():
            return
        self._refuse_unless_active()
        parameters = pending.parameters
        trip = self._inputs.locate(pending.trip_request, parameters.robot)
        under_way = self._course.under_way(trip)
        found = solved and _fit(solved, trip, pending, under_way) or self._plans.fit_or_solve(
            trip, parameters, under_way)
        if isinstance(found, Fit):
            self._leave(found, pending)
        else:
            self._try_after(found, trip, pending)

    def _try_after(self, solve: Future[CachedPlan], trip: Trip, pending: _Pending) -> None:
        pending.solves, pending.asked = pending.solves + 1, trip
        if pending.solves > _MOST_SOLVES:
            raise GroundChanges(
                f'{_MOST_SOLVES} plans in a row were out of date when they were solved: the map '
                'changes or the robot moves too fast; increase network.spacing, '
                'route.start_tolerance or strategy.max_gap'
            )
        self._when_solved(solve, lambda cached: self._try(pending, cached), pending.departure)

    def _when_solved(self, solve: Future[CachedPlan], use: Callable[[CachedPlan], None],
                     result: Future[Any]) -> None:
        """Use the plan on the departures thread; an error becomes the exception of ``result``."""
        self._reporter.set()
        solve.add_done_callback(
            lambda done: self._departures.submit(lambda: use(done.result()), result)
        )
        result.add_done_callback(lambda _: self._plans.withdraw(solve))

    def _leave(self, fit: Fit, pending: _Pending) -> None:
        """Draw a route, publish its path, and complete the departure."""
        cached, trip = fit.cached, fit.trip
        self._recordings.wait_for_room()
        self._refuse_unless_active()
        if fit.plan is not self._displayed.plan:
            self._displayed.show(cached, fit.plan, fit.assessment)
            if cached.trip.map is not trip.map:
                self._map_is_new = True
        parameters = pending.parameters
        departure_id, number = str(uuid4()), self._count + 1
        source = route_entropy_source(parameters.seed, number)
        # The times of a departure ascend, even if the clock is set back.
        leaving = max(pending.begin_ns, self._now())
        drawn = draw_path(fit, source, parameters.path_spacing)
        if drawn is None:
            self._try_after(self._plans.solve(trip, parameters), trip, pending)
            return
        if not pending.departure.set_running_or_notify_cancel():
            return
        route, rows = drawn
        header = Header(frame_id=trip.map.frame, stamp=Time(nanoseconds=leaving).to_msg())
        path = path_to_ros(rows, trip.start_pose.pose, trip.goal_pose.pose, header)
        self._count = number
        tight = tight_turns(rows, cached.plan.options.drive.turning_radius)
        name = '' if parameters.publish_path else f'{pending.call.name}/path'
        published = self._publishers.as_recorded('path', path_bytes(path), name)
        late_start = fit.note if fit.late_by else ''

        def publish() -> tuple[RecordedMessage, str]:
            if parameters.publish_path:
                self._publishers.publish('path', published.data)
            self._solve_ahead(trip, self._course.depart(trip, rows[:, :2]), parameters)
            return self._reporter.departed(number, departure_id, tight, fit.assessment,
                                           late_start)

        def departure(report: RecordedMessage, trouble: str) -> Departure:
            return Departure(
                departure_id, number, pending.call, trip, parameters, cached,
                fit.joined is not None, source, route, path, published,
                (*self._displayed.markers, report), pending.begin_ns, max(leaving, self._now()),
                '; '.join(filter(None, (fit.note, trouble))),
            )

        if parameters.recording.required:
            later = departure(*self._reporter.departed(
                number, departure_id, tight, fit.assessment, late_start, publish=False
            ))
            self._leave_once_recorded(later, publish, pending.departure)
        else:
            pending.departure.set_result(departure(*publish()))

    def _solve_ahead(self, trip: Trip, place: tuple[float, float] | None,
                     parameters: NodeParameters) -> None:
        """Solve in the background from the place where the convoy will ask again, if it drives.

        Not on roads, where plans cannot be joined, nor before stops, which may lie behind by then.
        """
        if place and not trip.stops_xy and not parameters.planning.network.roads:
            with suppress(SolveCancelled):
                self._plans.solve(replace(trip, start_xy=place), parameters, background=True)

    def _leave_once_recorded(self, departure: Departure, publish: Callable[[], object],
                             result: Future[Departure]) -> None:
        """Publish the path and complete the departure when its recording is on the disk."""
        def leave() -> None:
            written.result()
            self._refuse_unless_active()
            publish()
            result.set_result(departure)

        response = departure.call.respond(departure)
        written = self._recordings.record(replace(departure, response=response))
        written.add_done_callback(lambda _: self._departures.submit(leave, result))

    def _refuse_unheard(self, call: ServiceCall) -> None:
        """Refuse a departure whose path would reach nobody."""
        if call.kind is Trigger and not self._settings.current.publish_path:
            raise InvalidOption(
                'new_route cannot return a path while path.publish is false: call get_plan'
            )

    def _refuse_unless_active(self) -> None:
        if self._shutdown_began is not None:
            raise _shutting_down()
        if self._paused:
            raise NotActive(INACTIVE)

    def _review(self) -> None:
        """Assess the displayed plan; solve it again if it is stale and the node is active."""
        after_resolve = None if self._paused else self.map_changed
        self._displayed.review(self._settings.current.replan_tolerance, after_resolve)

    def _now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return self._clock.now().nanoseconds

    def _recorded(self, error: AmbushPlannerError | None) -> None:
        """Log and report how the recording of a departure went."""
        if error is not None:
            self._logger.error(f'recording: {for_the_log(error)}')
        self._reporter.recording(True, error)


def _fit(solved: CachedPlan, trip: Trip, pending: _Pending, under_way: bool) -> Fit | None:
    """Return how to depart on a plan that was solved for a request, if that is possible.

    From where the convoy is now or, without a clear way onto the routes, where it was when asked.
    """
    if fit := solved.fit(trip, pending.parameters, under_way):
        return fit
    asked = pending.asked
    if asked is None or not trip.moves or asked.map.frame != trip.map.frame:
        return None
    fit = solved.fit(replace(asked, map=trip.map), pending.parameters, under_way)
    return fit and replace(fit, late_by=math.dist(asked.start_xy, trip.start_xy))


def _shutting_down() -> SolveCancelled:
    return SolveCancelled('the planner is shutting down')
