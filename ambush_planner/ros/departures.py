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

from ..core.planner import Plan, Route
from ..recording import Attachment, RecordedMessage, type_name
from ..recording.metadata import metadata_texts
from ..recording.strategy_file import STRATEGY_FILE
from .inputs import Received, Trip
from .outbox import LATEST
from .parameters import NodeParameters


@dataclass(frozen=True, eq=False)
class ServiceCall:
    """What somebody asked for: a service's type and full name, and the request."""

    kind: type
    name: str
    request: Any


@dataclass(frozen=True, eq=False)
class Departure:
    """One convoy's departure; times in nanoseconds of the node's clock, the end last.

    ``path`` and ``others`` (markers, diagnostics) are what was published.
    """

    id: str
    number: int
    call: ServiceCall
    response: Any
    trip: Trip
    parameters: NodeParameters
    plan: Plan
    entropy_source: list[int]
    route: Route
    begin_ns: int
    end_ns: int
    path: RecordedMessage
    others: tuple[RecordedMessage, ...]


def recorded_messages(departure: Departure) -> list[RecordedMessage]:
    """Return inputs, request, publications and answer.

    None is earlier than the request or later than the answer: markers may be of a departure
    before, and the clock may have been set since.
    """
    trip, begin = departure.trip, departure.begin_ns
    inputs = [_received(each, begin) for each in (trip.map.received, trip.start, trip.goal)]
    published = [
        replace(each, stamp_ns=min(max(begin, each.stamp_ns), departure.end_ns))
        for each in (*departure.others, departure.path)
    ]
    return [*inputs, _request(departure), *published, _response(departure)]


def recorded_metadata(departure: Departure, strategy: bytes) -> dict[str, str]:
    """Return what is needed to plan and draw the departure again, and hashes of all of it."""
    trip = departure.trip
    roles = {
        'map': trip.map.received, 'start': trip.start, 'goal': trip.goal, 'path': departure.path,
    }
    return metadata_texts(
        inputs={role: each.topic for role, each in roles.items()},
        contents={**{role: each.data for role, each in roles.items()}, 'strategy': strategy},
        json_entries={
            'parameters': dict(departure.parameters.values),
            'versions': dict(software_versions()),
            'route_entropy_source': departure.entropy_source,
            'route': departure.route.nodes.tolist(),
            'trip': {
                'start': list(trip.start_xy), 'goal': list(departure.plan.goal_xy),
                'tolerance': trip.goal_tolerance,
            },
        },
        texts={
            'planner_version': planner_version(),
            'service': departure.call.name.rsplit('/', 1)[-1],
            'departure': str(departure.number),
            'departure_id': departure.id,
            'frame': trip.map.frame,
        },
    )


def strategy_attachment(data: bytes) -> Attachment:
    """Return a strategy's file as it stands in a recording."""
    return Attachment(STRATEGY_FILE, 'application/zip', data)


def _received(received: Received, stamp_ns: int) -> RecordedMessage:
    kind = type_name(received.message)
    return RecordedMessage(received.topic, kind, received.data, received.qos, stamp_ns)


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
