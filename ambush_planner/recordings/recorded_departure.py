# SPDX-License-Identifier: Apache-2.0
"""One recorded departure: where it led, and the map, strategy and entropy it was drawn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..game.certificate.certificate import Certificate
from ..game.strategy import TripStrategy, with_certificate
from ..maps.occupancy import OccupancyMap, OccupancyOptions
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import map_from_bytes
from ..maps.ros_messages import occupancy_from_ros, path_from_ros
from ..operations.slots import Slots
from ..parameters.values import NodeParameters, parameters_from
from ..planning.changed_ground import ChangedGround
from ..planning.moved_start import JoinedPlan, joined_plan, rest_strategy, whole_route
from ..planning.options import PlanningOptions
from ..planning.plan import Route, make_plan
from ..routes.driven_path import Ends
from .attachments import (
    MAP_CHANGES_FILE,
    MAP_FILE,
    ROADS_FILE,
    STRATEGY_FILE,
    changed_map,
    roads_from_file,
    strategy_from_file,
)
from .messages import RecordedMessage
from .metadata import Metadata, typed_values
from .recording_errors import UnreadableRecording, part
from .recording_file import RecordingFile, decode, read_recording


@dataclass(frozen=True, eq=False)
class RecordedDeparture:
    """A departure, or a diversion of one, as it was recorded.

    Equal strategies and equal maps are one object.

    Attributes
    ----------
    metadata, recorded_ns
        What the file says of it, and the time of its path [ns].
    route
        Node indices of each leg from its source to its target. For a diversion this is the whole
        route: what was driven before, and the rest that ``drawn`` holds, after its source.
    trip
        The recorded strategies, their certificate computed from their probabilities.
    drawn_from
        ``trip``; if the map had changed, these strategies given that their routes are clear, with
        the losses and the value of that map; if the convoy had moved, those of the routes
        ``joined`` from where it was; if it was diverted, those of the rests from there, after what
        it had driven, with the value that the file states.
    planned_on, newest, risk_map
        The maps of the plan and at the time of departure; the losses of the former.
    before
        What was recorded of the departure before this diversion, if that is known.
    """

    path: Path
    metadata: Metadata
    recorded_ns: int
    parameters: NodeParameters
    route: Route = field(repr=False)
    drawn: Route = field(repr=False)
    trip: TripStrategy
    drawn_from: TripStrategy
    joined: JoinedPlan | None
    planned_on: OccupancyMap
    newest: OccupancyMap
    risk_map: RiskMap
    _path_message: RecordedMessage = field(repr=False)
    before: RecordedDeparture | None = field(default=None, repr=False)

    @cached_property
    def newest_risk_map(self) -> RiskMap:
        """The losses at the time of departure."""
        if self.newest is self.planned_on:
            return self.risk_map
        return self.newest.risk_map(self.parameters.occupancy)

    @property
    def departed_on(self) -> TripStrategy:
        """The strategies that it was drawn from, before it was diverted if that is known."""
        return self.parts[0].drawn_from

    @property
    def drawn_slot(self) -> tuple[str, Slots] | None:
        """The time of departure and what it was drawn from; None if none was drawn."""
        day, plan = self.metadata.day, self.metadata.plan
        slots = plan.slots if plan and day and day.slot_drawn else None
        return (day.slot, slots) if day and slots else None

    @property
    def covered(self) -> float:
        """The largest share of departures that an ambush at one time covers; 1 if he knows it."""
        return self.drawn_slot[1].covered if self.drawn_slot else 1.0

    @property
    def value(self) -> float:
        """The value for an ambusher who must choose a time, too, if that was drawn."""
        return self.departed_on.value * self.covered

    @property
    def lower_bound(self) -> float:
        """The lower bound of ``value``."""
        return self.departed_on.lower_bound * self.covered

    @property
    def stamp_ns(self) -> int:
        """Return the time of the convoy's departure [ns]."""
        return self.before.stamp_ns if self.before else self.recorded_ns

    @property
    def parts(self) -> list[RecordedDeparture]:
        """The recordings of the departure, from the first to the last."""
        return [*(self.before.parts if self.before else ()), self]

    @cached_property
    def recorded_poses(self) -> FloatArray:
        """The poses (L, 3) = (x, y, yaw) of the recorded path [m, m, rad]."""
        return path_from_ros(decode(self._path_message))

    @cached_property
    def path_poses(self) -> FloatArray:
        """The poses (L, 3) = (x, y, yaw) of the whole path: before a diversion, and after it."""
        rest = self.recorded_poses
        if self.before is None:
            return rest
        driven = self.before.path_poses
        near = int(np.hypot(*(driven[:, :2] - rest[0, :2]).T).argmin())
        return np.vstack((driven[:near + 1], rest))


# Calls a function with arguments, once for equal ones: departures share parts.
Once = Callable[..., Any]


def made_once(most: int | None = None) -> Once:
    """Return what makes each part once, and keeps the last ``most`` of them."""
    return lru_cache(most)(lambda make, *of: make(*of))


def read_departure(path: Path | str, once: Once | None = None) -> RecordedDeparture:
    """Read one recorded departure and check its CRCs; raises UnreadableRecording."""
    return departure_in(read_recording(path), once or made_once())


def departure_in(file: RecordingFile, once: Once) -> RecordedDeparture:
    """Return the departure in a file; raises UnreadableRecording if it is malformed."""
    if 'departure' not in file.entries:
        raise UnreadableRecording(file.path, 'it is a plan: ambush draw makes a departure of it')
    return part(file.path, 'departure', lambda: _departure_in(file, once))


def _departure_in(file: RecordingFile, once: Once) -> RecordedDeparture:
    metadata, files = file.metadata, file.attachments
    parameters = parameters_from(typed_values(metadata.parameters),
                                 once(roads_from_file, files.get(ROADS_FILE)))
    planning, occupancy = parameters.planning, parameters.occupancy
    trip: TripStrategy = once(strategy_from_file, files[STRATEGY_FILE], planning.game)
    values, resolution, origin = occupancy_from_ros(decode(file.in_role('map')))
    # Maps that differ only in their header are one object.
    planned_on = once(_map, values.tobytes(), values.shape, resolution, origin)
    risk_map = (once(map_from_bytes, files[MAP_FILE]) if MAP_FILE in files
                else once(OccupancyMap.risk_map, planned_on, occupancy))
    newest, drawn_from, joined = planned_on, trip, None

    def ground() -> ChangedGround:
        found: ChangedGround = once(ground_of, trip, planned_on, occupancy, planning, risk_map)
        return found

    if changes := files.get(MAP_CHANGES_FILE, b''):
        newest = once(_newest, planned_on, changes)
    if metadata.joined:
        joined = once(_joined, ground(), newest, metadata.ends)
        drawn_from = joined.plan.trip
    elif changes and not metadata.diversion:
        drawn_from = once(ChangedGround.drawn_from, ground(), newest)
    drawn = route = _nodes(metadata.route, trip)
    if metadata.diversion:
        route = whole_route(_nodes(metadata.diversion.left, trip), drawn)
        drawn_from = rest_strategy(ground(), newest, route, drawn)
        if (value := metadata.value) is not None:
            drawn_from = with_certificate(drawn_from,
                                          Certificate(value, min(trip.lower_bound, value)))
    message = file.in_role('path')
    return RecordedDeparture(file.path, metadata, message.stamp_ns, parameters, route, drawn,
                             trip, drawn_from, joined, planned_on, newest, risk_map, message)


def _nodes(route: tuple[tuple[int, ...], ...], trip: TripStrategy) -> Route:
    """Return the nodes of a recorded route; ValueError if it leaves the networks."""
    nodes, count = tuple(frozen_array(each, np.int64) for each in route), trip.game.node_count
    if not 0 < len(nodes) <= len(trip.legs) or not all(
            len(each) > 1 and 0 <= each.min() <= each.max() < count for each in nodes):
        raise ValueError('the recorded route leaves the recorded network')
    return nodes


def _map(cells: bytes, shape: tuple[int, int], resolution: float,
         origin: tuple[float, float, float]) -> OccupancyMap:
    return OccupancyMap(np.frombuffer(cells, np.int8).reshape(shape), resolution, origin)


def ground_of(trip: TripStrategy, planned_on: OccupancyMap, options: OccupancyOptions,
              planning: PlanningOptions, risk_map: RiskMap) -> ChangedGround:
    """Return recorded strategies as a plan with corridors, on its ground."""
    return ChangedGround(make_plan(risk_map, trip, planning), planned_on, options)


def _newest(planned_on: OccupancyMap, changes: bytes) -> OccupancyMap:
    return replace(planned_on, values=changed_map(planned_on.values, changes))


def _joined(ground: ChangedGround, newest: OccupancyMap, ends: Ends) -> JoinedPlan:
    """Return the plan of a convoy that had moved."""
    joined = joined_plan(ground, newest, ends)
    if joined is None:
        raise ValueError('the recorded strategy cannot be joined from where the path begins')
    return joined
