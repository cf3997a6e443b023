"""What the node does, apart from how it is wired: trip, plan, route, path, recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import RLock
from typing import TypeVar
from uuid import uuid4

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.clock import Clock
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.time import Time
from std_msgs.msg import Header

from ..core.errors import AmbushPlannerError, InvalidOption
from ..core.planner import Plan, depart
from ..core.routes import densify
from ..recording import RecordedMessage, RecordingFailed
from ..worker.errors import SolveCancelled, for_the_log
from . import markers
from .departures import Departure, ServiceCall
from .diagnostics import Problem, Status, status_to_ros
from .heap import give_back
from .inputs import Inputs, Received, Trip
from .later import then
from .outbox import Outbox
from .parameters import NodeParameters, RecordingOptions
from .paths import DeparturePath, departure_path
from .planning import Plans, route_entropy_source
from .recordings import Recordings
from .transforms import FrameTransforms

# Of the two seconds that the node has to end in: from being told to the last recording.
_LAST_RECORDINGS = 1.0  # s

_Outcome = TypeVar('_Outcome')


class Session:
    """One planner's run: its inputs, its plans and its departures.

    Safe to be used from several threads: departures leave one after the other in a thread of their
    own, and no thread waits for a solve. Methods and the futures that they return raise the
    planner's errors, and leave the session usable.
    """

    def __init__(
        self,
        name: str,
        parameters: NodeParameters,
        outbox: Outbox,
        transforms: FrameTransforms,
        clock: Clock,
        logger: RcutilsLogger,
    ) -> None:
        self._name, self._outbox, self._clock, self._logger = name, outbox, clock, logger
        self._parameters = parameters
        self._inputs = Inputs(transforms)
        self._plans = Plans()
        self._markers: tuple[RecordedMessage, ...] = ()
        self._departures = ThreadPoolExecutor(1, thread_name_prefix='departures')
        self._told_to_end: float | None = None
        self._status = Status(
            missing=self._inputs.missing, recording=_recording_state(parameters)
        )
        self._status_lock = RLock()
        self._recordings = Recordings(parameters.recording, self._recorded, logger.warning)

    def stop_solving(self) -> None:
        """End all solves: whoever waits for one, or for a departure, is told."""
        if self._told_to_end is None:
            self._told_to_end = time.monotonic()
        self._recordings.hurry()
        self._plans.close()

    def close(self) -> None:
        """Tell all who wait, write the last recordings, and end."""
        self.stop_solving()
        self._departures.shutdown()
        left_to_us = self._told_to_end + _LAST_RECORDINGS - time.monotonic()
        if left := self._recordings.close(left_to_us):
            self._logger.error(f'recording: {left} departures could not be written before the end')

    def reconfigure(self, parameters: NodeParameters) -> None:
        """Use other parameters from the next request on."""
        before, self._parameters = self._parameters.recording, parameters
        if parameters.recording != before:
            state = _recording_state(parameters)
            self._change(lambda s: replace(s.without_problem('recording'), recording=state))

    def accept_map(self, received: Received) -> None:
        """Put a map in force; raises InvalidRiskMap if the last one stays."""
        self._plans.forget_others(self._inputs.accept_map(received))
        self._change(lambda s: replace(s.without_problem('map'), missing=self._inputs.missing))

    def set_start(self, received: Received, pose: PoseStamped) -> None:
        """Take a pose as the start of the trips to come."""
        self._inputs.set_start(received, pose)
        self._change(lambda s: replace(s, missing=self._inputs.missing))

    def set_goal(self, received: Received, pose: PoseStamped) -> None:
        """Take a pose as the goal of the trips to come."""
        self._inputs.set_goal(received, pose)
        self._change(lambda s: replace(s, missing=self._inputs.missing))

    def new_route(self, call: ServiceCall, answer: Callable[[str], _Outcome]) -> Future[_Outcome]:
        """Depart between the latest start and goal; ``answer`` makes the response of a text."""
        trip = self._inputs.trip()
        where = self._outbox.topic_name('path')

        def respond(
            departure_id: str, number: int, _: DeparturePath, failed: Problem | None
        ) -> _Outcome:
            trouble = f'; {failed.message}' if failed else ''
            return answer(f'departure {number} ({departure_id}) is published on {where}{trouble}')

        return self._depart(trip, call, respond)

    def get_plan(
        self, call: ServiceCall, start: Received, goal: Received
    ) -> Future[GetPlan.Response]:
        """Depart between the poses of a request, whose goal may be moved if it is blocked."""
        tolerance = call.request.tolerance
        if not tolerance >= 0.0:
            raise InvalidOption(f'tolerance must be >= 0 [m], got {tolerance}')
        trip = self._inputs.trip_between(start, goal, tolerance)
        return self._depart(trip, call, _planned)

    def replan(self, answer: Callable[[str], _Outcome]) -> Future[_Outcome]:
        """Solve anew for the latest map, start and goal; ``answer`` makes a response of a text."""
        trip = self._inputs.trip()

        def show(plan: Plan) -> _Outcome:
            self._show(plan, trip)
            self._change(lambda s: s.without_problem('request'))
            return answer(
                f'solved in {plan.seconds:.3f} s: value {plan.strategy.value:.6g}, gap '
                f'{plan.strategy.gap:.3g}, {len(plan.network.points)} nodes'
            )

        return self._when_solved(trip, self._parameters, show)

    def cancel(self) -> bool:
        """End the solve that is running; return whether there was one."""
        return self._plans.cancel()

    def fail(self, concern: str, error: Exception) -> None:
        """Tell what is wrong with the last request, or with the map that just came."""
        self._change(lambda s: s.with_problem(concern, error))

    def report(self) -> RecordedMessage:
        """Publish the diagnostics as they are."""
        # Under the lock, or an older status could go out after a newer one.
        with self._status_lock:
            stamp = self._clock.now().to_msg()
            return self._outbox.publish(
                '/diagnostics', status_to_ros(self._status, self._name, stamp)
            )

    def _depart(
        self,
        trip: Trip,
        call: ServiceCall,
        respond: Callable[[str, int, DeparturePath, Problem | None], _Outcome],
    ) -> Future[_Outcome]:
        begin, parameters = self._now(), self._parameters

        def leave(plan: Plan) -> _Outcome:
            return self._leave(plan, trip, call, parameters, begin, respond)

        plan = self._plans.find(trip, parameters)
        if plan is None:
            return self._when_solved(trip, parameters, leave)
        return self._in_turn(lambda: leave(plan))

    def _when_solved(
        self, trip: Trip, parameters: NodeParameters, go_on: Callable[[Plan], _Outcome]
    ) -> Future[_Outcome]:
        """Have the trip planned; go on with the plan in the thread of departures."""
        solve = self._plans.solve(trip, parameters)
        self._change(lambda s: s)

        def solved(done: Future[Plan]) -> _Outcome:
            self._change(lambda s: s)
            return go_on(done.result())

        return then(solve, solved, self._in_turn)

    def _in_turn(self, work: Callable[[], _Outcome]) -> Future[_Outcome]:
        """Have work done in the thread of departures."""
        try:
            return self._departures.submit(work)
        except RuntimeError:  # the thread has ended
            self._refuse_when_closing()
            raise

    def _leave(
        self,
        plan: Plan,
        trip: Trip,
        call: ServiceCall,
        parameters: NodeParameters,
        begin: int,
        respond: Callable[[str, int, DeparturePath, Problem | None], _Outcome],
    ) -> _Outcome:
        """Draw a route, publish its path, and have it recorded; return the response."""
        self._refuse_when_closing()
        if plan is not self._status.plan:
            self._show(plan, trip)
        departure_id, number = str(uuid4()), self._status.departures + 1
        source = route_entropy_source(parameters.seed, number)
        route = depart(plan, np.random.default_rng(source))
        # Within a departure no time is before an earlier one, though the clock may be set.
        leaving = max(begin, self._now())
        path = departure_path(
            densify(route.points, parameters.path_spacing or plan.spacing),
            trip.start_pose.pose,
            trip.goal_pose.pose,
            self._header(trip, leaving),
        )
        published = self._outbox.publish('path', path.to_bytes())
        with self._status_lock:  # the answer tells what the diagnostics tell
            report = self._change(lambda s: replace(
                s.without_problem('request'), departures=number, departure_id=departure_id
            ))
            failed = self._status.problems.get('recording')
        response = respond(departure_id, number, path, failed)
        if parameters.recording.enabled:
            self._record(Departure(
                departure_id, number, call, response, trip, parameters, plan, source, route,
                begin, max(leaving, self._now()), published,
                tuple(filter(None, (*self._markers, report))),
            ))
        return response

    def _refuse_when_closing(self) -> None:
        if self._told_to_end is not None:
            raise SolveCancelled('the planner is shutting down')

    def _show(self, plan: Plan, trip: Trip) -> None:
        """Publish the markers of the plan that is in force from now on."""
        header, strategy = self._header(trip, self._now()), plan.strategy
        self._markers = tuple(
            self._outbox.publish(topic, message)
            for topic, message in (
                ('network', markers.network_lines(plan.network, header)),
                ('edge_probabilities', markers.edge_probabilities(strategy, header)),
                ('mean_direction', markers.mean_direction(strategy, header)),
                ('ambush_sites', markers.ambush_sites(strategy, header)),
            )
        )
        self._change(lambda s: replace(s, plan=plan))
        give_back()  # the plan and the markers before

    def _now(self) -> int:
        """The time of the node's clock [ns]."""
        return self._clock.now().nanoseconds

    def _header(self, trip: Trip, stamp_ns: int) -> Header:
        return Header(frame_id=trip.map.frame, stamp=Time(nanoseconds=stamp_ns).to_msg())

    def _record(self, departure: Departure) -> None:
        try:
            self._recordings.record(departure)
        except RecordingFailed as error:
            self._recorded(departure.parameters.recording, error)

    def _recorded(self, options: RecordingOptions, error: AmbushPlannerError | None) -> None:
        """Take note of how the recording of a departure went."""
        if error is not None:
            self._logger.error(f'recording: {for_the_log(error)}')
        if options != self._parameters.recording:
            return  # others hold by now
        if error is None:
            self._change(lambda s: replace(s.without_problem('recording'), recording='on'))
        else:
            self._change(
                lambda s: replace(s.with_problem('recording', error), recording='failed')
            )

    def _change(self, change: Callable[[Status], Status]) -> RecordedMessage | None:
        """Change the status, and publish it if it is another one then."""
        with self._status_lock:
            before = self._status
            self._status = replace(change(before), solving=self._plans.solving)
            return self.report() if self._status != before else None


def _planned(
    _id: str, _number: int, path: DeparturePath, _failed: Problem | None
) -> GetPlan.Response:
    return GetPlan.Response(plan=path.to_message())


def _recording_state(parameters: NodeParameters) -> str:
    return 'on' if parameters.recording.enabled else 'off'
