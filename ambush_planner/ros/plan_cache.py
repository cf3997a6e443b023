# SPDX-License-Identifier: Apache-2.0
"""Plans are solved once and kept as long as they suit the newest map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
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
from .trip import Match, Trip, match

# Least spacing that is expected of a plan that is being solved [m].
_LEAST_SPACING = 0.1
# Maximum number of plans kept, and of the bytes that they take for each edge, and for each cell of
# the map that a plan was solved on.
_MAX_PLANS, _MAX_BYTES, _OF_EDGE, _OF_CELL = 32, 150_000_000, 1100, 1


@dataclass(frozen=True, eq=False)
class CachedPlan:
    """A plan with the trip and the parameters that it was solved for.

    Those of a first plan, which has a plain network and is then refined, are not the trip's.
    """

    plan: Plan
    trip: Trip
    parameters: NodeParameters
    ground: ChangedGround

    @property
    def is_first(self) -> bool:
        """Return whether the plan is to be refined."""
        return self.parameters is not self.trip.parameters

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

    def match(self, trip: Trip) -> Match:
        """Return how well the plan suits a trip; a goal that was moved stays the same."""
        if self.goal_was_moved and trip.goal_xy != self.trip.goal_xy:
            return Match.NONE
        return match(self.trip, trip, self.plan.spacing, self.plan.start_tolerance)

    def fit(self, trip: Trip) -> Fit | None:
        """Return how one can depart from a trip's own place, if at all."""
        found = self.match(trip)
        if found > Match.NEAR or not self._allows(trip):
            return None
        fits = found == Match.EXACT or self.ground.connects(trip.map, self.ends(trip))
        return Fit(self, trip) if fits else None

    def join(self, trip: Trip, at_any_value: bool) -> Fit | None:
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

    ``on_solved`` is called with each plan. Methods that solve raise what a closed ``gate`` refuses
    them with, and QueueFull if too many solves wait.
    """

    def __init__(self, gate: Gate, logger: RcutilsLogger) -> None:
        self._logger = logger
        self.on_solved: Callable[[CachedPlan], None] = lambda _: None
        self._plans: list[CachedPlan] = []  # the least recently used one first
        self._lock = RLock()
        self._losses = LatestLosses()
        self.queue: SolveQueue[Trip, CachedPlan] = SolveQueue(
            gate.check, lambda error: logger.warning(f'a plan was not refined: {error}'))

    def fit(self, trip: Trip, at_any_value: bool = False) -> Fit | None:
        """Return the nearest plan that suits a trip, else the nearest one that can be joined.

        ``at_any_value``: even if joining it raises the value much.
        """
        with self._lock:
            suiting = sorted((each for each in self._plans if each.match(trip) != Match.NONE),
                             key=lambda one: one.trip.distance(trip))
            near = [each for each in suiting if trip.robot and each.trip.goal_xy == trip.goal_xy]
            tries = chain((each.fit(trip) for each in suiting),
                          (each.join(trip, at_any_value) for each in near[:1]))
            fit = next(filter(None, tries), None)
            if fit is not None:
                self._keep(fit.cached)
            return fit

    def share_or_solve(self, trip: Trip) -> Future[CachedPlan]:
        """Share a solve for nearly this trip that waits or runs, or solve; check that it fits."""
        with self._lock:
            suiting = (each for each in self.queue.keys if _will_suit(each, trip))
            return self.solve(next(suiting, trip))

    def solve(self, trip: Trip, *, background: bool = False) -> Future[CachedPlan]:
        """Solve for exactly this trip.

        If the network is to be refined and no refined plan is known, on whichever map, the outcome
        is a first plan, which is then refined. A refinement and a ``background`` solve have no
        callers: the next solve that has one ends them.
        """
        parameters, grid = trip.parameters, trip.map
        wanted = [parameters]
        with self._lock:
            known = next((each for each in self._plans if each.match(trip) == Match.EXACT), None)
            if is_graded(parameters.planning) and (known is None or known.is_first):
                wanted.insert(0, parameters.with_plain_network(len(trip.stops_xy) + 1))
            similar = known if known and known.trip.map is not trip.map else None
            request = PlanRequest(
                # Without the message that the map came in.
                OccupancyMap(grid.values, grid.resolution, grid.origin), parameters.occupancy,
                trip.start_xy, *trip.goal_and_tolerance, parameters.planning, trip.stops_xy,
                WarmStart.of(similar.plan.trip) if similar else None,
                wanted[0].planning if len(wanted) > 1 else None)
            return self.queue.submit(trip, request, partial(self._solved, trip, iter(wanted)),
                                     background)

    def refine(self, first: CachedPlan) -> None:
        """Refine a first plan in the background, unless it is being refined or has been."""
        with self._lock:
            if first in self._plans:
                self.solve(first.trip, background=True)

    def adopt(self, plan: Plan, trip: Trip, parameters: NodeParameters) -> CachedPlan:
        """Keep a plan for a trip."""
        ground = ChangedGround(plan, trip.map, parameters.occupancy, self._losses)
        cached = CachedPlan(plan, trip, parameters, ground)
        with self._lock:
            self._keep(cached)
        return cached

    def keep_ground(self, newest: CurrentMap) -> None:
        """Drop the plans for other ground than this map's, and what others know of older maps."""
        with self._lock:
            self._plans = [each for each in self._plans if each.trip.map.same_ground(newest)]
            for each in self._plans:
                each.ground.forget_all_but(newest)

    def _solved(self, trip: Trip, wanted: Iterator[NodeParameters], plan: Plan) -> CachedPlan:
        """Keep the plan; this happens before the future of its solve is done.

        A first plan that is known and as good stays: robots may be on their way on it.
        """
        parameters = next(wanted)
        with self._lock:
            known = next((each for each in self._plans if each.trip == trip), None)
        if known and parameters is not trip.parameters and known.plan.value <= plan.value:
            return known
        cached = self.adopt(plan, trip, parameters)
        self._logger.info(f'plan solved in {plan.seconds:.2f} s: value {plan.value:.6g}, '
                          f'{len(plan.network.points)} nodes')
        self.on_solved(cached)
        return cached

    def _keep(self, cached: CachedPlan) -> None:
        """Make a plan the most recently used one, and drop the oldest beyond the limits."""
        others = [each for each in self._plans if each.match(cached.trip) != Match.EXACT]
        taken = np.cumsum([
            _OF_EDGE * len(each.plan.network.edges) + _OF_CELL * each.trip.map.values.size
            for each in (cached, *reversed(others))])
        kept = min(_MAX_PLANS, max(1, int((taken <= _MAX_BYTES).sum())))
        self._plans = [*others, cached][-kept:]


def _will_suit(solved: Trip, trip: Trip) -> bool:
    """Return whether a plan that is being ``solved`` for a trip will probably suit another one."""
    planning = trip.parameters.planning
    # The planner chooses a spacing that is at least the map's resolution.
    spacing = planning.network.spacing or max(trip.map.resolution, _LEAST_SPACING)
    limit = solved.parameters.planning.strategy.time_limit
    return (match(solved, trip, spacing, start_tolerance(planning, spacing)) != Match.NONE
            and limit == planning.strategy.time_limit)
