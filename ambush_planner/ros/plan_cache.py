# SPDX-License-Identifier: Apache-2.0
"""Plans are solved once and kept as long as they suit the newest map."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from threading import RLock

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger

from ..maps.occupancy import OccupancyMap
from ..parameters.values import NodeParameters
from ..planning.cell_losses import LatestLosses
from ..planning.changed_ground import Assessment, ChangedGround
from ..planning.departure import DrawnRoute, draw_route
from ..planning.moved_start import JoinedPlan, joined_plan
from ..planning.options import is_graded, start_tolerance
from ..planning.plan import Plan, PlanRequest
from ..planning.solving import WarmStart
from ..routes.driven_path import Ends
from ..worker.solve_queue import SolveQueue
from .current_map import CurrentMap
from .gate import Gate
from .trip import Suits, Trip, how

# Least spacing that is expected of a plan that is being solved [m].
_LEAST_SPACING = 0.1
# Maximum number of plans kept, and of the bytes that they take for each edge, and for each cell of
# the map that a plan was solved on.
_MAX_PLANS, _MAX_BYTES, _OF_EDGE, _OF_CELL = 32, 150_000_000, 1100, 1


@dataclass(frozen=True, eq=False)
class Task:
    """The task that a plan is solved for; equal if the plans are the same.

    The ``first`` plan of a trip has a plain network, which is then to be refined.
    """

    trip: Trip
    first: bool = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Task) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[object, ...]:
        trip, planning = self.trip, self.trip.parameters.planning
        limits = planning.strategy.time_limit, planning.max_gap, planning.network.refine
        return trip.map, trip.start_xy, trip.goal_and_tolerance, trip.conditions, limits, self.first

    @cached_property
    def parameters(self) -> NodeParameters:
        """The parameters of the solve."""
        asked = self.trip.parameters
        legs = len(self.trip.stops_xy) + 1
        return asked.with_plain_network(legs) if self.first else asked

    def request(self, warm: WarmStart | None) -> PlanRequest:
        """Return what the worker is asked for."""
        trip, parameters = self.trip, self.parameters
        # Without the message that the map came in.
        grid = OccupancyMap(trip.map.values, trip.map.resolution, trip.map.origin)
        return PlanRequest(grid, parameters.occupancy, trip.start_xy, *trip.goal_and_tolerance,
                           parameters.planning, trip.stops_xy, warm)

    def will_suit(self, trip: Trip) -> bool:
        """Return whether the plan will probably suit a trip."""
        planning, limit = trip.parameters.planning, self.parameters.planning.strategy.time_limit
        # The planner chooses a spacing that is at least the map's resolution.
        spacing = planning.network.spacing or max(trip.map.resolution, _LEAST_SPACING)
        suits = how(self.trip, trip, spacing, start_tolerance(planning, spacing))
        return suits != Suits.NOT and limit == planning.strategy.time_limit


@dataclass(frozen=True, eq=False)
class CachedPlan:
    """A plan with the task that it was solved for."""

    plan: Plan
    task: Task
    ground: ChangedGround

    @property
    def trip(self) -> Trip:
        """The trip that the plan was solved for."""
        return self.task.trip

    @property
    def as_solved(self) -> Fit:
        """The plan as it fits its own trip."""
        return Fit(self, self.trip)

    @property
    def goal_was_moved(self) -> bool:
        """Return whether the goal was blocked and has been moved."""
        return self.plan.goal_xy != self.trip.goal_xy

    def ends(self, trip: Trip) -> Ends:
        """Return where routes for this trip begin and end [m]."""
        return trip.start_xy, self.plan.goal_xy if self.goal_was_moved else trip.goal_xy

    def how(self, trip: Trip) -> Suits:
        """Return how the plan suits a trip; a goal that was moved stays the same."""
        if self.goal_was_moved and trip.goal_xy != self.trip.goal_xy:
            return Suits.NOT
        return how(self.trip, trip, self.plan.spacing, self.plan.start_tolerance)

    def fit(self, trip: Trip) -> Fit | None:
        """Return how one can depart from a trip's own place, if at all."""
        suits = self.how(trip)
        if suits > Suits.NEARLY or not self._allows(trip):
            return None
        fits = suits == Suits.EXACTLY or self.ground.connects(trip.map, self.ends(trip))
        return Fit(self, trip) if fits else None

    def joined(self, trip: Trip, at_any_value: bool) -> Fit | None:
        """Return how a robot that has moved joins this plan from where it is, if at all.

        Unless ``at_any_value``, that must not raise the value by more than ``strategy.max_gap``. On
        roads it drives to the planned start.
        """
        if not self._allows(trip):
            return None
        if self.plan.options.network.roads:
            way = np.array([trip.start_xy]), np.array([self.trip.start_xy])
            clear = trip.ground.segments(*way)[0]
            return Fit(self, replace(trip, start_xy=self.trip.start_xy)) if clear else None
        joined = joined_plan(self.ground, trip.map, self.ends(trip))
        most = (1.0 + trip.parameters.planning.max_gap) * self.plan.value
        good = joined and (at_any_value or joined.assessment.value <= most)
        return Fit(self, trip, joined) if good else None

    def _allows(self, trip: Trip) -> bool:
        """Return whether one may depart on this plan on a trip's map and with its parameters."""
        return self.ground.assess(trip.map).allows_departure(
            trip.parameters.planning.max_gap, self.plan.trip.gap)


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
        """The assessment of a departure on the trip's map."""
        return self.joined.assessment if self.joined else self.cached.ground.assess(self.trip.map)

    @property
    def ends(self) -> Ends:
        """Return the places where routes begin and end [m]."""
        return self.cached.ends(self.trip)

    def draw(self, source: list[int]) -> DrawnRoute | None:
        """Draw a route that is clear on the trip's map; None if hardly any is."""
        return draw_route(self.plan, source, self.trip.parameters.values['route.path_spacing'],
                          self.ends, None if self.joined else self.cached.ground, self.trip.map)


class PlanCache:
    """Plans by trip: kept, or solved in the worker process; thread-safe.

    Methods that solve raise what a closed ``gate`` refuses them with, and QueueFull if too many
    solves wait.
    """

    def __init__(self, gate: Gate, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._plans: list[CachedPlan] = []  # the least recently used one first
        self._lock = RLock()
        self._losses = LatestLosses()
        self.queue: SolveQueue[Task, CachedPlan] = SolveQueue(gate.check)

    def fit(self, trip: Trip, at_any_value: bool = False) -> Fit | None:
        """Return the nearest plan that suits a trip, else the nearest one that can be joined.

        ``at_any_value``: even if joining it raises the value much.
        """
        with self._lock:
            suiting = sorted((each for each in self._plans if each.how(trip) != Suits.NOT),
                             key=lambda one: one.trip.distance(trip))
            near = [each for each in suiting if trip.robot and each.trip.goal_xy == trip.goal_xy]
            tries = chain((each.fit(trip) for each in suiting),
                          (each.joined(trip, at_any_value) for each in near[:1]))
            fit = next(filter(None, tries), None)
            if fit is not None:
                self._keep(fit.cached)
            return fit

    def share_or_solve(self, trip: Trip) -> Future[CachedPlan]:
        """Share a solve for nearly this trip that waits or runs, or solve; check that it fits."""
        with self._lock:
            suits = (task.trip for task in self.queue.keys if task.will_suit(trip))
            return self.solve(next(suits, trip))

    def solve(self, trip: Trip, *, background: bool = False) -> Future[CachedPlan]:
        """Solve for exactly this trip.

        If the network is to be refined and no refined plan is known, on whichever map, this is a
        first plan. A ``background`` solve is given up for the next one that somebody waits for.
        """
        with self._lock:
            known = next((each for each in self._plans if each.how(trip) == Suits.EXACTLY), None)
            first = is_graded(trip.parameters.planning) and (known is None or known.task.first)
            earlier = known if known and known.trip.map is not trip.map else None
            return self._submit(Task(trip, first), earlier, background)

    def refine(self, cached: CachedPlan) -> Future[CachedPlan]:
        """Solve again in the background, on a refined network.

        Nobody needs the plan soon, and the robot's programs need the processor.
        """
        return self._submit(Task(cached.trip), cached, background=True, low_priority=True)

    def adopt(self, task: Task, plan: Plan) -> CachedPlan:
        """Keep a plan for a task."""
        ground = ChangedGround(plan, task.trip.map, task.parameters.occupancy, self._losses)
        cached = CachedPlan(plan, task, ground)
        with self._lock:
            self._keep(cached)
        return cached

    def keep_ground(self, newest: CurrentMap) -> None:
        """Drop the plans for other ground than this map's, and what others know of older maps."""
        with self._lock:
            self._plans = [each for each in self._plans if each.trip.map.same_ground(newest)]
            for each in self._plans:
                each.ground.forget_all_but(newest)

    def _submit(self, task: Task, known: CachedPlan | None, background: bool,
                low_priority: bool = False) -> Future[CachedPlan]:
        """Solve, starting from a ``known`` plan for nearly the same."""
        warm = WarmStart.of(known.plan.trip) if known else None
        return self.queue.submit(task, task.request(warm), partial(self._solved, task),
                                 background, low_priority)

    def _solved(self, task: Task, plan: Plan) -> CachedPlan:
        """Keep the plan; this happens before the future of its solve is done."""
        cached = self.adopt(task, plan)
        self._logger.info(f'plan solved in {plan.seconds:.2f} s: value {plan.value:.6g}, '
                          f'{len(plan.network.points)} nodes')
        return cached

    def _keep(self, cached: CachedPlan) -> None:
        """Make a plan the most recently used one, and drop the oldest beyond the limits."""
        others = [each for each in self._plans if each.how(cached.trip) != Suits.EXACTLY]
        taken = np.cumsum([
            _OF_EDGE * len(each.plan.network.edges) + _OF_CELL * each.trip.map.values.size
            for each in (cached, *reversed(others))])
        kept = min(_MAX_PLANS, max(1, int((taken <= _MAX_BYTES).sum())))
        self._plans = [*others, cached][-kept:]
