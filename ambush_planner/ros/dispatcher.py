"""Dispatches convoys: finds or makes the plan, draws the route, publishes the path."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any
from uuid import uuid4

from nav_msgs.msg import Path
from rclpy.clock import Clock
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.time import Time
from std_srvs.srv import Trigger

from ..errors import AmbushPlannerError, InvalidOption
from ..planning.node_parameters import NodeParameters, RecordingOptions
from ..planning.plan import Plan
from ..recordings import RecordedMessage
from ..routes.driven_path import tight_turns
from ..worker.solve_errors import SolveCancelled, for_the_log
from .departure_path import DeparturePath, draw_path, route_entropy_source
from .departure_record import Departure, ServiceCall
from .displayed_plan import DisplayedPlan
from .error_codes import GroundChanges, NotActive
from .inputs import Inputs, Trip, TripRequest
from .plan_cache import CachedPlan, PlanCache, usable
from .publishers import Publishers
from .recordings import Recordings
from .reporter import Reporter
from .serial_executor import SerialExecutor

# Of the two seconds that the node has to end in: from being told to the last recording.
_LAST_RECORDINGS = 1.0  # s
# So many solves are waited for where map or robot have moved on each time.
_MOST_SOLVES = 4

INACTIVE = 'the node is inactive: nobody departs before it is activated (ros2 lifecycle set)'


@dataclass(eq=False)
class _Request:
    """A departure that somebody waits for."""

    call: ServiceCall
    asked: TripRequest
    parameters: NodeParameters
    begin_ns: int
    departure: Future[Departure] = field(default_factory=Future)
    solves: int = 0


class Dispatcher:
    """One planner's run: its plans and its departures.

    Safe to be used from several threads: departures leave one after the other in a thread of their
    own, and no thread waits for a solve. Methods and the futures that they return raise the
    planner's errors, and leave the dispatcher usable.
    """

    def __init__(
        self,
        parameters: NodeParameters,
        inputs: Inputs,
        outbox: Publishers,
        reporter: Reporter,
        clock: Clock,
        logger: RcutilsLogger,
    ) -> None:
        self._parameters, self._inputs, self._outbox = parameters, inputs, outbox
        self._reporter, self._clock, self._logger = reporter, clock, logger
        self._plans = PlanCache(logger)
        self._departures = SerialExecutor(
            'departures', reporter.refresh, lambda error: reporter.failed('request', error),
            _shutting_down,
        )
        self._in_force = DisplayedPlan(
            self._plans, inputs, outbox, reporter, clock, self._departures.do
        )
        self._count = 0
        self._told_to_end: float | None = None
        self._paused = True
        self._review_due = False
        self._contradiction: InvalidOption | None = None
        self._recordings = Recordings(parameters.recording, self._recorded, logger.warning)

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits."""
        return self._plans.solving

    def stop_solving(self) -> None:
        """End all solves, and refuse requests for good, the waiting ones too."""
        if self._told_to_end is None:
            self._told_to_end = time.monotonic()
        self._recordings.hurry()
        self._plans.close()
        self._departures.finish()

    def pause(self) -> None:
        """Refuse requests, the waiting ones too; no route is drawn once this has returned."""
        self._paused = True
        self._departures.finish()
        self._plans.cancel()

    def resume(self) -> None:
        """Take requests; a new dispatcher refuses them until this is called."""
        self._paused = False
        if self._in_force.held is not None:
            self.ground_changed()

    def close(self) -> None:
        """Answer waiting requests, write the last recordings, and end."""
        self.stop_solving()
        self._departures.close()
        told = self._told_to_end or 0.0
        if left := self._recordings.close(told + _LAST_RECORDINGS - time.monotonic()):
            self._logger.error(f'recording: {left} departures could not be written before the end')

    def reconfigure(self, parameters: NodeParameters) -> None:
        """Use other parameters from the next request on."""
        before, self._parameters, self._contradiction = self._parameters, parameters, None
        if before.publish_path and not parameters.publish_path:
            self._departures.do(self._withdraw_path)  # what leaves after it is not published

    def refuse(self, error: InvalidOption) -> None:
        """Refuse requests for this reason until there are parameters that can be used."""
        self._contradiction = error

    def ground_changed(self) -> None:
        """See how plans stand on the map that has just come, and solve anew where it is wanted."""
        if not self._review_due:  # of many updates at once the last one counts
            self._review_due = True
            self._departures.do(self._review)

    def depart(self, call: ServiceCall, asked: TripRequest) -> Future[Departure]:
        """Depart as asked, unless the future that is returned is cancelled before.

        Where paths are not published, a request must have them answered.
        """
        self._refuse_contradictions()
        self._refuse_unheard(call)
        request = _Request(call, asked, self._parameters, self._now())
        self._departures.do(lambda: self._try(request), request.departure)
        return request.departure

    def answered(self, departure: Departure, response: Any) -> None:
        """Log a departure that is answered, and have it recorded."""
        end = max(departure.end_ns, self._now())
        self._logger.info(f'departure {departure.number} ({departure.id})')
        self._recordings.record(replace(departure, response=response, end_ns=end))

    def replan(self, asked: TripRequest) -> Future[Plan]:
        """Solve anew for the map in force."""
        self._refuse_contradictions()
        outcome: Future[Plan] = Future()

        def begin() -> None:
            self._refuse_unless_active()
            parameters = self._parameters
            trip = self._inputs.locate(asked, parameters.robot)
            self._when_solved(self._plans.solve(trip, parameters), show, outcome)

        def show(held: CachedPlan) -> None:
            self._in_force.show(held)
            self._review()
            self._reporter.succeeded()
            outcome.set_result(held.plan)

        self._departures.do(begin, outcome)
        return outcome

    def cancel(self) -> int:
        """End the solve that runs and all that wait; return how many there were."""
        return self._plans.cancel()

    def _try(self, request: _Request, solved: CachedPlan | None = None) -> None:
        """Depart on a plan that is there, or have one solved and try again with it."""
        if request.departure.cancelled():
            return
        self._refuse_unless_active()
        parameters = request.parameters
        trip = self._inputs.locate(request.asked, parameters.robot)
        good = solved is not None and usable(solved, trip, parameters)
        held = solved if good else self._plans.find(trip, parameters)
        if held is None:
            self._wait(request, self._plans.plan_for(trip, parameters))
        else:
            self._leave(held, trip, request)

    def _wait(self, request: _Request, plan: Future[CachedPlan]) -> None:
        """Try again when the plan is there."""
        request.solves += 1
        if request.solves > _MOST_SOLVES:
            raise GroundChanges(
                f'{_MOST_SOLVES} solves were out of date before they were done: the map or the '
                'robot changes too fast; choose a larger network.spacing, route.start_tolerance '
                'or strategy.max_gap'
            )
        self._when_solved(plan, lambda held: self._try(request, held), request.departure)

    def _when_solved(
        self, solve: Future[CachedPlan], go_on: Callable[[CachedPlan], None], outcome: Future[Any]
    ) -> None:
        """Go on in the thread of departures; an error is the outcome."""
        self._reporter.refresh()

        def solved(done: Future[CachedPlan]) -> None:
            self._departures.do(lambda: go_on(done.result()), outcome)

        solve.add_done_callback(solved)
        outcome.add_done_callback(
            lambda outcome: self._plans.withdraw(solve) if outcome.cancelled() else None
        )

    def _leave(self, held: CachedPlan, trip: Trip, request: _Request) -> None:
        """Draw a route, publish its path, and tell."""
        self._recordings.wait_for_room()
        self._refuse_unless_active()
        self._refuse_unheard(request.call)
        if held is not self._in_force.held:
            self._in_force.show(held)
            if held.trip.map is not trip.map:
                self._review()
        parameters = request.parameters
        departure_id, number = str(uuid4()), self._count + 1
        source = route_entropy_source(parameters.seed, number)
        # Within a departure no time is before an earlier one, though the clock may be set.
        leaving = max(request.begin_ns, self._now())
        drawn = draw_path(
            held, trip, source, parameters.path_spacing, Time(nanoseconds=leaving).to_msg()
        )
        if drawn is None:
            self._wait(request, self._plans.solve(trip, parameters))
            return
        if not request.departure.set_running_or_notify_cancel():
            return
        route, path = drawn
        published = self._path_out(path, request)
        self._count = number
        tight = tight_turns(path.rows, held.plan.options.drive.turning_radius)
        report, trouble = self._reporter.departed(number, departure_id, tight)
        request.departure.set_result(Departure(
            departure_id, number, request.call, trip, parameters, held, source, route, path,
            published, (*self._in_force.markers, report), request.begin_ns,
            max(leaving, self._now()), trouble,
        ))

    def _path_out(self, path: DeparturePath, request: _Request) -> RecordedMessage:
        """Publish the path, if it may be by now; return what the recording keeps of it."""
        if request.parameters.publish_path and self._parameters.publish_path:
            return self._outbox.publish('path', path.to_bytes())
        return self._outbox.as_recorded('path', path.to_bytes(), f'{request.call.name}/path')

    def _withdraw_path(self) -> None:
        """Put an empty path where late joiners would get the last one."""
        if self._count:
            self._outbox.publish('path', Path())

    def _refuse_contradictions(self) -> None:
        if self._contradiction is not None:
            raise InvalidOption(
                f'parameters contradict each other: {self._contradiction}'
            ) from self._contradiction

    def _refuse_unheard(self, call: ServiceCall) -> None:
        """Refuse a departure whose path nobody would get."""
        if call.kind is Trigger and not self._parameters.publish_path:
            raise InvalidOption(
                'path.publish is false, so that new_route, whose answer has no room for a path, '
                'would leave nobody with it: call get_plan'
            )

    def _refuse_unless_active(self) -> None:
        if self._told_to_end is not None:
            raise _shutting_down()
        if self._paused:
            raise NotActive(INACTIVE)

    def _review(self) -> None:
        """See how the plan in force stands; solve it anew if it is stale, unless paused."""
        self._review_due = False
        again = None if self._paused else self._review
        self._in_force.review(self._parameters.replan_tolerance, again)

    def _now(self) -> int:
        """The time of the node's clock [ns]."""
        return self._clock.now().nanoseconds

    def _recorded(self, options: RecordingOptions, error: AmbushPlannerError | None) -> None:
        """Take note of how the recording of a departure went."""
        if error is not None:
            self._logger.error(f'recording: {for_the_log(error)}')
        if options == self._parameters.recording:  # or others hold by now
            self._reporter.recorded(error)


def _shutting_down() -> SolveCancelled:
    return SolveCancelled('the planner is shutting down')
