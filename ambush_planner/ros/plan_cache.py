"""Plans are worked out once and kept as long as they hold on the newest map."""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from threading import RLock

from rclpy.impl.rcutils_logger import RcutilsLogger

from ..planning.changed_ground import ChangedGround
from ..planning.node_parameters import NodeParameters
from ..planning.plan import Plan, PlanRequest, WarmStart
from ..worker.solve_queue import SolveQueue
from .current_map import CurrentMap
from .inputs import Trip
from .serial_executor import done

# There and back again, with a detour or two.
_KEPT = 4
_Position = tuple[float, float]


@dataclass(frozen=True, eq=False)
class CachedPlan:
    """A plan with the trip and the parameters that it was worked out for."""

    plan: Plan
    trip: Trip
    parameters: NodeParameters
    ground: ChangedGround

    def ends(self, trip: Trip) -> tuple[_Position, _Position]:
        """Where a route for this trip begins and ends [m]: a blocked goal has been moved."""
        return trip.start_xy, self.plan.goal_xy if self.moved else trip.goal_xy

    @property
    def moved(self) -> bool:
        """Whether the goal was blocked, and has been moved."""
        return self.plan.goal_xy != self.trip.goal_xy


@dataclass(frozen=True, eq=False)
class _Pending:
    """A solve that waits or runs."""

    trip: Trip
    parameters: NodeParameters
    solve: Future[CachedPlan]


class PlanCache:
    """Plans by what they follow from: kept, or worked out in the worker process.

    Safe to be used from several threads.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._kept: list[CachedPlan] = []  # the one used last is the last
        self._pending: list[_Pending] = []
        self._lock = RLock()
        self._solves: SolveQueue[CachedPlan] = SolveQueue()

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits."""
        return self._solves.busy

    def find(self, trip: Trip, parameters: NodeParameters) -> CachedPlan | None:
        """Return the kept plan that is good for the trip, the nearest one, if there is any."""
        with self._lock:
            good = [held for held in self._kept if usable(held, trip, parameters)]
            if not good:
                return None
            nearest = min(reversed(good), key=lambda held: _apart(held.trip, trip))
            self._keep(nearest)
            return nearest

    def plan_for(self, trip: Trip, parameters: NodeParameters) -> Future[CachedPlan]:
        """Return a plan for the trip that is kept by now, or else will be.

        A solve for nearly this trip that waits or runs already is shared: look whether its plan is
        ``usable``.

        Raises
        ------
        SolveCancelled
            The plans are closed.
        QueueFull
            Too many solves wait already.
        """
        with self._lock:
            if (held := self.find(trip, parameters)) is not None:
                return done(lambda: held)
            for each in self._pending:
                if not each.solve.done() and _near(each, trip, parameters):
                    return self._submit(each.trip, each.parameters, background=False)
            return self._submit(trip, parameters, background=False)

    def solve(
        self, trip: Trip, parameters: NodeParameters, *, background: bool = False
    ) -> Future[CachedPlan]:
        """Have the plan worked out anew, for exactly this trip; raises as ``plan_for`` does.

        One in the ``background`` gives way to solves that somebody waits for, and to the next one
        of its kind.
        """
        with self._lock:
            return self._submit(trip, parameters, background)

    def keep_ground(self, newest: CurrentMap) -> None:
        """Forget the plans that are not of this map's ground."""
        with self._lock:
            self._kept = [held for held in self._kept if held.trip.map.same_ground(newest)]

    def withdraw(self, solve: Future[CachedPlan]) -> None:
        """Tell that one of those who asked for a solve no longer waits for it."""
        self._solves.withdraw(solve)

    def withdraw_background(self) -> None:
        """Withdraw what waits in the background."""
        self._solves.withdraw_background()

    def cancel(self) -> int:
        """End the solve that runs and all that wait; return how many there were."""
        return self._solves.cancel()

    def close(self) -> None:
        """End all solves and the worker process."""
        self._solves.close()

    def _submit(
        self, trip: Trip, parameters: NodeParameters, background: bool
    ) -> Future[CachedPlan]:
        solve = self._solves.submit(
            _key(trip, parameters),
            _request(trip, parameters, self._warm_start(trip, parameters)),
            partial(self._solve_ended, trip, parameters),
            parameters.queue_size,
            background,
        )
        if all(each.solve is not solve for each in self._pending):
            self._pending.append(_Pending(trip, parameters, solve))
            solve.add_done_callback(self._no_longer_pending)
        return solve

    def _warm_start(self, trip: Trip, parameters: NodeParameters) -> WarmStart | None:
        """The law of a plan that answers the same question on an earlier map, if there is one."""
        for held in reversed(self._kept):
            multipliers = held.plan.strategy.multipliers
            other_map = held.trip.map is not trip.map
            if multipliers is not None and other_map and _asks(held, trip, parameters):
                return WarmStart(held.plan.network.points, multipliers)
        return None

    def _solve_ended(self, trip: Trip, parameters: NodeParameters, plan: Plan) -> CachedPlan:
        """Keep the plan before anybody is told: whoever asks from now on finds it."""
        ground = ChangedGround(plan, trip.map, parameters.occupancy)
        held = CachedPlan(plan, trip, parameters, ground)
        with self._lock:
            self._keep(held)
        self._logger.info(
            f'plan solved in {plan.seconds:.2f} s: value {plan.strategy.value:.6g}, '
            f'{len(plan.network.points)} nodes'
        )
        return held

    def _no_longer_pending(self, solve: Future[CachedPlan]) -> None:
        with self._lock:
            self._pending = [each for each in self._pending if each.solve is not solve]

    def _keep(self, held: CachedPlan) -> None:
        others = [each for each in self._kept if not _asks(each, held.trip, held.parameters)]
        self._kept = [*others, held][-_KEPT:]


def usable(held: CachedPlan, trip: Trip, parameters: NodeParameters) -> bool:
    """Whether somebody can depart on a plan for a trip that may be a little different."""
    if not trip.map.same_ground(held.trip.map) or not _alike(held.parameters, parameters):
        return False
    if held.moved and _goal(held.trip) != _goal(trip):
        return False
    if _by_way_of(held.trip, held.parameters) != _by_way_of(trip, parameters):
        return False
    apart = _apart(held.trip, trip)
    if apart > _tolerance(parameters, held.plan.spacing):
        return False
    standing = held.ground.standing(trip.map)
    if not standing.fit_to_depart(parameters.max_gap, held.plan.strategy.gap):
        return False
    return apart == 0.0 or _connected(held, trip)


def _apart(one: Trip, other: Trip) -> float:
    """How far apart the starts or the goals of two trips are [m], whichever is more."""
    return max(
        math.dist(one.start_xy, other.start_xy), math.dist(one.goal_xy, other.goal_xy)
    )


def _tolerance(parameters: NodeParameters, spacing: float) -> float:
    """How far start and goal may be from those that a plan is for [m].

    Never more than half the distance of nodes.
    """
    return min(parameters.start_tolerance, 0.5 * spacing)


def _asks(held: CachedPlan, trip: Trip, parameters: NodeParameters) -> bool:
    """Whether a plan answers the same question: of another map, perhaps."""
    return (
        held.trip.start_xy == trip.start_xy
        and _goal(held.trip) == _goal(trip)
        and _by_way_of(held.trip, held.parameters) == _by_way_of(trip, parameters)
        and _alike(held.parameters, parameters)
    )


def _near(pending: _Pending, trip: Trip, parameters: NodeParameters) -> bool:
    """Whether what is being solved will probably do for a trip."""
    other, used = pending.trip, pending.parameters
    # Where the distance of nodes is chosen by the planner, it is no less than this.
    spacing = parameters.planning.network.spacing or trip.map.resolution
    limits = (each.planning.strategy.time_limit for each in (used, parameters))
    return (
        trip.map.same_ground(other.map)
        and _alike(used, parameters)
        and len(set(limits)) == 1  # another time limit is another solve
        and other.goal_tolerance == trip.goal_tolerance
        and _by_way_of(other, used) == _by_way_of(trip, parameters)
        and _apart(other, trip) <= _tolerance(parameters, spacing)
    )


def _goal(trip: Trip) -> tuple[_Position, float]:
    return trip.goal_xy, trip.goal_tolerance


def _by_way_of(trip: Trip, parameters: NodeParameters) -> tuple[tuple[_Position, ...], str]:
    """The stops, which are met exactly, and how their order is chosen, where there is a choice."""
    return trip.stops_xy, parameters.trip_order if len(trip.stops_xy) > 1 else ''


def _connected(held: CachedPlan, trip: Trip) -> bool:
    """Whether each first and each last edge in use can be driven from start and to goal as asked.

    All of them: whether a route can be used must not depend on which one is drawn.
    """
    network, p = held.plan.network, held.plan.strategy.edge_probability
    visits = [network.source, *network.stops.tolist(), network.target]
    if len({node % network.place_count for node in visits}) < len(visits):
        return False  # a place that is visited again cannot be moved for one visit only
    start, goal = held.ends(trip)
    if any(one == other for one, other in pairwise((start, *held.plan.stops_xy, goal))):
        return False  # refused where it is solved
    left = (p > 0.0) & ~held.ground.lost(trip.map)
    first, last = left & (network.tails == network.source), left & (network.heads == network.target)
    places = network.points.copy()
    places[[network.source, network.target]] = start, goal
    if (places[network.tails] == places[network.heads])[first | last].all(axis=1).any():
        return False  # a step to where one is has no direction
    # One after the other: the ground that both lie on may be the whole map.
    return all(
        held.ground.clear(places[network.tails[steps]], places[network.heads[steps]], trip.map)
        for steps in (first, last)
    )


def _alike(one: NodeParameters, other: NodeParameters) -> bool:
    """Whether the same plan follows from the parameters; nearly always they are the same ones."""
    return one is other or _options(one) == _options(other)


def _options(parameters: NodeParameters) -> tuple[object, ...]:
    planning = parameters.planning
    # How long a solve may take does not change the plan, nor does what is made of it then.
    strategy = replace(planning.strategy, time_limit=math.inf)
    return parameters.occupancy, replace(planning, strategy=strategy, max_gap=0.0)


def _key(trip: Trip, parameters: NodeParameters) -> tuple[object, ...]:
    limit = parameters.planning.strategy.time_limit, parameters.max_gap
    where = trip.map, trip.start_xy, trip.goal_xy, trip.goal_tolerance
    return *where, *_by_way_of(trip, parameters), *_options(parameters), *limit


def _request(trip: Trip, parameters: NodeParameters, warm: WarmStart | None) -> PlanRequest:
    return PlanRequest(
        trip.map.values,
        trip.map.resolution,
        trip.map.origin,
        parameters.occupancy,
        trip.start_xy,
        trip.goal_xy,
        trip.goal_tolerance,
        parameters.planning,
        trip.stops_xy,
        parameters.trip_order,
        warm,
    )
