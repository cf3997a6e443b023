"""Plans are worked out once and kept; randomness is made anew for every departure."""

from __future__ import annotations

import math
import secrets
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import replace
from threading import Lock

from ..core.planner import Plan, PlanRequest
from ..worker.solve_queue import SolveQueue
from .inputs import MapInForce, Trip
from .parameters import NodeParameters

# There and back again, with a detour or two.
_KEPT = 4


class Plans:
    """Plans by what they follow from: kept, or worked out in the worker process.

    Safe to be used from several threads.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple, Plan] = OrderedDict()
        self._map: MapInForce | None = None
        self._lock = Lock()
        self._solves = SolveQueue()

    @property
    def solving(self) -> bool:
        """Whether a solve runs or waits."""
        return self._solves.busy

    def find(self, trip: Trip, parameters: NodeParameters) -> Plan | None:
        """Return the plan for exactly these inputs, if it is kept."""
        key = _key(trip, parameters)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def solve(self, trip: Trip, parameters: NodeParameters) -> Future[Plan]:
        """Have the plan worked out anew, and kept.

        Raises
        ------
        SolveCancelled
            The plans are closed.
        """
        # Whoever allows another time waits for another solve.
        key = (_key(trip, parameters), parameters.planning.strategy.time_limit)
        solve = self._solves.submit(key, _request(trip, parameters))
        solve.add_done_callback(lambda done: self._keep(trip, parameters, done))
        return solve

    def forget_others(self, map_in_force: MapInForce) -> None:
        """Keep the plans of this map only: one that was replaced comes back as another one."""
        with self._lock:
            self._map = map_in_force
            for key in [key for key in self._kept if key[0] is not map_in_force]:
                del self._kept[key]

    def cancel(self) -> bool:
        """End the solve that runs; return whether there was one."""
        return self._solves.cancel()

    def close(self) -> None:
        """End all solves and the worker process."""
        self._solves.close()

    def _keep(self, trip: Trip, parameters: NodeParameters, solve: Future[Plan]) -> None:
        if solve.exception() is not None:
            return
        key = _key(trip, parameters)
        with self._lock:
            # The map may have been replaced during the solve.
            if trip.map is self._map:
                self._kept[key] = solve.result()
                self._kept.move_to_end(key)
                if len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)


def route_entropy_source(seed: int, departure: int) -> list[int]:
    """Return what the generator of one departure is made from.

    With seed -1 these are 256 bits from the operating system. With a fixed seed they follow from
    the departure's number, so that the same sequence of departures gives the same routes and each
    can be drawn again on its own. Nothing else goes in: no time, no input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, departure]


def _key(trip: Trip, parameters: NodeParameters) -> tuple:
    planning = parameters.planning
    # How long a solve may take does not change the plan.
    strategy = replace(planning.strategy, time_limit=math.inf)
    return (
        trip.map, trip.start_xy, trip.goal_xy, trip.goal_tolerance,
        parameters.occupancy, planning.network, planning.game, strategy,
    )


def _request(trip: Trip, parameters: NodeParameters) -> PlanRequest:
    return PlanRequest(
        trip.map.values,
        trip.map.resolution,
        trip.map.origin,
        parameters.occupancy,
        trip.start_xy,
        trip.goal_xy,
        trip.goal_tolerance,
        parameters.planning,
    )
