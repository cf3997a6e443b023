# SPDX-License-Identifier: Apache-2.0
"""Plans are solved once and kept as long as they suit the newest map."""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from threading import RLock

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger

from ..arrays import FloatArray
from ..parameters.values import NodeParameters
from ..planning.cell_losses import LatestLosses
from ..planning.changed_ground import Assessment, ChangedGround
from ..planning.moved_start import REGION, JoinedPlan, joined_plan
from ..planning.options import is_graded, start_tolerance
from ..planning.plan import Plan, PlanRequest, Route, depart, departure_path
from ..planning.solving import WarmStart
from ..routes.driven_path import Ends
from ..worker.solve_queue import SolveQueue
from .current_map import CurrentMap
from .inputs import Trip

# Distance that a robot may drive and will probably join the plan that is being solved [m].
_JOINABLE = 1.0
# Maximum number of plans kept, and of the bytes that they take for each edge, and for each cell of
# the maps that a plan was solved and last assessed on, which are kept with their messages.
_MAX_PLANS, _MAX_BYTES, _OF_EDGE, _OF_CELL = 32, 330_000_000, 1100, 4


@dataclass(frozen=True, eq=False)
class CachedPlan:
    """A plan with the trip and the parameters that it was solved for.

    A first plan of a trip has a plain network, and ``refined_by`` are the parameters by which it is
    to be refined; None: it is not.
    """

    plan: Plan
    trip: Trip
    parameters: NodeParameters
    ground: ChangedGround
    refined_by: NodeParameters | None = None

    @property
    def asked(self) -> NodeParameters:
        """The parameters with which the plan was requested."""
        return self.refined_by or self.parameters

    def ends(self, trip: Trip) -> Ends:
        """Return where a route for this trip begins and ends [m]: a blocked goal was moved."""
        return trip.start_xy, self.plan.goal_xy if self.goal_was_moved else trip.goal_xy

    @property
    def bytes(self) -> int:
        """About what the plan takes in memory."""
        return _OF_EDGE * len(self.plan.network.edges) + _OF_CELL * self.trip.map.values.size

    @property
    def goal_was_moved(self) -> bool:
        """Whether the goal was blocked and has been moved."""
        return self.plan.goal_xy != self.trip.goal_xy

    def fit(self, trip: Trip, parameters: NodeParameters) -> Fit | None:
        """Return how one can depart on this plan for a trip that may differ a little, if at all."""
        if (_distance(self.trip, trip) > self.plan.start_tolerance
                or not self._serves(trip, parameters)
                or (self.goal_was_moved and _goal(self.trip) != _goal(trip))):
            return None
        same = _distance(self.trip, trip) == 0.0
        return Fit(self, trip) if same or self.ground.connects(trip.map, self.ends(trip)) else None

    def joined(self, trip: Trip, parameters: NodeParameters, at_any_value: bool) -> Fit | None:
        """Return how a robot that has moved joins this plan from where it is, if at all.

        Unless ``at_any_value``, that must not raise the value by more than ``strategy.max_gap``.
        """
        if not (self.is_near(trip) and self._serves(trip, parameters)):
            return None
        joined = joined_plan(self.ground, trip.map, self.ends(trip))
        most = (1.0 + parameters.planning.max_gap) * self.plan.strategy.value
        good = joined and (at_any_value or joined.assessment.value <= most)
        return Fit(self, trip, joined) if good else None

    def is_near(self, trip: Trip) -> bool:
        """Whether a trip is that of a robot near the start of this plan, to the same goal."""
        return (trip.moves and _goal(self.trip) == _goal(trip)
                and math.dist(self.trip.start_xy, trip.start_xy) <= REGION * self.plan.spacing)

    def answers(self, trip: Trip, parameters: NodeParameters) -> bool:
        """Whether the plan is for exactly this trip, perhaps on another map."""
        return (self.trip.start_xy == trip.start_xy
                and _goal(self.trip) == _goal(trip)
                and self._is_for(trip, parameters))

    def _serves(self, trip: Trip, parameters: NodeParameters) -> bool:
        """Whether one may depart on this plan on a trip's map and with these parameters."""
        return (trip.map.same_ground(self.trip.map) and self._is_for(trip, parameters)
                and self.ground.assess(trip.map).allows_departure(
                    parameters.planning.max_gap, self.plan.strategy.gap))

    def _is_for(self, trip: Trip, parameters: NodeParameters) -> bool:
        return _conditions(self.trip, self.asked) == _conditions(trip, parameters)


@dataclass(frozen=True, eq=False)
class Fit:
    """A plan that one can depart on for a trip: as it is, or ``joined`` from where the robot is."""

    cached: CachedPlan
    trip: Trip
    joined: JoinedPlan | None = None

    @property
    def plan(self) -> Plan:
        """The plan that routes are drawn from."""
        return self.joined.plan if self.joined else self.cached.plan

    @property
    def assessment(self) -> Assessment:
        """What a departure is worth on the trip's map."""
        return self.joined.assessment if self.joined else self.cached.ground.assess(self.trip.map)

    def draw(self, source: list[int], spacing: float) -> tuple[Route, FloatArray] | None:
        """Draw a route that is clear on the trip's map, and its path (L, 3) = (x, y, yaw).

        ``source`` seeds the random generator. Poses are at most ``spacing`` [m] apart; 0: as far as
        the plan says. None if hardly any route is clear.
        """
        rng, newest, plan = np.random.default_rng(source), self.trip.map, self.plan
        ground, ends = self.cached.ground, self.cached.ends(self.trip)
        route = depart(plan, rng) if self.joined else ground.draw(rng, newest)
        if route is None:
            return None
        fitted = plan if self.joined else ground.fitted(newest, ends)
        return route, departure_path(fitted, route, spacing or plan.spacing, ends)


@dataclass(frozen=True, eq=False)
class _Asked:
    """What a solve is for; equal if the plans are the same. ``refined_by`` is as in CachedPlan."""

    trip: Trip
    parameters: NodeParameters
    refined_by: NodeParameters | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Asked) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[object, ...]:
        planning, trip = self.parameters.planning, self.trip
        limits = planning.strategy.time_limit, planning.max_gap, planning.network.refine
        return (trip.map, trip.start_xy, _goal(trip), _conditions(trip, self.parameters), limits)

    def will_suit(self, trip: Trip, parameters: NodeParameters) -> bool:
        """Whether the plan will probably suit a trip."""
        other, used = self.trip, self.refined_by or self.parameters
        # If the planner chooses the spacing, it is at least the map's resolution.
        spacing = parameters.planning.network.spacing or trip.map.resolution
        joins = trip.moves and _goal(other) == _goal(trip)
        near = _distance(other, trip) <= (
            max(REGION * spacing, _JOINABLE) if joins
            else start_tolerance(parameters.planning, spacing))
        return (trip.map.same_ground(other.map)
                and _conditions(other, used) == _conditions(trip, parameters)
                and used.planning.strategy.time_limit == parameters.planning.strategy.time_limit
                and _goal(other)[1] == _goal(trip)[1] and near)


class PlanCache:
    """Plans by trip and parameters: kept, or solved in the worker process; thread-safe."""

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._plans: list[CachedPlan] = []  # the least recently used one first
        self._lock = RLock()
        self._queue: SolveQueue[_Asked, CachedPlan] = SolveQueue()
        self._losses = LatestLosses()
        self._refinement: Future[CachedPlan] | None = None

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits, other than one that refines a plan."""
        return self._queue.unfinished > self.refining

    @property
    def refining(self) -> bool:
        """Whether a plan is being refined, or waits for it."""
        return self._refinement is not None and not self._refinement.done()

    def fit(self, trip: Trip, parameters: NodeParameters,
            at_any_value: bool = False) -> Fit | None:
        """Return the nearest plan that suits a trip, else the nearest one that can be joined.

        ``at_any_value``: even if joining it raises the value much.
        """
        with self._lock:
            plans = sorted(self._plans, key=lambda one: _distance(one.trip, trip))
            near = [each for each in plans if each.is_near(trip)]
            tries = chain((each.fit(trip, parameters) for each in plans),
                          (each.joined(trip, parameters, at_any_value) for each in near[:1]))
            fit = next(filter(None, tries), None)
            if fit is not None:
                self._keep(fit.cached)
            return fit

    def share_or_solve(self, trip: Trip, parameters: NodeParameters) -> Future[CachedPlan]:
        """Share a solve for nearly this trip that waits or runs, or solve; check that it fits.

        Raises SolveCancelled if the cache is closed, and QueueFull if too many solves wait.
        """
        with self._lock:
            for asked in self._queue.keys:
                if asked.will_suit(trip, parameters):
                    return self.solve(asked.trip, asked.refined_by or asked.parameters)
            return self.solve(trip, parameters)

    def solve(self, trip: Trip, parameters: NodeParameters, *,
              background: bool = False) -> Future[CachedPlan]:
        """Solve for exactly this trip; raises as ``share_or_solve`` does.

        If the network is to be refined and no refined plan is known, this is a first plan. A
        ``background`` solve gives way to solves that somebody waits for, and to the next background
        solve.
        """
        with self._lock:
            known = self._similar(trip, parameters)
            first = is_graded(parameters.planning) and (
                known is None or known.refined_by is not None)
            warm = None if known is None else WarmStart.of(known.plan.strategy)
            return self._submit(trip, parameters, warm, background, first)

    def refine(self, cached: CachedPlan) -> Future[CachedPlan]:
        """Solve again in the background, on a refined network; raises as ``solve`` does.

        Nobody needs the plan soon, and the robot's programs need the processor.
        """
        with self._lock:
            warm = WarmStart.of(cached.plan.strategy)
            self._refinement = self._submit(cached.trip, cached.asked, warm, True, False,
                                            low_priority=True)
            return self._refinement

    def _submit(self, trip: Trip, parameters: NodeParameters, warm: WarmStart | None,
                background: bool, first: bool, low_priority: bool = False) -> Future[CachedPlan]:
        asked = (_Asked(trip, parameters.with_plain_network(), parameters) if first
                 else _Asked(trip, parameters))
        return self._queue.submit(asked, _request(trip, asked.parameters, warm),
                                  partial(self._solved, asked), parameters.queue_size, background,
                                  low_priority)

    def adopt(self, trip: Trip, parameters: NodeParameters, plan: Plan,
              refined_by: NodeParameters | None = None) -> CachedPlan:
        """Keep a plan that was made elsewhere."""
        ground = ChangedGround(plan, trip.map, parameters.occupancy, self._losses)
        cached = CachedPlan(plan, trip, parameters, ground, refined_by)
        with self._lock:
            self._keep(cached)
        return cached

    def keep_ground(self, newest: CurrentMap) -> None:
        """Drop the plans for other ground than this map's."""
        with self._lock:
            self._plans = [each for each in self._plans if each.trip.map.same_ground(newest)]

    def withdraw(self, solve: Future[CachedPlan]) -> None:
        """Take back one request for a solve."""
        self._queue.withdraw(solve)

    def withdraw_background(self) -> None:
        """Take back the background solve."""
        self._queue.withdraw_background()

    def cancel(self) -> int:
        """Cancel all solves, running and waiting; return their number."""
        return self._queue.cancel()

    def close(self) -> None:
        """Cancel all solves and end the worker process."""
        self._queue.close()

    def _similar(self, trip: Trip, parameters: NodeParameters) -> CachedPlan | None:
        """The newest plan for the same trip on an earlier map, if any."""
        for each in reversed(self._plans):
            if each.trip.map is not trip.map and each.answers(trip, parameters):
                return each
        return None

    def _solved(self, asked: _Asked, plan: Plan) -> CachedPlan:
        """Keep the plan; this happens before the future of its solve is done."""
        cached = self.adopt(asked.trip, asked.parameters, plan, asked.refined_by)
        self._logger.info(f'plan solved in {plan.seconds:.2f} s: value {plan.strategy.value:.6g}, '
                          f'{plan.network.place_count} nodes')
        return cached

    def _keep(self, cached: CachedPlan) -> None:
        """Make a plan the most recently used one, and drop the oldest beyond the limits."""
        others = [each for each in self._plans if not each.answers(cached.trip, cached.asked)]
        taken = np.cumsum([each.bytes for each in (cached, *reversed(others))])
        kept = min(_MAX_PLANS, max(1, int((taken <= _MAX_BYTES).sum())))
        self._plans = [*others, cached][-kept:]


def _distance(one: Trip, other: Trip) -> float:
    """Return the distance of the starts or of the goals of two trips [m], the larger one."""
    return max(math.dist(one.start_xy, other.start_xy), math.dist(one.goal_xy, other.goal_xy))


def _goal(trip: Trip) -> tuple[tuple[float, float], float]:
    return trip.goal_xy, trip.request.goal_tolerance


def _conditions(trip: Trip, parameters: NodeParameters) -> tuple[object, ...]:
    """What a plan depends on, except its map, its ends, how it is refined and how long it takes."""
    strategy = replace(parameters.planning.strategy, time_limit=math.inf)
    network = replace(parameters.planning.network, refine=0)
    planning = replace(parameters.planning, network=network, strategy=strategy, max_gap=0.0)
    order = parameters.trip_order if len(trip.stops_xy) > 1 else ''
    return trip.stops_xy, order, parameters.occupancy, planning


def _request(trip: Trip, parameters: NodeParameters, warm: WarmStart | None) -> PlanRequest:
    return PlanRequest(trip.map.values, trip.map.resolution, trip.map.origin, parameters.occupancy,
                       trip.start_xy, *_goal(trip), parameters.planning,
                       trip.stops_xy, parameters.trip_order, warm)
