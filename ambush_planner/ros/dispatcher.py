# SPDX-License-Identifier: Apache-2.0
"""Serves path requests: the rest of the current trip, or a departure on a newly drawn route."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from threading import Lock
from typing import Any
from uuid import uuid4

import numpy as np
from nav_msgs.msg import Path
from rclpy.clock import Clock
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.time import Time
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ..arrays import FloatArray, IndexArray
from ..errors import AmbushPlannerError, InvalidOption
from ..maps.ros_messages import path_from_ros, pose_from_ros
from ..parameters.values import NodeParameters
from ..planning.clear_ground import ClearGround
from ..planning.moved_start import other_rest, whole_route
from ..planning.plan import Plan, Route
from ..planning.trip_under_way import Destination, Sighting, TripUnderWay, trip_on
from ..recordings import RecordedMessage
from ..recordings.metadata import Diversion
from ..recordings.plan_file import SavedPlan
from ..routes.driven_path import tight_turns
from ..worker.serial_executor import SerialExecutor
from ..worker.solve_errors import SolveCancelled
from .conversions import path_to_ros
from .current_map import CurrentMap, ReceivedMessage
from .departure_record import Answer, Departure, ServiceCall
from .displayed_plan import DisplayedPlan
from .error_codes import FrameMismatch, GroundChanges, NotActive
from .inputs import Inputs, Trip, TripRequest
from .parameter_changes import NodeSettings
from .plan_cache import CachedPlan, Fit, PlanCache
from .recordings import Recordings
from .reporter import Reporter
from .topics import Publishers

# Maximum number of solves for one departure while the map changes or the robot drives. From the
# second one on, a robot joins the plan at any value: the next one may be out of date again.
_MAX_SOLVES, _BEST_VALUE = 4, 1
# Maximum number of trips of one robot that are kept, each with its plan: another goal that is
# looked up ends none.
_MAX_TRIPS = 4

INACTIVE = 'the node is inactive: activate it first (ros2 lifecycle set NODE activate)'


@dataclass(eq=False)
class _Pending:
    """A request for a path; ``client`` is '' if it is not known who asked."""

    call: ServiceCall
    trip_request: TripRequest
    parameters: NodeParameters
    begin_ns: int
    client: str
    answer: Future[Answer] = field(default_factory=Future)
    solves: int = 0


@dataclass(eq=False)
class _UnderWay:
    """A trip, its departure or the last diversion of that, and the whole route (K,).

    ``left`` is done once the path is published; with ``recording.required`` that takes a while. A
    tour that ends where it begins is ``recorded`` when the robot has set out, because Nav2's
    controllers can take it to be at the end.
    """

    trip: TripUnderWay
    departure: Departure
    request: TripRequest
    route: IndexArray
    left: Future[None]
    recorded: bool


class Dispatcher:
    """The plans and the departures of a configured node; thread-safe.

    Requests are answered one after the other on a thread of their own, and no thread waits for a
    solve. They are refused until ``resume`` is called.
    Methods and the futures they return raise the planner's errors, and leave the dispatcher usable.
    """

    def __init__(self, settings: NodeSettings, inputs: Inputs, publishers: Publishers,
                 recordings: Recordings, reporter: Reporter, clock: Clock,
                 logger: RcutilsLogger) -> None:
        self._settings, self._inputs, self._publishers = settings, inputs, publishers
        self._recordings, self._reporter = recordings, reporter
        self._clock, self._logger = clock, logger
        self._plans = PlanCache(logger)
        self._departures = SerialExecutor('departures', reporter.set,
                                          lambda error: reporter.failed('request', error),
                                          _shutting_down)
        self._displayed = DisplayedPlan(self._plans, inputs, publishers, reporter, clock,
                                        self._departures)
        self._waiting: list[_Pending] = []
        self._count = 0
        self._under_way: list[_UnderWay] = []  # the newest one first
        self._undecided: list[_Pending] = []  # for a trip at its end, or for its next round
        self._paused, self._ending = True, False
        self._leaving = Lock()  # while a departure leaves; none does once the node is paused
        self._map_is_new = False

    @property
    def activity(self) -> tuple[bool, bool]:
        """Whether a solve runs or waits, and whether a plan is being refined."""
        return self._plans.solving, self._plans.refining

    def stop_solving(self) -> None:
        """Cancel all solves, and refuse all requests from now on, including waiting ones."""
        with self._leaving:
            self._ending = True
        self._recordings.hurry()
        self._plans.close()
        self._departures.submit(self._retry)
        self._departures.finish()

    def pause(self) -> None:
        """Refuse requests, including waiting ones; nothing leaves after this returns."""
        with self._leaving:
            self._paused = True
        self._recordings.hurry()
        self._plans.cancel()

    def resume(self) -> None:
        """Accept requests."""
        self._paused = False
        self._recordings.hurry(False)
        if self._displayed.cached is not None:
            self.map_changed()

    def close(self) -> None:
        """Answer waiting requests, and end."""
        self.stop_solving()
        self._departures.close()

    def adopt(self, saved: SavedPlan, grid: ReceivedMessage, request: TripRequest) -> None:
        """Depart on a plan from a file, as if its map, start, goal and stops had arrived."""
        parameters, inputs = self._settings.current, self._inputs
        if inputs.with_costmap:
            raise InvalidOption('a plan from a file has the whole map: set map.costmap to false')
        inputs.accept_map('alpha_map', grid)
        inputs.join_maps()
        inputs.start, inputs.goal, inputs.via = request.start, request.goal, request.via
        trip = inputs.locate(request, parameters.robot)
        cached = self._plans.adopt(trip, parameters, saved.plan)
        self._logger.info(f'plan read from a file: value {saved.plan.strategy.value:.6g}, '
                          f'{len(saved.plan.network.points)} nodes')
        self._departures.submit(lambda: self._displayed.show(cached))

    def map_changed(self) -> None:
        """Assess the displayed plan on the current map, and solve it again if it is stale."""
        if not self._map_is_new:  # one review covers many updates
            self._map_is_new = True
            self._departures.submit(self._review)

    def follow(self) -> None:
        """Note how far robots have come on their paths; to be called about once a second."""
        if self._under_way:
            self._departures.submit(self._follow)

    def prepare(self) -> None:
        """Have a robot's trip to the latest goal solved in the background, before it asks."""
        self._departures.submit(self._prepare)

    def depart(self, call: ServiceCall, trip_request: TripRequest,
               client: str = '') -> Future[Answer]:
        """Return a path for a trip, unless the returned future is cancelled before.

        It fails with SolveCancelled if the same ``client`` asks for another goal before that.
        """
        parameters = self._settings.agreeing()
        if call.kind is Trigger and not parameters.publish_path:
            raise InvalidOption(
                'new_route cannot return a path while path.publish is false: call get_plan'
            )
        pending = _Pending(call, trip_request, parameters, self._now(), client)
        self._departures.submit(lambda: self._begin(pending), pending.answer)
        return pending.answer

    def replan(self, trip_request: TripRequest) -> Future[Plan]:
        """Solve a trip on the current map, whether or not a plan is cached."""
        self._settings.agreeing()
        result: Future[Plan] = Future()

        def begin() -> None:
            self._refuse_unless_active()
            parameters = self._settings.current
            trip = _out_of_obstacle(self._inputs.locate(trip_request, parameters.robot), parameters)
            self._when_solved(self._plans.solve(trip, parameters), show, result)

        def show(cached: CachedPlan) -> None:
            self._displayed.show(cached)
            self._review()
            self._reporter.succeeded('request')
            result.set_result(cached.plan)

        self._departures.submit(begin, result)
        return result

    def invalid_poses(self, path: Path) -> list[int] | None:
        """Return which poses of a path, from the robot on, the newest map does not let it reach.

        None if the path has no poses: Nav2's trees ask so before their first path. Raises NoMap,
        FrameMismatch if the path is not in the map's frame, and InvalidPose.
        """
        if not path.poses:
            return None
        newest, parameters = self._inputs.current_map(), self._settings.current
        if path.header.frame_id != newest.frame:
            raise FrameMismatch(f'the path is in the frame {path.header.frame_id[:80]!r}, the map '
                                f'in {newest.frame!r}')
        points, place = path_from_ros(path)[:, :2], self._inputs.robot_place(parameters.robot)
        first = int(np.hypot(*(points - place).T).argmin()) if place else 0
        rest, ground = points[first:], _clear_ground(newest, parameters)
        if len(rest) == 1:
            return [] if ground.segments(rest, rest).all() else [first]
        return (np.flatnonzero(~ground.drivable_steps(rest)) + first + 1).tolist()

    def cancel(self) -> int:
        """Cancel all solves, running and waiting; return their number."""
        return self._plans.cancel()

    def _begin(self, pending: _Pending) -> None:
        """Refuse the client's waiting requests for other goals, and try to answer."""
        self._waiting = [each for each in self._waiting if not each.answer.done()]
        for older in self._waiting:
            same = pending.trip_request.leads_to(older.trip_request)
            if pending.client == older.client != '' and not same:
                with suppress(InvalidStateError):  # it has been cancelled
                    older.answer.set_exception(SolveCancelled(
                        'a newer request for another goal has replaced this one'
                    ))
        self._waiting.append(pending)
        self._try(pending)

    def _try(self, pending: _Pending) -> None:
        """Answer without a departure, or depart on a plan, or try again once one is solved."""
        if pending.answer.cancelled():
            return
        self._refuse_unless_active()
        parameters = pending.parameters
        trip = self._inputs.locate(pending.trip_request, parameters.robot)
        if pending.call.kind is not Trigger and self._goes_on(trip, pending):
            return  # new_route always draws
        trip = _out_of_obstacle(trip, parameters)
        if fit := self._plans.fit(trip, parameters, pending.solves > _BEST_VALUE):
            self._leave(fit, pending)
        else:
            self._solve_for(trip, pending)

    def _goes_on(self, trip: Trip, pending: _Pending) -> bool:
        """Answer a robot that has arrived or is on its way; False if it is neither."""
        under_way = self._continued_by(trip)
        if under_way and not under_way.left.done():  # try again once it has left, or has not
            under_way.left.add_done_callback(
                lambda _: self._departures.submit(lambda: self._try(pending), pending.answer))
            return True
        if under_way and under_way.trip.is_undecided(_destination(trip)):
            self._undecided.append(pending)
            return True
        ground = _clear_ground(trip.map, pending.parameters)
        if not trip.stops_xy and ground.has_arrived(trip.start_xy, trip.goal_xy):
            rows, remarks = np.array([(*trip.goal_xy, 0.0)]), 'arrived'
        elif under_way is None:
            return False
        else:
            rows = under_way.trip.rest(trip.start_xy, trip.goal_xy)
            ground = _clear_ground(trip.map, under_way.departure.parameters)
            if not ground.drivable_steps(rows[:, :2]).all():
                return self._divert(under_way, trip, pending)
            remarks = f'departure {under_way.departure.number} continued'
        if pending.answer.set_running_or_notify_cancel():
            self._reporter.succeeded('request')
            if under_way:
                self._reporter.set(last_answer='continued')
            pending.answer.set_result(Answer(self._path(rows, trip), remarks, pending.begin_ns,
                                             max(pending.begin_ns, self._now())))
        return True

    def _continued_by(self, trip: Trip) -> _UnderWay | None:
        """Return the trip under way that a request for this trip continues, if there is one."""
        wanted, at = _destination(trip), trip.start_xy
        return next((each for each in self._under_way
                     if each.trip.continues(wanted, at, trip.request.goal_tolerance)), None)

    def _divert(self, under_way: _UnderWay, trip: Trip, pending: _Pending) -> bool:
        """Take the rest of another route of the same plan; False if none is clear."""
        before, way, held = under_way.departure, under_way.trip, under_way.departure.held
        if not trip.map.same_ground(held.trip.map):
            return False
        self._recordings.wait_for_room()
        number = before.diversion.number + 1 if before.diversion else 1
        source = _entropy_source(before.parameters.seed, before.number, number)
        x, y = way.path[-1, :2].tolist()
        ends, ahead = (trip.start_xy, (x, y)), way.nodes_ahead(trip.start_xy)
        drawn = other_rest(held.ground, trip.map, ends, ahead, np.random.default_rng(source),
                           before.parameters.path_spacing or held.plan.spacing)
        if drawn is None:
            return False
        if not pending.answer.set_running_or_notify_cancel():
            return True
        self._record(under_way)
        leaving = max(pending.begin_ns, self._now())
        route, path = drawn[0], self._path(drawn[1], trip, leaving)
        departure = self._reporter.departing(replace(
            before, call=pending.call, trip=trip, joined=False, ends=ends, entropy_source=source,
            route=route, path=path, published=self._as_recorded(path, pending, before.parameters),
            markers=(), begin_ns=pending.begin_ns, end_ns=leaving, report=None,
            tight_turns=tight_turns(drawn[1], held.plan.options.drive.turning_radius),
            diversion=Diversion(number, tuple(under_way.route.tolist()), tuple(ahead.tolist())),
            remarks=f'departure {before.number} diverted: its path is no longer clear, and another '
                    'route of its plan is',
        ))
        self._set_out(trip_on(held.plan, *drawn, way.destination, way.passed), departure,
                      whole_route(under_way.route, route.nodes), pending, under_way)
        return True

    def _solve_for(self, trip: Trip, pending: _Pending) -> None:
        """Try again with a plan for this trip; raises GroundChanges after too many."""
        pending.solves += 1
        if pending.solves > _MAX_SOLVES:
            raise GroundChanges(f'{_MAX_SOLVES} plans in a row were out of date when solved: the '
                                'map changes or the robot drives too fast; raise network.spacing '
                                'or strategy.max_gap')
        self._when_solved(self._plans.share_or_solve(trip, pending.parameters),
                          lambda _: self._try(pending), pending.answer)

    def _when_solved(self, solve: Future[CachedPlan], use: Callable[[CachedPlan], None],
                     result: Future[Any]) -> None:
        """Use the plan on the departures thread; an error becomes the exception of ``result``."""
        self._reporter.set()
        solve.add_done_callback(
            lambda done: self._departures.submit(lambda: use(done.result()), result)
        )
        result.add_done_callback(lambda _: self._plans.withdraw(solve))

    def _leave(self, fit: Fit, pending: _Pending) -> None:
        """Draw a route and publish its path: this is a departure."""
        self._recordings.wait_for_room()
        self._refuse_unless_active()
        if fit.plan is not self._displayed.plan:
            self._displayed.show(fit.cached, fit.plan, fit.assessment)
            if fit.cached.trip.map is not fit.trip.map:
                self.map_changed()
        parameters = pending.parameters
        source = _entropy_source(parameters.seed, self._count + 1)
        drawn = fit.draw(source, parameters.path_spacing)
        if drawn is None:
            self._solve_for(fit.trip, pending)
            return
        if not pending.answer.set_running_or_notify_cancel():
            return
        self._count += 1
        route, rows = drawn[0], _from_robot(drawn[1], fit.trip)
        departure = self._departure(fit, route, rows, source, pending)
        way = trip_on(fit.cached.plan, route, rows, _destination(fit.trip))
        self._set_out(way, departure, route.nodes, pending)

    def _set_out(self, way: TripUnderWay, departure: Departure, route: IndexArray,
                 pending: _Pending, before: _UnderWay | None = None) -> None:
        """Have a departure leave, at once or when it is recorded; it is under way from now on.

        ``before`` is the trip that it diverts.
        """
        answer = Answer(departure.path, departure.remarks, departure.begin_ns, departure.end_ns,
                        departure)

        def leave() -> None:
            with self._leaving:
                self._refuse_unless_active()
                if departure.parameters.publish_path:
                    for topic in ('path', 'plan'):  # Nav2's RViz shows the latter
                        self._publishers.publish(topic, departure.published.data)
                self._reporter.departed(departure)
            diverted = ' diverted' if departure.diversion else ''
            self._logger.info(f'departure {departure.number} ({departure.id}){diverted}')
            pending.answer.set_result(answer)

        trip = departure.trip
        sets_out = (before is not None or not (trip.moves and trip.stops_xy)
                    or departure.parameters.recording.required
                    or math.dist(trip.start_xy, trip.goal_xy) > way.tolerance)
        left = self._recordings.depart(departure, leave, sets_out)
        under_way = _UnderWay(way, departure, pending.trip_request, route, left, sets_out)
        if trip.moves:
            self._take_up(under_way)

        def stay() -> None:
            if under_way in self._under_way:
                self._under_way.remove(under_way)
                if before and not (before.left.done() and before.left.exception()):
                    self._under_way.insert(0, before)
            left.result()

        def stay_unless_left(_: Future[None]) -> None:
            if left.exception():
                self._departures.submit(stay, pending.answer)

        left.add_done_callback(stay_unless_left)

    def _take_up(self, new: _UnderWay) -> None:
        """Keep a trip, and the robot's last ones to other goals unless one of them has ended."""
        to = new.trip.destination
        own = [each for each in self._under_way if each.trip.destination.frames == to.frames]
        others = [each for each in own if each.trip.destination.goal != to.goal]
        if any(each.trip.arrived for each in own):
            others = []
        self._under_way = [new, *others[:_MAX_TRIPS - 1],
                           *(each for each in self._under_way if each not in own)]

    def _departure(self, fit: Fit, route: Route, rows: FloatArray, source: list[int],
                   pending: _Pending) -> Departure:
        """Return a departure that has not left."""
        trip, parameters = fit.trip, pending.parameters
        # The times of a departure ascend, even if the clock is set back.
        leaving = max(pending.begin_ns, self._now())
        path = self._path(rows, trip, leaving)
        tight = tight_turns(rows, fit.plan.options.drive.turning_radius)
        note = (f'the path joins the routes of an earlier start: value {fit.assessment.value:.4g}, '
                f'from there {fit.cached.plan.value:.4g}') if fit.joined else ''
        return self._reporter.departing(Departure(
            str(uuid4()), self._count, pending.call, trip, parameters, fit.cached,
            fit.joined is not None, fit.cached.ends(trip), source, route, path,
            self._as_recorded(path, pending, parameters), self._displayed.markers,
            pending.begin_ns, leaving, fit.assessment, tight, note,
        ))

    def _as_recorded(self, path: Path, pending: _Pending,
                     parameters: NodeParameters) -> RecordedMessage:
        """Return a path as it is recorded: on its topic, or under the service that returns it."""
        name = '' if parameters.publish_path else f'{pending.call.name}/path'
        return self._publishers.as_recorded('path', path, name)

    def _path(self, rows: FloatArray, trip: Trip, stamp_ns: int | None = None) -> Path:
        """Return the message of a path from the pose of the start to that of the goal."""
        stamp = Time(nanoseconds=stamp_ns or self._now()).to_msg()
        header = Header(frame_id=trip.map.frame, stamp=stamp)
        return path_to_ros(rows, trip.start_pose.pose, trip.goal_pose.pose, header)

    def _refuse_unless_active(self) -> None:
        if self._ending:
            raise _shutting_down()
        if self._paused:
            raise NotActive(INACTIVE)

    def _review(self) -> None:
        """Assess the displayed plan; solve it again if it is stale and the node is active."""
        self._map_is_new = False
        after_resolve = None if self._paused else self.map_changed
        self._displayed.review(self._settings.current.replan_tolerance, after_resolve)

    def _follow(self) -> None:
        for each in self._under_way:
            with suppress(AmbushPlannerError):  # TF does not know where the robot is
                at = self._inputs.locate(each.request, each.departure.parameters.robot).start_pose
                seconds = Time.from_msg(at.header.stamp).nanoseconds / 1e9
                each.trip.watch(Sighting(*pose_from_ros(at.pose), seconds))
                if each.trip.progress > each.trip.tolerance:
                    self._record(each)
        self._retry()

    def _record(self, under_way: _UnderWay) -> None:
        if not under_way.recorded:
            under_way.recorded = True
            self._recordings.depart(under_way.departure, lambda: None)

    def _retry(self) -> None:
        """Try the undecided requests again."""
        undecided, self._undecided = self._undecided, []
        for each in undecided:
            self._departures.submit(partial(self._try, each), each.answer)

    def _prepare(self) -> None:
        with suppress(AmbushPlannerError):  # each caller gets the reason
            self._refuse_unless_active()
            parameters = self._settings.agreeing()
            robot = parameters.robot
            trip = self._inputs.locate(self._inputs.latest(robot), robot)
            known = self._continued_by(trip) or self._plans.fit(trip, parameters)
            if trip.moves and not known:
                self._plans.solve(_out_of_obstacle(trip, parameters), parameters, background=True)

    def _now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return self._clock.now().nanoseconds


def _destination(trip: Trip) -> Destination:
    return Destination((trip.map.frame, trip.robot), trip.goal_xy, trip.map.resolution,
                       trip.stops_xy)


def _out_of_obstacle(trip: Trip, parameters: NodeParameters) -> Trip:
    """Return the trip of a robot in the inflation of a costmap, from where it can drive out."""
    if not trip.moves or parameters.values['map.preset'] == 'alpha':
        return trip
    return replace(trip, start_xy=_clear_ground(trip.map, parameters).way_out(trip.start_xy))


def _clear_ground(newest: CurrentMap, parameters: NodeParameters) -> ClearGround:
    return ClearGround(newest, parameters.occupancy, parameters.planning.network)


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


def _shutting_down() -> SolveCancelled:
    return SolveCancelled('the planner is shutting down')
