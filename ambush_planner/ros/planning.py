"""Plans are worked out once and kept; randomness is made anew for every departure."""

from __future__ import annotations

import secrets
from collections import OrderedDict

from ..core.planner import Plan, PlanningOptions, plan
from .inputs import Trip

# There and back again, with a detour or two.
_KEPT = 4


class PlanCache:
    """The latest plans of the map in force, by start, goal and options."""

    def __init__(self) -> None:
        self._plans: OrderedDict[tuple, Plan] = OrderedDict()

    def find(self, trip: Trip, options: PlanningOptions) -> Plan | None:
        """Return the plan for exactly these inputs, if it is kept."""
        key = _key(trip, options)
        if key in self._plans:
            self._plans.move_to_end(key)
        return self._plans.get(key)

    def make(self, trip: Trip, options: PlanningOptions) -> Plan:
        """Work the plan out and keep it; raises what ``core.planner.plan`` raises."""
        made = plan(trip.map.risk_map, trip.start_xy, trip.goal_xy, options)
        for key in [key for key in self._plans if key[0] is not trip.map.risk_map]:
            del self._plans[key]
        key = _key(trip, options)
        self._plans[key] = made
        self._plans.move_to_end(key)
        if len(self._plans) > _KEPT:
            self._plans.popitem(last=False)
        return made


def route_entropy_source(seed: int, departure: int) -> list[int]:
    """Return what the generator of one departure is made from.

    With seed -1 these are 256 bits from the operating system. With a fixed seed they follow from
    the departure's number, so that the same sequence of departures gives the same routes and each
    can be drawn again on its own. Nothing else goes in: no time, no input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, departure]


def _key(trip: Trip, options: PlanningOptions) -> tuple:
    return trip.map.risk_map, trip.start_xy, trip.goal_xy, options
