"""A departure as it happened, and what a recording keeps of it."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo

from ..core.planner import Plan, Route
from ..core.strategy import Strategy
from ..recording import Attachment, RecordedMessage, type_name
from ..recording.encoding import FORMAT
from ..recording.strategy_file import NUMBERS, STRATEGY_FILE
from ..recording.yaml_text import dump_yaml
from .inputs import Received, Trip
from .outbox import LATEST
from .parameters import NodeParameters

# The entries of the metadata, all of them.
METADATA_KEYS = frozenset({
    'format', 'planner_version', 'versions', 'service', 'departure', 'departure_id', 'frame',
    'inputs', 'parameters', 'route_entropy_source', 'route', 'trip', 'sha256',
})


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
    trip, x_y = departure.trip, departure.plan.goal_xy
    texts = {
        'parameters': dump_yaml(dict(departure.parameters.values)),
        # A list of whole numbers in JSON is one in YAML too, and made in no time.
        'route_entropy_source': json.dumps(departure.entropy_source),
        'route': json.dumps(departure.route.nodes.tolist()),
        'trip': dump_yaml({
            'start': list(trip.start_xy), 'goal': list(x_y), 'tolerance': trip.goal_tolerance,
        }),
    }
    topics = {
        'map': trip.map.received.topic, 'start': trip.start.topic, 'goal': trip.goal.topic,
        'path': departure.path.topic,
    }
    contents = {
        'map': trip.map.received.data, 'start': trip.start.data, 'goal': trip.goal.data,
        'path': departure.path.data, 'strategy': strategy,
        **{name: text.encode() for name, text in texts.items()},
    }
    return {
        'format': FORMAT,
        'planner_version': planner_version(),
        'versions': dump_yaml(dict(software_versions())),
        'service': departure.call.name.rsplit('/', 1)[-1],
        'departure': str(departure.number),
        'departure_id': departure.id,
        'frame': trip.map.frame,
        'inputs': dump_yaml(topics),
        **texts,
        'sha256': dump_yaml(_hashes(contents)),
    }


def strategy_file(strategy: Strategy) -> bytes:
    """Return the strategy and its network as an npz file (``numpy.load`` reads it)."""
    network = strategy.network
    stream = BytesIO()
    np.savez_compressed(
        stream,
        points=network.points,
        alpha=network.alpha,
        edges=network.edges,
        source=network.source,
        target=network.target,
        edge_probability=strategy.edge_probability,
        ambush_probability=strategy.ambush_probability,
        **{name: getattr(strategy, name) for name in NUMBERS},
    )
    return stream.getvalue()


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


def _hashes(contents: Mapping[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}


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
