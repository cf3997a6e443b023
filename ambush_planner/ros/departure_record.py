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
from nav_msgs.srv import GetPlan
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo

from ..core.planner import Route
from ..core.strategy import Strategy
from ..recording import Attachment, RecordedMessage, type_name
from ..recording.encoding import FORMAT
from ..recording.strategy_file import NUMBERS, STRATEGY_FILE
from ..recording.yaml_text import dump_yaml
from .cdr import plan_event_bytes
from .inputs import Received, Trip
from .parameters import NodeParameters
from .paths import DeparturePath
from .planning import HeldPlan
from .qos import LATEST

MAP_CHANGES_FILE = 'map_changes.npz'
# The entries of the metadata, all of them.
METADATA_KEYS = frozenset({
    'format', 'planner_version', 'versions', 'service', 'departure', 'departure_id', 'frame',
    'inputs', 'parameters', 'route_entropy_source', 'route', 'trip', 'ends', 'sha256',
})


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
    held: HeldPlan
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
    """Return inputs, request, publications and answer.

    None is earlier than the request or later than the answer: markers may be of a departure
    before, and the clock may have been set since.
    """
    trip, begin = departure.trip, departure.begin_ns
    planned_on = departure.held.trip.map.received
    inputs = [_received(each, begin) for each in (planned_on, trip.start, trip.goal)]
    published = [
        replace(each, stamp_ns=min(max(begin, each.stamp_ns), departure.end_ns))
        for each in (*departure.others, departure.published)
    ]
    return [*inputs, _request(departure), *published, _response(departure)]


def recorded_metadata(departure: Departure, strategy: bytes) -> dict[str, str]:
    """Return what is needed to plan and draw the departure again, and hashes of all of it."""
    trip, planned, plan = departure.trip, departure.held.trip, departure.held.plan
    planned_on = planned.map.received
    texts = {
        'parameters': dump_yaml(dict(departure.parameters.values)),
        # A list of whole numbers in JSON is one in YAML too, and made in no time.
        'route_entropy_source': json.dumps(departure.entropy_source),
        'route': json.dumps(departure.route.nodes.tolist()),
        'trip': dump_yaml({
            'start': list(planned.start_xy), 'goal': list(plan.goal_xy),
            'tolerance': trip.goal_tolerance,
        }),
        'ends': json.dumps([*map(list, departure.held.ends(trip))]),
    }
    topics = {
        'map': planned_on.topic, 'start': trip.start.topic, 'goal': trip.goal.topic,
        'path': departure.published.topic,
    }
    contents = {
        'map': planned_on.data, 'start': trip.start.data, 'goal': trip.goal.data,
        'path': departure.published.data, 'strategy': strategy,
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


def map_changes(departure: Departure) -> list[Attachment]:
    """Return the cells in which the newest map differs from the one that was planned on, if any.

    An npz file: ``cells`` (K, 2) = (row, column), ``values`` (K,) on the newest map.
    """
    newest, planned = departure.trip.map, departure.held.trip.map
    if newest is planned:
        return []
    cells = np.argwhere(newest.values != planned.values).astype(np.int32)
    stream = BytesIO()
    np.savez_compressed(stream, cells=cells, values=newest.values[tuple(cells.T)])
    return [Attachment(MAP_CHANGES_FILE, 'application/zip', stream.getvalue())]


def strategy_attachment(data: bytes) -> Attachment:
    """Return a strategy's file as it stands in a recording."""
    return Attachment(STRATEGY_FILE, 'application/zip', data)


def _received(received: Received, stamp_ns: int) -> RecordedMessage:
    return RecordedMessage(received.topic, received.type, received.data, received.qos, stamp_ns)


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
    event = kind(info=info, **content)
    if kind is GetPlan.Event and 'response' in content:
        data = plan_event_bytes(event, departure.published.data)
    else:
        data = serialize_message(event)
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
