# SPDX-License-Identifier: Apache-2.0
"""The trip that a robot is on, and the requests that continue it.

A request continues the trip, and is no departure, if all of this holds:

1. It is for the *same trip*: for the same robot, to the same goal, within a cell or the tolerance
   for the goal, and through the stops that remain. Positions are compared in the map's frame:
   a goal in another frame drifts.
2. The robot is *on the path*: within ``tolerance`` of its remaining part. Progress along the path
   only grows, because a path may come near itself; a robot that is more than ``back`` behind its
   progress is no longer on the path. A robot that drove on while its path was recorded joins it
   from its place at the end of that.
3. The robot has *not arrived*, if the request names stops that it has passed: such a request is
   for the next round. Arrived means within a cell of the end, or having stood there, because
   Nav2's trees name passed stops up to the end.

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
from .options import max_deviation
from .plan import Plan, Route

# Distance of the robot from a stop within which a request may omit it [m]: Nav2's trees drop a stop
# from their list within 0.7 m of it.
_STOP_RADIUS = 1.0
# A robot stands if it moves by at most this [m, rad] in at least this time [s].
_MAX_MOTION, _STANDING_TIME = 0.02, 0.5
# Largest distance from which a robot joins a path that was recorded meanwhile [``back``].
_MAX_DRIFT = 5.0
# Number of sightings at the end of its path after which a robot counts as arrived even if it, or
# its localisation, keeps moving.
_MAX_END_SIGHTINGS = 10


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
        return max(math.dist(self[:2], other[:2]), turned) <= _MAX_MOTION


@dataclass(eq=False)
class TripUnderWay:
    """A path that a robot follows, and the robot's progress along it.

    Parameters
    ----------
    destination
        Goal and stops of the request.
    path : (L, 3) float
        Poses (x, y, yaw) of the path [m, m, rad].
    nodes, legs, places : (K,) int, (K,) int, (K, 2) float
        The drawn routes of all legs, the leg that leads to each node, and where the nodes are [m].
    passes, visits : (S,) int
        Indices of the stops that lay ahead when the path began, among ``nodes`` and among the
        stops of ``destination``, in the order of the route.
    tolerance, back
        Largest distance of a robot on the path from it, and behind its progress [m].
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
        """Return whether a request from ``place`` continues the trip; records the progress."""
        return (request.frames == self.destination.frames
                and self.follow(place) is not None
                and self._same_trip(request, place, max(request.cell, goal_tolerance))
                # At the end, a request that names stops that have been passed is another round.
                and not (len(request.stops) > len(self.destination.stops) - len(self.passed)
                         and (self.arrived or self._remaining <= self.destination.cell)))

    def drive_on(self, place: Position) -> None:
        """Let a robot that gets the path only now, at ``place``, join it from there."""
        distance = float(self._line.project(place)[0].min())
        self.drift = distance if distance <= _MAX_DRIFT * self.back else 0.0

    def watch(self, seen: Sighting) -> None:
        """Record a sighting, about once a second: the robot has arrived if it stands at the end."""
        at_end = self.follow((seen.x, seen.y)) is not None and self._remaining <= self.tolerance
        self._at_end = self._at_end + 1 if at_end else 0
        previous, self._seen = self._seen, seen if at_end else None
        if previous and at_end and seen.seconds < previous.seconds + _STANDING_TIME:
            self._seen = previous
        elif previous and at_end and seen.is_near(previous):
            self.arrived = True
        self.arrived = self.arrived or self._at_end > _MAX_END_SIGHTINGS

    def follow(self, place: Position) -> float | None:
        """Record the progress of a robot at ``place``; return its distance along the path [m].

        Returns None if it is not on the remaining path.
        """
        distance, along = self._line.project(place)
        near = distance <= self.tolerance + self.drift
        ahead, behind = near & (along >= self.progress), near & (along >= self.progress - self.back)
        on_path = ahead if ahead.any() else behind
        if not on_path.any():
            return None
        first = int(on_path.argmax())  # the first stretch that is near enough
        end = first + int(np.append(on_path[first:], False).argmin())
        nearest = first + int(distance[first:end].argmin())
        if distance[nearest] <= self.tolerance:
            self.drift = 0.0
        reached = float(along[nearest])
        self.progress = max(self.progress, reached)
        return reached

    def rest(self, place: Position, goal: Position) -> FloatArray:
        """Return the rest of the path (L, 3) for a robot at ``place`` on it.

        It joins the path as far ahead as the robot's distance from it. It ends at ``goal`` if that
        is within a cell of its end.
        """
        reached = self.follow(place) or 0.0
        distance, along = self._line.project(place)
        offset = float(distance[np.abs(along - reached).argmin()])
        ahead = self.path[self._line.along > reached + offset]
        rest = np.vstack(([(*place, 0.0)], ahead if len(ahead) else self.path[-1:]))
        if math.dist(rest[-1, :2], goal) <= self.destination.cell:
            rest[-1, :2] = goal
        return rest

    def nodes_ahead(self, place: Position) -> tuple[int, IndexArray]:
        """Return the leg of a robot at ``place``, and the nodes from which its route can change.

        They are the next node, and the last one that it has passed, to which it can turn back.
        """
        reached = self.follow(place) or 0.0
        following = int(np.searchsorted(self._nodes_along, reached, side='right'))
        leg = int(self.legs[min(following, len(self.nodes) - 1)])
        steps = [k for k in (following, following - 1)
                 if 0 < k < len(self.nodes) and self.legs[k] == leg]
        return leg, self.nodes[steps]

    def _same_trip(self, request: Destination, place: Position, tolerance: float) -> bool:
        """Return whether a request has the same goal and the stops that remain at ``place``."""
        requested, destination = list(request.stops), self.destination
        if math.dist(request.goal, destination.goal) > tolerance:
            return False
        for number, stop in enumerate(destination.stops):
            if requested and math.dist(requested[0], stop) <= tolerance:
                requested.pop(0)
            elif number not in self.passed and math.dist(place, stop) > _STOP_RADIUS:
                return False
        return not requested

    @property
    def passed(self) -> set[int]:
        """Indices of the requested stops that have been passed."""
        ahead = self._nodes_along[self.passes] > self.progress + self.tolerance
        return set(range(len(self.destination.stops))) - set(self.visits[ahead].tolist())

    @property
    def _remaining(self) -> float:
        """Length of the remaining path [m]."""
        return float(self._line.along[-1]) - self.progress

    @cached_property
    def _line(self) -> _Line:
        return _Line(self.path[:, :2])

    @cached_property
    def _nodes_along(self) -> FloatArray:
        """Distance along the path (K,) at which each node of the route is passed [m]."""
        steps = np.hypot(*np.diff(self.places, axis=0).T)
        passed = [0.0]
        for place, step in zip(self.places[1:].tolist(), steps.tolist(), strict=True):
            distance, along = self._line.project(place)
            # The path turns off at most a tube before and after each step of the route.
            near = (along >= passed[-1]) & (along <= passed[-1] + 2.0 * step + self.back)
            passed.append(float(along[near][distance[near].argmin()]) if near.any()
                          else passed[-1])
        passed[-1] = float(self._line.along[-1])
        return np.array(passed)


def trip_on(plan: Plan, route: Route, path: FloatArray, destination: Destination,
            passed: Set[int] = frozenset()) -> TripUnderWay:
    """Begin a trip on a path (L, 3) along a route of the last legs of a plan.

    A robot is on the path within the tube plus its tracking error plus a cell. Stops that it has
    ``passed`` before do not lie ahead again, even if the path leads back to them.
    """
    first = len(plan.legs) - len(route)
    nodes = np.concatenate((route[0][:1], *(leg[1:] for leg in route)))
    steps = [len(leg) - 1 for leg in route]
    legs = first + np.append(0, np.repeat(np.arange(len(route)), steps))
    passes, visits = np.cumsum(steps)[:-1], first + np.arange(len(route) - 1)
    ahead = ~np.isin(visits, list(passed))
    places = np.vstack((path[:1, :2], plan.network.points[nodes[1:]]))
    return TripUnderWay(
        destination, path, nodes, legs, places, passes[ahead], visits[ahead],
        max_deviation(plan.options, plan.spacing) + plan.options.drive.tracking_error
        + destination.cell,
        2.0 * plan.spacing,
    )


class _Line:
    """A line through ``points`` (L, 2) [m]; ``along`` (L,) is their distance from its begin [m]."""

    def __init__(self, points: FloatArray) -> None:
        self._tails, self._steps = points[:-1], np.diff(points, axis=0)
        lengths = np.hypot(*self._steps.T)
        self._lengths = np.where(lengths > 0.0, lengths, 1.0)
        self.along = np.concatenate(([0.0], np.cumsum(lengths)))

    def project(self, place: Position) -> tuple[FloatArray, FloatArray]:
        """Return the distance (L - 1,) of each segment from a place, and where it is ``along``."""
        offset = place - self._tails
        share = np.clip((offset * self._steps).sum(axis=1) / self._lengths**2, 0.0, 1.0)
        distance = np.hypot(*(offset - share[:, None] * self._steps).T)
        return distance, self.along[:-1] + share * np.diff(self.along)

