"""A departure as it happened, and what a recording keeps of it."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo

from ..planning.node_parameters import NodeParameters
from ..planning.plan import Route
from ..recordings import Attachment, RecordedMessage, type_name
from ..recordings.map_changes import MAP_CHANGES_FILE, map_changes_file
from ..recordings.metadata import VIA, metadata_texts
from ..recordings.strategy_file import STRATEGY_FILE
from .conversions import fields_of
from .current_map import ReceivedMessage
from .departure_path import DeparturePath
from .inputs import Trip
from .plan_cache import CachedPlan
from .qos import LATEST

# `ros2 bag play` sends them that much before the request, which needs them.
INPUTS_LEAD_NS = 500_000_000


@dataclass(frozen=True, eq=False)
class ServiceCall:
    """What somebody asked for: a service's type and full name, and the request."""

    kind: Any
    name: str
    request: Any


@dataclass(frozen=True, eq=False)
class Departure:
    """One convoy's departure; times in nanoseconds of the node's clock, the end last.

    Attributes
    ----------
    trip
        What was asked for, on the newest map.
    held
        The plan that it left on, perhaps of an older map and a nearby trip.
    path
        From the pose asked for, along the route, to the goal.
    published, others
        The path, and markers and diagnostics, as they were published.
    trouble
        What went wrong with the recordings, if anything did.
    response
        What was answered, once it is; at ``end_ns``.
    """

    id: str
    number: int
    call: ServiceCall
    trip: Trip
    parameters: NodeParameters
    held: CachedPlan
    entropy_source: list[int]
    route: Route
    path: DeparturePath
    published: RecordedMessage
    others: tuple[RecordedMessage, ...]
    begin_ns: int
    end_ns: int
    trouble: str = ''
    response: Any = None


def recorded_messages(departure: Departure) -> list[RecordedMessage]:
    """Return inputs and publications, and request and answer where that is asked for.

    Inputs are from half a second before the request. Nothing else is earlier than that or later
    than the answer: markers may be of a departure before, and the clock may have been set since.
    """
    trip, begin = departure.trip, departure.begin_ns
    planned_on = departure.held.trip.map.received
    before = max(0, begin - INPUTS_LEAD_NS)
    inputs = [
        _received(each, before) for each in (planned_on, trip.start, trip.goal, trip.via) if each
    ]
    published = [
        replace(each, stamp_ns=min(max(begin, each.stamp_ns), departure.end_ns))
        for each in (*departure.others, departure.published)
    ]
    if not departure.parameters.recording.service_events:
        return [*inputs, *published]
    return [*inputs, _request(departure), *published, _response(departure)]


def recorded_metadata(departure: Departure, strategy: bytes, changes: bytes) -> dict[str, str]:
    """Return what is needed to plan and draw the departure again, and hashes of all of it."""
    trip, planned, plan = departure.trip, departure.held.trip, departure.held.plan
    planned_on = planned.map.received
    roles: dict[str, ReceivedMessage | RecordedMessage] = {
        'map': planned_on, 'start': trip.start, 'goal': trip.goal, 'path': departure.published,
        **({VIA: trip.via} if trip.via else {}),
    }
    return metadata_texts(
        inputs={role: each.topic for role, each in roles.items()},
        contents={
            **{role: each.data for role, each in roles.items()},
            'strategy': strategy, 'map_changes': changes,
        },
        json_entries={
            'parameters': dict(departure.parameters.values),
            'versions': dict(software_versions()),
            'route_entropy_source': departure.entropy_source,
            'route': departure.route.nodes.tolist(),
            'trip': {
                'start': list(planned.start_xy), 'goal': list(plan.goal_xy),
                'stops': [*map(list, plan.stops_xy)], 'tolerance': trip.goal_tolerance,
            },
            'ends': [*map(list, departure.held.ends(trip))],
            'call': _call(departure),
        },
        texts={
            'planner_version': planner_version(),
            'service': departure.call.name.rsplit('/', 1)[-1],
            'departure': str(departure.number),
            'departure_id': departure.id,
            'frame': trip.map.frame,
        },
    )


def map_changes(departure: Departure) -> bytes:
    """Return the cells in which the newest map differs from the one that was planned on, if any."""
    newest, planned = departure.trip.map, departure.held.trip.map
    return b'' if newest is planned else map_changes_file(planned.values, newest.values)


def attachments(strategy: bytes, changes: bytes) -> list[Attachment]:
    """Return the files of a departure as they stand in its recording."""
    files = {STRATEGY_FILE: strategy, **({MAP_CHANGES_FILE: changes} if changes else {})}
    return [Attachment(name, 'application/zip', data) for name, data in files.items()]


def _received(received: ReceivedMessage, stamp_ns: int) -> RecordedMessage:
    return RecordedMessage(received.topic, received.type, received.data, received.qos, stamp_ns)


def _call(departure: Departure) -> dict[str, Any]:
    answer = fields_of(departure.response, but=('plan',))  # the path that is recorded
    return {
        'service': departure.call.name, 'type': type_name(departure.call.kind),
        'request_ns': departure.begin_ns, 'response_ns': departure.end_ns,
        'request': fields_of(departure.call.request), 'response': answer,
    }


def _request(departure: Departure) -> RecordedMessage:
    asked = ServiceEventInfo.REQUEST_RECEIVED
    return _event(departure, asked, departure.begin_ns, request=[departure.call.request])


def _response(departure: Departure) -> RecordedMessage:
    answered = ServiceEventInfo.RESPONSE_SENT
    return _event(departure, answered, departure.end_ns, response=[departure.response])


def _event(departure: Departure, what: int, stamp_ns: int, **content: list) -> RecordedMessage:
    """Return the message that service introspection would publish, which rosbag2 knows."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    info = ServiceEventInfo(
        event_type=what,
        stamp=Time(sec=seconds, nanosec=nanoseconds),
        sequence_number=departure.number,
    )
    kind = departure.call.kind.Event
    topic = f'{departure.call.name}/_service_event'
    data = serialize_message(kind(info=info, **content))
    return RecordedMessage(topic, type_name(kind), data, LATEST, stamp_ns)


@cache
def planner_version() -> str:
    """The version of the planner; it does not change while it runs."""
    return _version_of('ambush_planner')


@cache
def software_versions() -> Mapping[str, str]:
    """The versions of what the planner computes with."""
    return MappingProxyType({
        'python': platform.python_version(), 'numpy': np.__version__, 'scipy': scipy.__version__,
        'rclpy': _version_of('rclpy'),
    })


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'not installed'
