# SPDX-License-Identifier: Apache-2.0
"""A departure that leaves, and the messages, metadata and files of its recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from nav_msgs.msg import Path

from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import npz_bytes
from ..network.road_network import in_map_frame
from ..parameters.values import NodeParameters
from ..planning.changed_ground import Assessment
from ..planning.plan import Route
from ..recordings import RecordedMessage, type_name
from ..recordings.attachments import (
    MAP_CHANGES_FILE,
    MAP_FILE,
    ROADS_FILE,
    STRATEGY_FILE,
    map_changes_file,
    roads_file,
)
from ..recordings.metadata import Diversion, Metadata, RecordedCall, RecordedTrip
from ..recordings.versions import software_versions
from ..routes.driven_path import Ends
from .conversions import fields_of
from .current_map import ReceivedMessage
from .inputs import Trip
from .plan_cache import CachedPlan

# They differ from the request's if the plan is the first one of its trip.
_OF_PLAN = ('network.refine', 'network.target_nodes')


@dataclass(frozen=True, eq=False)
class ServiceCall:
    """A service call: the service's type and full name, and the request."""

    kind: Any
    name: str
    request: Any


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a request for a path, and its times; the ``departure`` if it is one."""

    path: Path
    remarks: str
    begin_ns: int
    end_ns: int
    departure: Departure | None = None


@dataclass(frozen=True, eq=False)
class Departure:
    """One convoy's departure; times are nanoseconds of the node's clock.

    ``trip`` is the requested one, on the newest map; the plan that is ``held`` may be of an older
    map and a nearby trip. ``published`` is the path, and ``markers`` and the ``report`` are those
    published with it. ``worth`` is what it is worth on that map. ``remarks`` are on the start,
    which may have been ``joined`` to the plan, on a ``diversion`` of the departure, which takes the
    route of the rest, and on recordings that failed.
    """

    id: str
    number: int
    call: ServiceCall
    trip: Trip
    parameters: NodeParameters
    held: CachedPlan
    joined: bool
    ends: Ends
    entropy_source: list[int]
    route: Route
    path: Path
    published: RecordedMessage
    markers: tuple[RecordedMessage, ...]
    begin_ns: int
    end_ns: int
    worth: Assessment
    tight_turns: int
    remarks: str = ''
    diversion: Diversion | None = None
    report: RecordedMessage | None = None


def recorded_messages(departure: Departure) -> list[RecordedMessage]:
    """Return inputs and publications, in the order of time.

    Inputs get the time of the request. All others get one between request and answer: markers may
    be older, and the clock may have been set back since.
    """
    asked, begin = departure.trip.request, departure.begin_ns
    planned_on = departure.held.trip.map.received
    inputs = [_received(each, begin)
              for each in (planned_on, asked.start, asked.goal, asked.via) if each]
    published = [replace(each, stamp_ns=min(max(begin, each.stamp_ns), departure.end_ns))
                 for each in (*departure.markers, departure.report, departure.published) if each]
    return [*inputs, *published]


def metadata_of(departure: Departure, previous: str) -> Metadata:
    """Return the metadata record: what the departure was, and what it takes to draw it again."""
    trip, planned, plan = departure.trip, departure.held.trip, departure.held.plan
    roles: dict[str, ReceivedMessage | RecordedMessage | None] = {
        'map': planned.map.received, 'start': trip.request.start, 'goal': trip.request.goal,
        'via': trip.request.via, 'path': departure.published,
    }
    call = RecordedCall(departure.call.name, type_name(departure.call.kind), departure.begin_ns,
                        departure.end_ns, fields_of(departure.call.request), departure.remarks)
    return Metadata(
        departure.id, departure.number, trip.map.frame,
        {**departure.parameters.values,
         **{name: departure.held.parameters.values[name] for name in _OF_PLAN}},
        dict(software_versions()), {role: each.topic for role, each in roles.items() if each},
        RecordedTrip(planned.start_xy, plan.goal_xy, plan.stops_xy), departure.ends,
        departure.joined, tuple(departure.route.nodes.tolist()), tuple(departure.entropy_source),
        call, departure.diversion, previous,
    )


def attachments(departure: Departure, strategy: bytes) -> dict[str, bytes]:
    """Return the attached files: the strategy, and changes of the map since the plan, if any."""
    files = {STRATEGY_FILE: strategy}
    if roads := departure.held.plan.options.network.roads:
        files[ROADS_FILE] = roads_file(in_map_frame(roads, departure.held.parameters.occupancy.crs))
    if (risk_map := departure.held.plan.risk_map) is not None:  # of a plan from a file
        files[MAP_FILE] = _map_bytes(risk_map)
    newest, planned_on = departure.trip.map, departure.held.trip.map
    if newest is not planned_on and (
        changes := map_changes_file(planned_on.values, newest.values)
    ):
        files[MAP_CHANGES_FILE] = changes
    return files


@lru_cache(2)
def _map_bytes(risk_map: RiskMap) -> bytes:
    return npz_bytes(risk_map)


def _received(received: ReceivedMessage, stamp_ns: int) -> RecordedMessage:
    return RecordedMessage(received.topic, received.type, received.data, received.qos, stamp_ns)
