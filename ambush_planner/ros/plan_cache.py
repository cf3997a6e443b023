"""Plans are solved once and kept as long as they suit the newest map."""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from threading import RLock

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..planning.cell_losses import LatestLosses
from ..planning.changed_ground import Assessment, ChangedGround
from ..planning.moved_start import REGION, JoinedPlan, joined_plan
from ..planning.node_parameters import NodeParameters
from ..planning.options import start_tolerance
from ..planning.plan import Plan, PlanRequest
from ..planning.solving import WarmStart
from ..worker.solve_queue import SolveQueue
from .current_map import CurrentMap
from .inputs import Trip

# Number of plans kept: there and back, and a detour each.
_CAPACITY = 4
# How many plans that are costly to join are evaluated for a convoy that cannot wait.
_MOST_COSTLY = 2
# How many plans are kept of those that were solved in the background, such as ahead of a convoy.
_MOST_BACKGROUND = 2
_Position = tuple[float, float]


@dataclass(frozen=True, eq=False)
class CachedPlan:
    """A plan with the trip and the parameters that it was solved for, perhaps in the background."""

    plan: Plan
    trip: Trip
    parameters: NodeParameters
    ground: ChangedGround
    background: bool = False

    def ends(self, trip: Trip) -> tuple[_Position, _Position]:
        """Return where a route for this trip begins and ends [m]: a blocked goal was moved."""
        return trip.start_xy, self.plan.goal_xy if self.goal_was_moved else trip.goal_xy

    @property
    def goal_was_moved(self) -> bool:
        """Whether the goal was blocked and has been moved."""
        return self.plan.goal_xy != self.trip.goal_xy

    def suits(self, trip: Trip, parameters: NodeParameters) -> bool:
        """Whether one can depart on this plan for a trip that may differ a little."""
        if not trip.map.same_ground(self.trip.map) or not self._is_for(trip, parameters):
            return False
        if self.goal_was_moved and _goal(self.trip) != _goal(trip):
            return False
        distance = _distance(self.trip, trip)
        if distance > self.plan.start_tolerance:
            return False
        if not self._allows_departure(trip, parameters):
            return False
        return distance == 0.0 or self._connects(trip)

    def fit(self, trip: Trip, parameters: NodeParameters, under_way: bool) -> Fit | None:
        """Return how one can depart on this plan for a trip, if at all.

        For a convoy ``under_way`` the plan can be worse than ``strategy.max_gap`` allows.
        """
        if self.suits(trip, parameters):
            return Fit(self, trip)
        joined = self._joined(trip, parameters, under_way)
        return Fit(self, trip, joined) if joined else None

    def _joined(self, trip: Trip, parameters: NodeParameters,
                under_way: bool) -> JoinedPlan | None:
        """Return the plan from where a convoy that moves is now, if its routes can be joined."""
        if not (trip.moves and trip.map.same_ground(self.trip.map)
                and self._is_for(trip, parameters) and _goal(self.trip) == _goal(trip)):
            return None
        if not (under_way or self._allows_departure(trip, parameters)):
            return None
        return joined_plan(self.ground, trip.map, self.ends(trip))

    def answers(self, trip: Trip, parameters: NodeParameters) -> bool:
        """Whether the plan is for exactly this trip, perhaps on another map."""
        return (self.trip.start_xy == trip.start_xy
                and _goal(self.trip) == _goal(trip)
                and self._is_for(trip, parameters))

    def _allows_departure(self, trip: Trip, parameters: NodeParameters) -> bool:
        assessment = self.ground.assess(trip.map)
        return assessment.allows_departure(parameters.max_gap, self.plan.strategy.gap)

    def _is_for(self, trip: Trip, parameters: NodeParameters) -> bool:
        return _conditions(self.trip, self.parameters) == _conditions(trip, parameters)

    def _connects(self, trip: Trip) -> bool:
        """Whether all first and last edges in use can be driven from the start and to the goal.

        All of them: whether the plan suits must not depend on the route that is drawn.
        """
        network, p = self.plan.network, self.plan.strategy.edge_probability
        visits = [network.source, *network.stops.tolist(), network.target]
        if len(set(network.places[visits].tolist())) < len(visits):
            return False  # a place visited twice cannot be moved for one visit only
        start, goal = self.ends(trip)
        if any(one == other for one, other in pairwise((start, *self.plan.stops_xy, goal))):
            return False  # the solve will refuse it
        clear = (p > 0.0) & ~self.ground.lost(trip.map)
        first = clear & (network.tails == network.source)
        last = clear & (network.heads == network.target)
        places = network.points.copy()
        places[[network.source, network.target]] = start, goal
        if (places[network.tails] == places[network.heads])[first | last].all(axis=1).any():
            return False  # a step of length 0 has no direction
        # Start and goal separately: the rectangle around both may be the whole map.
        return all(
            self.ground.clear(places[network.tails[edges]], places[network.heads[edges]],
                              trip.map).all()
            for edges in (first, last)
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """A plan that one can depart on for a trip: as it is, or ``joined`` from where the convoy is.

    ``late_by`` is the distance of the convoy from the start of the trip, which is where it was when
    it asked [m].
    """

    cached: CachedPlan
    trip: Trip
    joined: JoinedPlan | None = None
    late_by: float = 0.0

    @property
    def plan(self) -> Plan:
        """The plan that routes are drawn from."""
        return self.joined.plan if self.joined else self.cached.plan

    @property
    def assessment(self) -> Assessment:
        """What a departure is worth on the trip's map."""
        return self.joined.assessment if self.joined else self.cached.ground.assess(self.trip.map)

    @property
    def note(self) -> str:
        """A remark about the start for the response and the diagnostics; '' if there is none."""
        worth = f'value {self.assessment.value:.4g}, bound {self.assessment.lower_bound:.4g}'
        if self.late_by:
            return ('the path begins where the convoy was at the request, '
                    f'{self.late_by:.3g} m away, because no clear way to the routes leads from '
                    f'where it is now: {worth}')
        return f'the path joins the route of an earlier start: {worth}' if self.joined else ''


@dataclass(frozen=True, eq=False)
class _Pending:
    """A solve that waits or runs."""

    trip: Trip
    parameters: NodeParameters
    solve: Future[CachedPlan]
    background: bool


class PlanCache:
    """Plans by trip and parameters: kept, or solved in the worker process; thread-safe."""

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._plans: list[CachedPlan] = []  # the least recently used one first
        self._pending: list[_Pending] = []
        self._lock = RLock()
        self._queue: SolveQueue[CachedPlan] = SolveQueue()
        self._losses = LatestLosses()

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits."""
        return self._queue.busy

    def fit_or_solve(self, trip: Trip, parameters: NodeParameters,
                     under_way: bool) -> Fit | Future[CachedPlan]:
        """Return the nearest plan that suits the trip, or can be joined at little cost, or a solve.

        Joining must not raise the value by more than ``strategy.max_gap``. A convoy ``under_way``
        takes the cheaper of the two nearest plans that it can join, however high the value.
        A solve for nearly this trip that waits or runs is shared; check that its plan ``suits``.
        Raises SolveCancelled if the cache is closed, and QueueFull if too many solves wait.
        """
        with self._lock:
            costly = []
            for each in sorted(self._plans, key=lambda one: _distance(one.trip, trip)):
                if (fit := each.fit(trip, parameters, under_way)) is None:
                    continue
                most = (1.0 + parameters.max_gap) * each.plan.strategy.value
                if not fit.joined or fit.assessment.value <= most:
                    self._keep(each)
                    return fit
                costly.append(fit)
                if under_way and len(costly) == _MOST_COSTLY:
                    break
            if costly and under_way:
                best = min(costly, key=lambda fit: fit.assessment.value)
                self._keep(best.cached)
                return best
            for pending in self._pending:
                if not pending.solve.done() and _will_suit(pending, trip, parameters):
                    return self._submit(pending.trip, pending.parameters, background=False)
            return self._submit(trip, parameters, background=False)

    def solve(self, trip: Trip, parameters: NodeParameters, *,
              background: bool = False) -> Future[CachedPlan]:
        """Solve for exactly this trip; raises as ``fit_or_solve`` does.

        A ``background`` solve gives way to solves that somebody waits for, and to the next
        background solve.
        """
        with self._lock:
            return self._submit(trip, parameters, background)

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

    def _submit(self, trip: Trip, parameters: NodeParameters,
                background: bool) -> Future[CachedPlan]:
        request = _request(trip, parameters, self._warm_start(trip, parameters))
        solve = self._queue.submit(_key(trip, parameters), request,
                                   partial(self._solved, trip, parameters, background),
                                   parameters.queue_size, background)
        if all(each.solve is not solve for each in self._pending):
            self._pending.append(_Pending(trip, parameters, solve, background))
            solve.add_done_callback(self._remove_pending)
        return solve

    def _warm_start(self, trip: Trip, parameters: NodeParameters) -> WarmStart | None:
        """Return the multipliers of a plan for the same trip on an earlier map, if any."""
        for each in reversed(self._plans):
            multipliers = each.plan.strategy.multipliers
            other_map = each.trip.map is not trip.map
            if multipliers is not None and other_map and each.answers(trip, parameters):
                return WarmStart(each.plan.network, multipliers)
        return None

    def _solved(self, trip: Trip, parameters: NodeParameters, background: bool,
                plan: Plan) -> CachedPlan:
        """Keep the plan; this happens before the future of its solve is done."""
        ground = ChangedGround(plan, trip.map, parameters.occupancy, self._losses)
        cached = CachedPlan(plan, trip, parameters, ground, background)
        with self._lock:
            self._keep(cached)
        self._logger.info(f'plan solved in {plan.seconds:.2f} s: value {plan.strategy.value:.6g}, '
                          f'{len(plan.network.points)} nodes')
        return cached

    def _remove_pending(self, solve: Future[CachedPlan]) -> None:
        with self._lock:
            self._pending = [each for each in self._pending if each.solve is not solve]

    def _keep(self, cached: CachedPlan) -> None:
        others = [each for each in self._plans
                  if not each.answers(cached.trip, cached.parameters)]
        background = [each for each in others if each.background]
        if cached.background and len(background) >= _MOST_BACKGROUND:
            others.remove(background[0])
        self._plans = [*others, cached][-_CAPACITY:]


def _distance(one: Trip, other: Trip) -> float:
    """Return the distance of the starts or of the goals of two trips [m], the larger one."""
    return max(math.dist(one.start_xy, other.start_xy), math.dist(one.goal_xy, other.goal_xy))


def _will_suit(pending: _Pending, trip: Trip, parameters: NodeParameters) -> bool:
    """Whether the plan of a pending solve will probably suit a trip."""
    other, used = pending.trip, pending.parameters
    # If the planner chooses the spacing, it is at least the map's resolution.
    spacing = parameters.planning.network.spacing or trip.map.resolution
    near = _distance(other, trip) <= start_tolerance(parameters.planning, spacing)
    if trip.moves and not pending.background and _goal(other) == _goal(trip):
        near = near or math.dist(other.start_xy, trip.start_xy) <= REGION * spacing
    return (trip.map.same_ground(other.map)
            and _conditions(other, used) == _conditions(trip, parameters)
            and used.planning.strategy.time_limit == parameters.planning.strategy.time_limit
            and other.goal_tolerance == trip.goal_tolerance and near)


def _goal(trip: Trip) -> tuple[_Position, float]:
    return trip.goal_xy, trip.goal_tolerance


def _conditions(trip: Trip, parameters: NodeParameters) -> tuple[object, ...]:
    """Return what a plan depends on, except for its map and ends and the limits of its solve."""
    strategy = replace(parameters.planning.strategy, time_limit=math.inf)
    planning = replace(parameters.planning, strategy=strategy, max_gap=0.0)
    order = parameters.trip_order if len(trip.stops_xy) > 1 else ''
    return trip.stops_xy, order, parameters.occupancy, planning


def _key(trip: Trip, parameters: NodeParameters) -> tuple[object, ...]:
    """Return the key by which equal solves are shared."""
    limits = parameters.planning.strategy.time_limit, parameters.max_gap
    return trip.map, trip.start_xy, _goal(trip), _conditions(trip, parameters), limits


def _request(trip: Trip, parameters: NodeParameters, warm: WarmStart | None) -> PlanRequest:
    return PlanRequest(trip.map.values, trip.map.resolution, trip.map.origin, parameters.occupancy,
                       trip.start_xy, trip.goal_xy, trip.goal_tolerance, parameters.planning,
                       trip.stops_xy, parameters.trip_order, warm)
