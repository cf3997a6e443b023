"""Recorded departures as plain records, grouped by the strategy that they were drawn from."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid

from ..core.arrays import frozen_array
from ..core.errors import AmbushPlannerError
from ..core.network import IndexArray
from ..core.risk_map import RiskMap
from ..core.strategy import Strategy
from ..recording.departure import RecordedDeparture
from ..recording.errors import UnreadableRecording
from ..recording.reader import read_departure
from ..recording.strategy_file import STRATEGY_FILE, BadStrategy, strategy_from_file
from ..ros.conversions import risk_map_from_ros
from ..ros.parameters import PARAMETERS, NodeParameters, parameters_from

ROLES = ('map', 'start', 'goal', 'path')
# More than any node writes; reports and messages repeat what is below these.
_LONGEST_NAME, _LONGEST_VALUE, _MOST_VERSIONS = 255, 4096, 100
_HASHED_TEXTS = ('parameters', 'route_entropy_source', 'route', 'trip')


@dataclass(frozen=True)
class RecordedTrip:
    """Where a departure led, in the map's frame [m]; ``tolerance`` [m] as requested."""

    start_xy: tuple[float, float]
    goal_xy: tuple[float, float]
    tolerance: float


@dataclass(frozen=True, eq=False)
class DepartureRecord:
    """What the metadata of one departure says; every stated hash held.

    Attributes:
        path: The file.
        id: Unique to the departure.
        number: Its number in its run of the node, from 1.
        service: ``new_route`` or ``get_plan``.
        stamp_ns: When the path was published.
        frame: The map's frame.
        planner_version, versions: Of the planner, and of what it was computed with.
        parameters: All parameters of the node.
        trip: From where to where.
        route: Node indices (K,).
        route_entropy_source: The route is drawn from ``numpy.random.default_rng`` of this.
        sha256: The stated hashes, by the names of the metadata.
    """

    path: Path
    id: str
    number: int
    service: str
    stamp_ns: int
    frame: str
    planner_version: str
    versions: Mapping[str, str]
    parameters: NodeParameters
    trip: RecordedTrip
    route: IndexArray
    route_entropy_source: list[int] = field(repr=False)
    sha256: Mapping[str, str] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Campaign:
    """The departures of one strategy, in the order of time."""

    sha256: str
    strategy: Strategy
    risk_map: RiskMap
    departures: tuple[DepartureRecord, ...]


def read_campaigns(
    paths: Iterable[Path], unreadable: Callable[[UnreadableRecording], None]
) -> list[Campaign]:
    """Read recordings and group them by strategy, the earliest first.

    A departure that comes twice (a file that was copied) counts once. Departures belong together
    when the strategy's file, the game's options and the reading of the map are the same.

    Args:
        paths: The files.
        unreadable: Called with the error of each file that cannot be read; the others are used.
    """
    groups: dict[tuple, tuple[Strategy, RiskMap, dict[str, DepartureRecord]]] = {}
    for path in paths:
        try:
            recorded = read_departure(path)
            record = record_from(recorded)
            key = _group_of(record)
            if key not in groups:
                groups[key] = strategy_from(recorded, record), risk_map_from(recorded, record), {}
            _add(record, *groups[key][::2])
        except UnreadableRecording as error:
            unreadable(error)
    campaigns = [
        Campaign(key[0], strategy, risk_map, tuple(sorted(known.values(), key=_time)))
        for key, (strategy, risk_map, known) in groups.items()
        if known
    ]
    return sorted(campaigns, key=lambda campaign: _time(campaign.departures[0]))


def record_from(recorded: RecordedDeparture) -> DepartureRecord:
    """Read the metadata of a departure and check it against its hashes.

    Raises:
        UnreadableRecording: An entry is missing or malformed, or a hash does not hold.
    """
    if unknown := sorted(set(recorded.attachments) - {STRATEGY_FILE}):
        raise UnreadableRecording(recorded.path, f'an attachment {unknown[0][:60]!r} is not known')
    hashes = _mapping(recorded, 'sha256')
    _check_hashes(recorded, hashes)
    return DepartureRecord(
        path=recorded.path,
        id=_name(recorded, 'departure_id'),
        number=_whole(recorded, 'departure'),
        service=_name(recorded, 'service'),
        stamp_ns=recorded.recorded('path').stamp_ns,
        frame=_name(recorded, 'frame'),
        planner_version=_name(recorded, 'planner_version'),
        versions=_versions(recorded),
        parameters=_parameters(recorded),
        trip=_trip(recorded),
        route=frozen_array(_wholes(recorded, 'route', 2), np.int64),
        route_entropy_source=_wholes(recorded, 'route_entropy_source', 1),
        sha256=hashes,
    )


def strategy_from(recorded: RecordedDeparture, record: DepartureRecord) -> Strategy:
    """Return the strategy that a departure was drawn from, with its network and game.

    Raises:
        UnreadableRecording: The attachment is no strategy, or its numbers do not agree.
    """
    try:
        return strategy_from_file(
            recorded.attachment(STRATEGY_FILE), record.parameters.planning.game
        )
    except BadStrategy as error:
        raise UnreadableRecording(recorded.path, f'the recorded strategy: {error}') from error


def risk_map_from(recorded: RecordedDeparture, record: DepartureRecord) -> RiskMap:
    """Return the risk map that a departure was planned on.

    Raises:
        UnreadableRecording: The recorded map is not an occupancy grid that can be read.
    """
    message = recorded.message('map')
    if not isinstance(message, OccupancyGrid):
        raise UnreadableRecording(recorded.path, 'the recorded map is not an occupancy grid')
    try:
        return risk_map_from_ros(message, record.parameters.occupancy)
    except AmbushPlannerError as error:
        raise UnreadableRecording(recorded.path, f'the recorded map: {error}') from error


def _group_of(record: DepartureRecord) -> tuple:
    parameters = record.parameters
    return record.sha256['strategy'], parameters.planning.game, parameters.occupancy


def _add(record: DepartureRecord, strategy: Strategy, known: dict[str, DepartureRecord]) -> None:
    if not ((record.route >= 0) & (record.route < len(strategy.network.points))).all():
        raise UnreadableRecording(record.path, 'the recorded route leaves the recorded network')
    other = known.setdefault(record.id, record)
    if other.sha256 != record.sha256:
        raise UnreadableRecording(
            record.path, f'it has the departure_id of {other.path.name}, but another content'
        )


def _time(record: DepartureRecord) -> tuple[int, int]:
    return record.stamp_ns, record.number


def _check_hashes(recorded: RecordedDeparture, stated: Mapping[str, Any]) -> None:
    contents = {role: recorded.recorded(role).data for role in ROLES}
    contents |= {name: _text(recorded, name).encode() for name in _HASHED_TEXTS}
    contents['strategy'] = recorded.attachment(STRATEGY_FILE)
    for name, data in contents.items():
        if stated.get(name) != hashlib.sha256(data).hexdigest():
            raise UnreadableRecording(recorded.path, f'the stated sha256 of {name} does not hold')


def _parameters(recorded: RecordedDeparture) -> NodeParameters:
    values = _scalars(recorded, 'parameters')
    if unknown := sorted(set(values) - set(PARAMETERS)):
        raise UnreadableRecording(
            recorded.path, f'the recorded parameters: {unknown[0][:60]!r} is none of this planner'
        )
    try:
        parameters = parameters_from(values)
        hash((parameters.occupancy, parameters.planning))
    except (AmbushPlannerError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise UnreadableRecording(recorded.path, f'the recorded parameters: {error}') from error
    return parameters


def _trip(recorded: RecordedDeparture) -> RecordedTrip:
    trip = _mapping(recorded, 'trip')
    try:
        (x0, y0), (x1, y1) = trip['start'], trip['goal']
        numbers = [float(number) for number in (x0, y0, x1, y1, trip['tolerance'])]
    except (LookupError, TypeError, ValueError):
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise UnreadableRecording(recorded.path, 'the recorded trip is not two places in metres')
    x0, y0, x1, y1, tolerance = numbers
    return RecordedTrip((x0, y0), (x1, y1), tolerance)


def _text(recorded: RecordedDeparture, key: str) -> str:
    if key not in recorded.metadata:
        raise UnreadableRecording(recorded.path, f'the metadata has no entry {key!r}')
    return recorded.metadata[key]


def _name(recorded: RecordedDeparture, key: str) -> str:
    text = _text(recorded, key)
    if len(text) > _LONGEST_NAME:
        reason = f'the recorded {key} is longer than {_LONGEST_NAME}'
        raise UnreadableRecording(recorded.path, reason)
    return text


def _versions(recorded: RecordedDeparture) -> Mapping[str, Any]:
    versions = _scalars(recorded, 'versions')
    if len(versions) > _MOST_VERSIONS:
        raise UnreadableRecording(recorded.path, f'{len(versions)} versions are recorded')
    return versions


def _scalars(recorded: RecordedDeparture, key: str) -> Mapping[str, Any]:
    """A mapping of names to single texts and numbers, none over-long."""
    content = _mapping(recorded, key)
    for name, value in content.items():
        if len(name) > _LONGEST_NAME or not _is_scalar(value):
            raise UnreadableRecording(
                recorded.path, f'the recorded {key}: {name[:60]!r} is not one text or number'
            )
    return content


def _is_scalar(value: Any) -> bool:
    if isinstance(value, str):
        return len(value) <= _LONGEST_VALUE
    return isinstance(value, float) or isinstance(value, int) and abs(value) < 2**63


def _whole(recorded: RecordedDeparture, key: str) -> int:
    text = _text(recorded, key)
    if not (text.isascii() and text.isdecimal() and len(text) < 19):
        raise UnreadableRecording(recorded.path, f'the recorded {key} is not a whole number')
    return int(text)


def _wholes(recorded: RecordedDeparture, key: str, least: int) -> list[int]:
    """A list of whole numbers >= 0; route entries must fit in 63 bits, generator seeds need not."""
    values = recorded.yaml(key)
    good = isinstance(values, list) and len(values) >= least and all(
        type(value) is int and value >= 0 for value in values
    )
    if not good or (key == 'route' and max(values) >= 2**63):
        raise UnreadableRecording(recorded.path, f'the recorded {key} is not a list of indices')
    return values


def _mapping(recorded: RecordedDeparture, key: str) -> Mapping[str, Any]:
    content = recorded.yaml(key)
    if not isinstance(content, dict) or not all(isinstance(name, str) for name in content):
        raise UnreadableRecording(recorded.path, f'the recorded {key} is not a mapping of names')
    return content
