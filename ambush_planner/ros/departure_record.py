# SPDX-License-Identifier: Apache-2.0
"""A departure that leaves, and the messages, metadata and files of its recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rclpy.serialization import serialize_message

from ..parameters.values import OF_PLAIN_NETWORK
from ..planning.changed_ground import Assessment
from ..planning.plan import Route
from ..recordings.attachments import MAP_CHANGES_FILE, map_changes_file
from ..recordings.messages import RecordedMessage, type_name
from ..recordings.metadata import (
    Diversion,
    Metadata,
    RecordedCall,
    RecordedTrip,
    numbers_of,
    software_versions,
)
from ..routes.driven_path import Ends
from .conversions import SentPath
from .plan_cache import CachedPlan
from .topics import LATEST, offered
from .trip import Trip


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a request for a path, and how long it took; the ``departure`` if it is one."""

    path: SentPath
    remarks: str
    took_ns: int
    departure: Departure | None = None


@dataclass(frozen=True, eq=False)
class Departure:
    """One convoy's departure, or a ``diversion`` of it, which has the route of the rest.

    ``trip`` is the requested one, on the newest map; the plan that is ``held`` may be of an older
    map and a nearby trip, to which the start may have been ``joined``. The route is drawn from the
    ``entropy_source`` and driven between ``ends`` [m]. ``published`` is the path, and ``markers``
    and the ``report`` are those published with it. The ``assessment`` is of the departure on the
    newest map. ``remarks`` are for who made the ``call``.
    """

    id: str
    number: int
    call: RecordedCall
    trip: Trip
    held: CachedPlan
    joined: bool
    ends: Ends
    entropy_source: list[int]
    route: Route
    published: RecordedMessage
    markers: tuple[RecordedMessage, ...]
    assessment: Assessment
    tight_turns: int
    remarks: str = ''
    diversion: Diversion | None = None
    report: RecordedMessage | None = None


def recorded_messages(departure: Departure,
                      full_name: Callable[[str], str]) -> list[RecordedMessage]:
    """Return inputs and publications, in the order of time; ``full_name`` is that of a topic.

    Inputs get the time of the request, as if they had come on their topics then. All others get one
    between request and answer: markers may be older, and the clock may have been set back since.
    """
    call = departure.call
    inputs = [replace(departure.held.trip.map.recorded, stamp_ns=call.request_ns)]
    inputs += [RecordedMessage(full_name(topic), type_name(each), bytes(serialize_message(each)),
                               offered(LATEST), call.request_ns)
               for _, topic, each in _inputs_of(departure.trip)]
    published = [replace(each, stamp_ns=min(max(call.request_ns, each.stamp_ns), call.response_ns))
                 for each in (*departure.markers, departure.report, departure.published) if each]
    return [*inputs, *published]


def metadata_of(departure: Departure, full_name: Callable[[str], str]) -> Metadata:
    """Return the metadata record: what the departure was, and what it takes to draw it again."""
    trip, planned, plan = departure.trip, departure.held.trip, departure.held.plan
    topics = {'map': planned.map.topic, 'path': departure.published.topic,
              **{role: full_name(topic) for role, topic, _ in _inputs_of(trip)}}
    return Metadata(
        departure.id, departure.number, trip.map.frame,
        {**trip.parameters.values,
         **{name: departure.held.parameters.values[name] for name in OF_PLAIN_NETWORK}},
        dict(software_versions()), topics,
        RecordedTrip(planned.start_xy, plan.goal_xy, plan.stops_xy), departure.ends,
        departure.joined, numbers_of(departure.route), tuple(departure.entropy_source),
        replace(departure.call, remarks=departure.remarks), departure.assessment.value,
        departure.diversion,
    )


def _inputs_of(trip: Trip) -> list[tuple[str, str, Any]]:
    """Return the roles, topics and messages of the poses of a trip."""
    asked = trip.request
    found = (('start', 'start_pose', asked.start), ('goal', 'goal_pose', asked.goal),
             ('via', 'via_poses', asked.via))
    return [each for each in found if each[2] is not None]


def map_changes(departure: Departure) -> dict[str, bytes]:
    """Return the attached file of the map's changes since the plan, if there are any."""
    newest, planned_on = departure.trip.map, departure.held.trip.map
    if newest is planned_on:
        return {}
    changes = map_changes_file(planned_on.values, newest.values)
    return {MAP_CHANGES_FILE: changes} if changes else {}
