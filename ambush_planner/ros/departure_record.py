# SPDX-License-Identifier: Apache-2.0
"""A departure that leaves, and the messages, metadata and files of its recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

from nav_msgs.msg import Path

from ..arrays import IndexArray
from ..parameters.values import OF_PLAIN_NETWORK
from ..planning.changed_ground import Assessment
from ..recordings import RecordedMessage
from ..recordings.attachments import MAP_CHANGES_FILE, map_changes_file
from ..recordings.metadata import Diversion, Metadata, RecordedCall, RecordedTrip
from ..recordings.versions import software_versions
from ..routes.driven_path import Ends
from .current_map import ReceivedMessage
from .plan_cache import CachedPlan
from .trip import Trip


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a request for a path, and how long it took; the ``departure`` if it is one."""

    path: Path
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
    route: IndexArray
    published: RecordedMessage
    markers: tuple[RecordedMessage, ...]
    assessment: Assessment
    tight_turns: int
    remarks: str = ''
    diversion: Diversion | None = None
    report: RecordedMessage | None = None


def recorded_messages(departure: Departure) -> list[RecordedMessage]:
    """Return inputs and publications, in the order of time.

    Inputs get the time of the request. All others get one between request and answer: markers may
    be older, and the clock may have been set back since.
    """
    asked, call = departure.trip.request, departure.call
    planned_on = departure.held.trip.map.received
    inputs = [RecordedMessage(each.topic, each.type, each.data, each.qos, call.request_ns)
              for each in (planned_on, asked.start, asked.goal, asked.via) if each]
    published = [replace(each, stamp_ns=min(max(call.request_ns, each.stamp_ns), call.response_ns))
                 for each in (*departure.markers, departure.report, departure.published) if each]
    return [*inputs, *published]


def metadata_of(departure: Departure, previous: str) -> Metadata:
    """Return the metadata record: what the departure was, and what it takes to draw it again."""
    trip, planned, plan = departure.trip, departure.held.trip, departure.held.plan
    roles: dict[str, ReceivedMessage | RecordedMessage | None] = {
        'map': planned.map.received, 'start': trip.request.start, 'goal': trip.request.goal,
        'via': trip.request.via, 'path': departure.published,
    }
    return Metadata(
        departure.id, departure.number, trip.map.frame,
        {**trip.parameters.values,
         **{name: departure.held.task.parameters.values[name] for name in OF_PLAIN_NETWORK}},
        dict(software_versions()), {role: each.topic for role, each in roles.items() if each},
        RecordedTrip(planned.start_xy, plan.goal_xy, plan.stops_xy), departure.ends,
        departure.joined, departure.assessment.value, tuple(departure.route.tolist()),
        tuple(departure.entropy_source),
        replace(departure.call, remarks=departure.remarks), departure.diversion, previous,
    )


def map_changes(departure: Departure) -> dict[str, bytes]:
    """Return the attached file of the map's changes since the plan, if there are any."""
    newest, planned_on = departure.trip.map, departure.held.trip.map
    if newest is planned_on:
        return {}
    changes = map_changes_file(planned_on.values, newest.values)
    return {MAP_CHANGES_FILE: changes} if changes else {}
