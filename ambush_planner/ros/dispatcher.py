# SPDX-License-Identifier: Apache-2.0
"""Serves path requests: the rest of the current trip, or a departure on a newly drawn route."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any
from weakref import ref

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger

from ..arrays import FloatArray
from ..errors import AmbushPlannerError, InvalidOption
from ..planning.plan import Plan
from ..recordings.metadata import RecordedCall
from ..recordings.plan_file import SavedPlan
from ..worker.solve_errors import SolveCancelled
from .current_map import CurrentMap
from .departure_record import Answer
from .departures import Departures, Pending
from .diagnostics import Reporter
from .displayed_plan import DisplayedPlan
from .errors import Refusal
from .gate import Gate
from .inputs import Inputs
from .parameter_changes import NodeSettings
from .plan_cache import CachedPlan, PlanCache
from .recordings import Recordings
from .serial_executor import SerialExecutor
from .topics import Publishers
from .trip import Trip, TripRequest

# Maximum number of tries of one request while the map changes or the robot drives. From the second
# plan on, a robot joins it at any value: the next one may be out of date again.
_MAX_TRIES, _ANY_VALUE_FROM = 4, 2


class Dispatcher:
    """Answers the requests to a configured node; thread-safe.

    Requests are answered one after the other on a thread of their own, which waits neither for a
    solve nor for a disk. Methods and the futures they return raise what a closed ``gate`` refuses
    requests with, and the planner's errors, and leave the dispatcher usable. ``inputs`` are those
    that were given.
    """

    def __init__(self, settings: NodeSettings, inputs: Inputs, publishers: Publishers,
                 recordings: Recordings, reporter: Reporter, logger: RcutilsLogger,
                 gate: Gate) -> None:
        self.inputs, self._reporter = inputs, reporter
        self._clock, self._logger, self._gate = publishers.clock, logger, gate
        self._plans = PlanCache(gate, logger)
        self._thread = SerialExecutor('departures', lambda error: reporter.note('request', error),
                                      reporter.set)
        self._displayed = DisplayedPlan(self._plans, inputs, settings, publishers, reporter,
                                        self._thread)
        self._departures = Departures(self._displayed, inputs, publishers, recordings, reporter,
                                      logger, gate, self._thread, self._try_again)
        self._recordings = recordings
        self._waiting: list[Pending] = []
        self._aside: list[Pending] = []  # until there is room in the recordings' queue
        recordings.on_room = self._retry

    @property
    def activity(self) -> tuple[bool, bool]:
        """Return whether a solve runs or waits, and whether a plan is being refined."""
        return self._plans.queue.activity

    def stop(self) -> None:
        """Refuse what waits, and end the worker; return when nothing is being answered."""
        self._plans.queue.close()
        self.cancel(self._gate.refusal)
        self._thread.finish()

    def close(self) -> None:
        """Refuse what waits, and end."""
        self.stop()
        self._thread.close()

    def adopt(self, saved: SavedPlan, grid: CurrentMap, request: TripRequest) -> None:
        """Depart on a plan from a file, as if its map, start, goal and stops had arrived."""
        inputs = self.inputs
        if 'costmap' in inputs.map_names:
            raise InvalidOption('a plan from a file has the whole map: set map.costmap to false')
        inputs.take('alpha_map', grid)
        inputs.join_maps()
        inputs.start, inputs.goal, inputs.via = request.start, request.goal, request.via
        trip = inputs.locate(request)
        cached = self._plans.adopt(saved.plan, trip, trip.parameters)
        self._logger.info(f'plan read from a file: value {saved.plan.value:.6g}, '
                          f'{len(saved.plan.network.points)} nodes')
        self._thread.submit(lambda: self._displayed.show(cached.as_solved))

    def map_changed(self) -> None:
        """Assess the displayed plan on the current map, and solve it again if it is stale."""
        self._displayed.map_changed()

    def follow(self) -> None:
        """Note how far robots have come on their paths; to be called about once a second."""
        def watch() -> None:
            self._waiting = [each for each in self._waiting if not each.answer.done()]
            self._departures.trips.watch()

        hung_for = self._recordings.hung_for
        self._reporter.note('disk', 'the disk of the recordings has not responded for '
                            f'{hung_for:.0f} s' if hung_for else '')
        self._recordings.refuse()
        self._thread.submit(watch)
        self._retry()

    def path_for(self, call: RecordedCall, trip_request: TripRequest, client: str = '',
                 draws: bool = False) -> Future[Answer]:
        """Return a path. Cancelling the future withdraws the request.

        A newer request of the same ``client``, for the same robot if that is the start, makes it
        fail with SolveCancelled if it is for another goal. ``draws``: always make a departure, even
        for a robot on its way.
        """
        if draws and not trip_request.parameters.values['path.publish']:
            raise InvalidOption(
                'new_route cannot return a path while path.publish is false: call get_plan'
            )
        pending = Pending(call, trip_request, client, draws)
        self._thread.submit(lambda: self._begin(pending), pending.answer)
        return pending.answer

    def replan(self) -> Future[Plan]:
        """Solve the latest trip on the current map, whether or not a plan is cached."""
        result: Future[Plan] = Future()
        latest = self.inputs.latest_request()

        def begin() -> None:
            self._gate.check()
            trip = self.inputs.locate(latest).leave_obstacle()
            self._when_solved(self._plans.solve(trip), show, result)

        def show(cached: CachedPlan) -> None:
            self._displayed.show(cached.as_solved)
            self._reporter.note('request', None)
            result.set_result(cached.plan)

        self._thread.submit(begin, result)
        return result

    def cancel(self, why: AmbushPlannerError | None = None) -> bool:
        """Cancel all solves, and refuse departures that wait for the disk; False if none is."""
        error = why or SolveCancelled('the request was cancelled')

        def refuse() -> None:
            for each in self._waiting:
                if not each.answer.running():  # it has not been drawn
                    _refuse(each, error)

        waited = bool(self._aside), self._recordings.refuse(error)
        self._thread.submit(refuse)
        return self._plans.queue.cancel(str(error)) or any(waited)

    def _begin(self, pending: Pending) -> None:
        """Refuse the client's waiting requests for other goals, and try to answer."""
        self._gate.check()
        if not pending.draws:
            robot = self.inputs.locate(pending.trip_request).robot
            pending.client = f'{pending.client} {robot}' if pending.client and robot else ''
        for older in self._waiting:
            if (pending.client == older.client != '' and not older.answer.running()  # not drawn yet
                    and not pending.trip_request.leads_to(older.trip_request)):
                _refuse(older, SolveCancelled(
                    'a newer request for another goal has replaced this one'))
        self._waiting.append(pending)
        self._try(pending)

    def _try(self, pending: Pending) -> None:
        """Answer without a departure, or depart on a plan, or try again once that is possible."""
        if pending.answer.done():  # cancelled, or a newer request has replaced this one
            return
        self._gate.check()
        trip = self.inputs.locate(pending.trip_request)
        if (not pending.draws and self._goes_on(trip, pending)) or self._waits_for_room(pending):
            return
        trip = trip.leave_obstacle()
        fit = self._plans.fit(trip, pending.tries >= _ANY_VALUE_FROM)
        if not (fit and self._departures.draw(fit, pending)):
            self._try_again(pending, trip)

    def _waits_for_room(self, pending: Pending) -> bool:
        """Put a request aside if there is no room for its recording.

        To be asked before anything is drawn, so that no time passes in between.
        """
        now = time.monotonic()
        if self._recordings.has_room(now - (pending.since or now)):
            pending.since = None
            return False
        pending.since = pending.since or now
        self._aside.append(pending)
        return True

    def _retry(self) -> None:
        """Try the requests again that were put aside."""
        def retry() -> None:
            aside, self._aside = self._aside, []
            for each in aside:
                self._thread.submit(partial(self._try, each), each.answer)

        if self._aside:
            self._thread.submit(retry)

    def _goes_on(self, trip: Trip, pending: Pending) -> bool:
        """Answer a robot that has arrived or is on its way; False if it is neither."""
        if left := self._departures.unsettled.get(trip.robot):
            self._thread.submit_after(left, lambda _: self._try(pending), pending.answer)
            return True
        under_way = self._departures.trips.continued_by(trip)
        if not trip.stops_xy and trip.ground.has_arrived(trip.start_xy, trip.goal_xy):
            rows = np.array([(*trip.goal_xy, 0.0)])
            self._answer(trip, rows, 'arrived', pending, under_way is not None)
        elif under_way is None:
            return False
        else:
            rest = under_way.track.rest(trip.start_xy, trip.goal_xy)
            asked = replace(trip.request, parameters=under_way.asked.parameters)
            trip = replace(trip, request=asked)
            if not trip.ground.drivable_steps(rest[:, :2]).all():
                return self._waits_for_room(pending) or self._departures.divert(under_way, trip,
                                                                                pending)
            self._answer(trip, rest, f'departure {under_way.number} continued', pending, True)
        return True

    def _answer(self, trip: Trip, rows: FloatArray, remarks: str, pending: Pending,
                continued: bool) -> None:
        """Answer with a path (L, 3) that is no departure, and may continue one."""
        if pending.is_wanted():
            now = self._clock.now().nanoseconds
            self._reporter.note('request', None)
            if continued:
                self._reporter.set(last_answer='continued')
            pending.answer.set_result(Answer(trip.path(rows, now), remarks,
                                             max(0, now - pending.call.request_ns)))

    def _try_again(self, pending: Pending, trip: Trip | None = None) -> None:
        """Try to answer, if need be with a new plan for a trip, unless too much was out of date."""
        pending.tries += 1
        if pending.tries > _MAX_TRIES:
            raise Refusal('OUT_OF_DATE', f'{_MAX_TRIES} plans or routes in a row were out of date: '
                          'the map changes or the robot drives too fast; stop it until it has its '
                          'path, or raise network.spacing or strategy.max_gap')
        if trip is None:
            self._try(pending)
        else:
            self._when_solved(self._plans.share_or_solve(trip), lambda _: self._try(pending),
                              pending.answer)

    def _when_solved(self, solve: Future[CachedPlan], use: Callable[[CachedPlan], None],
                     result: Future[Any]) -> None:
        """Use the plan on the departures thread; an error becomes the exception of ``result``."""
        self._reporter.set()
        self._thread.submit_after(solve, lambda done: use(done.result()), result)
        # A future keeps its callbacks, and strong references both ways would keep the plan alive
        # until the next full garbage collection.
        result.add_done_callback(partial(self._withdraw, ref(solve)))

    def _withdraw(self, solve: ref[Future[CachedPlan]], _: Future[Any]) -> None:
        if (waiting := solve()) is not None:
            self._plans.queue.withdraw(waiting)


def _refuse(pending: Pending, error: AmbushPlannerError) -> None:
    with suppress(InvalidStateError):  # it has been answered or cancelled
        pending.answer.set_exception(error)
