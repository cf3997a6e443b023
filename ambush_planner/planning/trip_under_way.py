# SPDX-License-Identifier: Apache-2.0
"""The trip that the robot is on, and which requests continue it.

A request continues the trip, and is no departure, if all of this holds:

1. It is for the *same trip*: for the same robot, to the same goal, within a cell or the tolerance
   for the goal, and through the stops that remain. Positions are compared in the map's frame:
   a goal in another frame drifts.
2. The robot is *on the path*: within ``tolerance`` of what remains of it. Progress along the path
   only grows, because a path may come near itself; a robot that is back along it by more than
   ``back`` is no longer on it. A robot that drove on while its path was recorded joins it from
   where it is then.
3. The robot has *not arrived*, if the request names stops that it has passed: it is for the next
   round. Arrived means within a cell of the end, or having stood there, because Nav2's trees name
   such stops up to the end.

The answer is the rest of the path from the robot's place, if that is clear on the newest map. If
not, it is another rest of the same plan that begins at one of the ``nodes_ahead``.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IndexArray, Position
from .options import strays
from .plan import Plan, Route

# Nav2's trees take a stop off their list when the robot is within 0.7 m of it [m].
_TAKEN_OFF = 1.0
# Motion up to which a robot stands [m, rad], in at least this time [s].
_STANDS, _STANDS_FOR = 0.02, 0.5
# Largest distance from which a robot joins a path that was recorded meanwhile [``back``].
_DRIVES_ON = 5.0
# Maximum number of sightings of a robot at the end of its path until it counts as arrived, however
# much it or its localisation moves.
_LONGEST_END = 10


@dataclass(frozen=True)
class Destination:
    """Goal of a robot's trip and the stops on the way, in the map's frame [m].

    ``frames`` are those of the map and of the robot; ``cell`` is the map's resolution [m].
    """

    frames: tuple[str, str]
    goal: Position
    cell: float
    stops: tuple[Position, ...] = ()


class Sighting(NamedTuple):
    """Pose of a robot [m, m, rad], and the time of its transform [s]."""

    x: float
    y: float
    yaw: float
    seconds: float

    def is_near(self, other: Sighting) -> bool:
        """Return whether a robot that was seen twice stands."""
        turned = abs(math.remainder(self.yaw - other.yaw, math.tau))
        return max(math.dist(self[:2], other[:2]), turned) <= _STANDS


@dataclass(eq=False)
class TripUnderWay:
    """A path that the robot follows, and its progress on it.

    Parameters
    ----------
    destination
        As the trip was requested.
    path : (L, 3) float
        Poses (x, y, yaw) of the path [m, m, rad].
    nodes, legs, places : (K,) int, (K,) int, (K, 2) float
        The drawn routes of all legs, the leg that leads to each node, and where the nodes are [m].
    passes, visits : (S,) int
        Indices of the stops that lay ahead when the path began, among ``nodes`` and among the
        stops of ``destination``, in the order of the route.
    tolerance, back
        The distance from the path up to which the robot is on it, and how far back along it [m].
    """

    destination: Destination
    path: FloatArray
    nodes: IndexArray
    legs: IndexArray
    places: FloatArray
    passes: IndexArray
    visits: IndexArray
    tolerance: float
    back: float
    progress: float = field(default=0.0, init=False)
    drift: float = field(default=0.0, init=False)  # until the robot has joined the path [m]
    arrived: bool = field(default=False, init=False)
    _seen: Sighting | None = field(default=None, init=False)
    _at_end: int = field(default=0, init=False)  # how often in a row the robot was seen there

    def continues(self, request: Destination, place: Position, goal_tolerance: float) -> bool:
        """Return whether a request from ``place`` continues the trip; notes the progress."""
        return (request.frames == self.destination.frames
                and self.follow(place) is not None
                and self._same_trip(request, place, max(request.cell, goal_tolerance))
                # At the end, a request that names stops that have been passed is another round.
                and not (len(request.stops) > len(self.destination.stops) - len(self.passed)
                         and (self.arrived or self._left <= self.destination.cell)))

    def drive_on(self, place: Position) -> None:
        """Let a robot at ``place``, which did not have the path until now, join it from there."""
        away = float(self._line.projected(place)[0].min())
        self.drift = away if away <= _DRIVES_ON * self.back else 0.0

    def watch(self, seen: Sighting) -> None:
        """Note where the robot is, about once a second: it arrives when it stands at the end."""
        at_end = self.follow((seen.x, seen.y)) is not None and self._left <= self.tolerance
        self._at_end = self._at_end + 1 if at_end else 0
        before, self._seen = self._seen, seen if at_end else None
        if before and at_end and seen.seconds < before.seconds + _STANDS_FOR:
            self._seen = before
        elif before and at_end and seen.is_near(before):
            self.arrived = True
        self.arrived = self.arrived or self._at_end > _LONGEST_END

    def follow(self, place: Position) -> float | None:
        """Note the progress of a robot at ``place``, and return how far along the path it is [m].

        None if it is not on what remains of the path.
        """
        away, along = self._line.projected(place)
        near = away <= self.tolerance + self.drift
        ahead, behind = near & (along >= self.progress), near & (along >= self.progress - self.back)
        on_path = ahead if ahead.any() else behind
        if not on_path.any():
            return None
        first = int(on_path.argmax())  # the first stretch that is near enough
        end = first + int(np.append(on_path[first:], False).argmin())
        nearest = first + int(away[first:end].argmin())
        if away[nearest] <= self.tolerance:
            self.drift = 0.0
        at = float(along[nearest])
        self.progress = max(self.progress, at)
        return at

    def rest(self, place: Position, goal: Position) -> FloatArray:
        """Return the rest of the path (L, 3) for a robot at ``place`` on it.

        It joins the path as far ahead as the robot is off it. It ends at ``goal`` if that is
        within a cell of its end.
        """
        at = self.follow(place) or 0.0
        away, along = self._line.projected(place)
        off = float(away[np.abs(along - at).argmin()])
        ahead = self.path[self._line.along > at + off]
        rest = np.vstack(([(*place, 0.0)], ahead if len(ahead) else self.path[-1:]))
        if math.dist(rest[-1, :2], goal) <= self.destination.cell:
            rest[-1, :2] = goal
        return rest

    def nodes_ahead(self, place: Position) -> tuple[int, IndexArray]:
        """Return the leg of a robot at ``place``, and the nodes from which its route can change.

        They are the next one and the last one that it has passed, to which it can turn back.
        """
        at = self.follow(place) or 0.0
        following = int(np.searchsorted(self._nodes_along, at, side='right'))
        leg = int(self.legs[min(following, len(self.nodes) - 1)])
        steps = [k for k in (following, following - 1)
                 if 0 < k < len(self.nodes) and self.legs[k] == leg]
        return leg, self.nodes[steps]

    def _same_trip(self, request: Destination, place: Position, tolerance: float) -> bool:
        """Return whether a request is for the goal and the stops that remain at ``place``."""
        wanted, own = list(request.stops), self.destination
        if math.dist(request.goal, own.goal) > tolerance:
            return False
        for number, stop in enumerate(own.stops):
            if wanted and math.dist(wanted[0], stop) <= tolerance:
                wanted.pop(0)
            elif number not in self.passed and math.dist(place, stop) > _TAKEN_OFF:
                return False
        return not wanted

    @property
    def passed(self) -> set[int]:
        """The stops that have been passed, as indices of those requested."""
        ahead = self._nodes_along[self.passes] > self.progress + self.tolerance
        return set(range(len(self.destination.stops))) - set(self.visits[ahead].tolist())

    @property
    def _left(self) -> float:
        """Return the length of the path that lies ahead [m]."""
        return float(self._line.along[-1]) - self.progress

    @cached_property
    def _line(self) -> _Line:
        return _Line(self.path[:, :2])

    @cached_property
    def _nodes_along(self) -> FloatArray:
        """Return the distance along the path (K,) at which each node of the route is passed [m]."""
        steps = np.hypot(*np.diff(self.places, axis=0).T)
        found = [0.0]
        for place, step in zip(self.places[1:].tolist(), steps.tolist(), strict=True):
            away, along = self._line.projected(place)
            # The path turns off at most a tube before and after each step of the route.
            near = (along >= found[-1]) & (along <= found[-1] + 2.0 * step + self.back)
            found.append(float(along[near][away[near].argmin()]) if near.any() else found[-1])
        found[-1] = float(self._line.along[-1])
        return np.array(found)


def trip_on(plan: Plan, route: Route, path: FloatArray, destination: Destination,
            passed: Set[int] = frozenset()) -> TripUnderWay:
    """Return the trip on a path (L, 3) along a route of the last legs of a plan.

    A robot is on the path within the tube, its tracking error and a cell. Stops that it has
    ``passed`` before do not lie ahead again, even if the path leads back to them.
    """
    first = len(plan.legs) - len(route)
    nodes = np.concatenate((route[0][:1], *(own[1:] for own in route)))
    steps = [len(own) - 1 for own in route]
    legs = first + np.append(0, np.repeat(np.arange(len(route)), steps))
    passes, visits = np.cumsum(steps)[:-1], first + np.arange(len(route) - 1)
    ahead = ~np.isin(visits, list(passed))
    places = np.vstack((path[:1, :2], plan.network.points[nodes[1:]]))
    return TripUnderWay(
        destination, path, nodes, legs, places, passes[ahead], visits[ahead],
        strays(plan.options, plan.spacing) + plan.options.drive.tracking_error + destination.cell,
        2.0 * plan.spacing,
    )


class _Line:
    """A line with ``points`` (L, 2) [m], of which ``along`` (L,) is the distance to each [m]."""

    def __init__(self, points: FloatArray) -> None:
        self._tails, self._steps = points[:-1], np.diff(points, axis=0)
        lengths = np.hypot(*self._steps.T)
        self._lengths = np.where(lengths > 0.0, lengths, 1.0)
        self.along = np.concatenate(([0.0], np.cumsum(lengths)))

    def projected(self, place: Position) -> tuple[FloatArray, FloatArray]:
        """Distance of each segment (L - 1,) from a place, and its nearest point's ``along`` [m]."""
        offset = place - self._tails
        share = np.clip((offset * self._steps).sum(axis=1) / self._lengths**2, 0.0, 1.0)
        away = np.hypot(*(offset - share[:, None] * self._steps).T)
        return away, self.along[:-1] + share * np.diff(self.along)

